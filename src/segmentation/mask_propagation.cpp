#include "dynslam/segmentation/mask_propagation.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <deque>
#include <utility>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"

#include "segmentation/mask_carrier.hpp"

namespace dynslam::segmentation {

void PropagationOptions::validate() const {
  require(history >= 2 && history <= 1000, "PropagationOptions", "history", history,
          "2 to 1000 frames");
  require(max_points >= 4 && max_points <= 10000, "PropagationOptions", "max_points", max_points,
          "4 to 10000");
  require(std::isfinite(max_error_px) && max_error_px > 0.0, "PropagationOptions", "max_error_px",
          max_error_px, "a positive number of pixels");
  require(max_age >= 1, "PropagationOptions", "max_age", max_age, "at least 1 frame");
  require(std::isfinite(half_life) && half_life > 0.0, "PropagationOptions", "half_life", half_life,
          "a positive number of frames");
  depth.validate();
}

cv::Mat PropagatedSegmentation::soft_mask(const std::vector<std::size_t>& chosen,
                                          int softness) const {
  require(softness >= 0 && softness <= 100, "PropagatedSegmentation::soft_mask", "softness",
          softness, "0 to 100 pixels");
  cv::Mat soft = cv::Mat::zeros(segmentation.height, segmentation.width, CV_32FC1);
  for (const std::size_t i : chosen) {
    require(i < segmentation.instances.size(), "PropagatedSegmentation::soft_mask", "chosen", i,
            "less than " + std::to_string(segmentation.instances.size()));
    const Instance& instance = segmentation.instances[i];
    cv::Mat window = soft(instance.box);
    cv::Mat covered(instance.box.size(), CV_32FC1, cv::Scalar(0));
    covered.setTo(confidence[i], instance.mask);
    cv::max(window, covered, window);
  }
  if (softness > 0) cv::blur(soft, soft, cv::Size(2 * softness + 1, 2 * softness + 1));
  return soft;
}

namespace {

struct Remembered {
  std::uint64_t index = 0;
  double timestamp = 0.0;
  FlowImage image;
  std::vector<float> depth;  // empty if the frame has none

  DepthView depth_view() const {
    if (depth.empty()) return {};
    return DepthView(depth.data(), image.full.width, image.full.height);
  }
};

std::vector<float> copy_depth(DepthView depth) {
  std::vector<float> copy;
  if (depth.empty()) return copy;
  const auto width = static_cast<std::size_t>(depth.width);
  copy.resize(width * static_cast<std::size_t>(depth.height));
  for (int y = 0; y < depth.height; ++y) {
    std::memcpy(copy.data() + static_cast<std::size_t>(y) * width, depth.row(y),
                width * sizeof(float));
  }
  return copy;
}

}  // namespace

struct MaskPropagator::Impl {
  PropagationOptions options;
  DepthRefiner refiner;
  std::deque<Remembered> frames;  // oldest first
  std::optional<Segmentation> source;
  std::uint64_t source_index = 0;
  // Of the source's instances: their corners, followed up to the frame `tracked_index`, and their
  // depths (metres, 0 = unknown).
  std::vector<PointTracks> tracks;
  std::uint64_t tracked_index = 0;
  std::vector<float> depths;
  std::optional<PropagatedSegmentation> result;
  bool result_is_fresh = false;

  CarryOptions carry_options() const {
    CarryOptions carry;
    carry.max_points = options.max_points;
    carry.max_error_px = options.max_error_px;
    return carry;
  }
  std::size_t place_of(std::uint64_t index) const {
    std::size_t place = 0;
    while (place < frames.size() && frames[place].index != index) ++place;
    return place;
  }
  void start(std::size_t place);
  void carry_to_newest(PropagatedSegmentation& out);
  void compute();
};

void MaskPropagator::Impl::start(std::size_t place) {
  tracks = start_tracks(frames[place].image, source->instances, carry_options());
  tracked_index = source_index;
  depths.clear();
  for (const Instance& instance : source->instances) {
    depths.push_back(median_depth(instance, frames[place].depth_view()));
  }
  drop_foreign_corners(tracks, frames[place].depth_view(), depths);
}

void MaskPropagator::Impl::carry_to_newest(PropagatedSegmentation& out) {
  for (std::size_t place = place_of(tracked_index); place + 1 < frames.size(); ++place) {
    advance_tracks(tracks, frames[place].image, frames[place + 1].image, carry_options());
    drop_foreign_corners(tracks, frames[place + 1].depth_view(), depths);
  }
  const Remembered& to = frames.back();
  tracked_index = to.index;
  auto carried = move_instances(source->instances, tracks, to.image.full);
  const double decay = std::pow(0.5, out.age / options.half_life);
  for (std::size_t i = 0; i < carried.size(); ++i) {
    CarriedInstance& one = carried[i];
    if (one.instance.box.empty()) continue;
    if (options.follow_depth) keep_depth(one.instance, to.depth_view(), depths[i]);
    out.segmentation.instances.push_back(std::move(one.instance));
    // What lost all its corners keeps half of what age leaves.
    out.confidence.push_back(static_cast<float>(decay * (0.5 + 0.5 * one.tracked)));
  }
  if (options.follow_depth) refiner.refine(out.segmentation, to.depth_view());
}

void MaskPropagator::Impl::compute() {
  result_is_fresh = true;
  result.reset();
  if (!source || frames.empty()) return;
  const std::size_t from = place_of(source_index);
  if (from == frames.size()) return;
  const std::size_t age = frames.size() - 1 - from;
  if (age > static_cast<std::size_t>(options.max_age)) return;
  PropagatedSegmentation out;
  out.segmentation.width = source->width;
  out.segmentation.height = source->height;
  out.source_index = source_index;
  out.age = static_cast<int>(age);
  out.age_seconds = frames.back().timestamp - frames[from].timestamp;
  if (age == 0) {
    out.segmentation = *source;
    out.confidence.assign(source->instances.size(), 1.0F);
  } else {
    carry_to_newest(out);
  }
  result = std::move(out);
}

MaskPropagator::MaskPropagator(const PropagationOptions& options)
    : impl_(std::make_unique<Impl>()) {
  options.validate();
  impl_->options = options;
  impl_->refiner = DepthRefiner(options.depth);
}
MaskPropagator::~MaskPropagator() = default;
MaskPropagator::MaskPropagator(MaskPropagator&&) noexcept = default;
MaskPropagator& MaskPropagator::operator=(MaskPropagator&&) noexcept = default;

void MaskPropagator::add_frame(const cv::Mat& image, const FrameInfo& frame) {
  require_segmentable("MaskPropagator::add_frame", image, frame);
  Impl& self = *impl_;
  if (!self.frames.empty()) {
    require(frame.index > self.frames.back().index, "MaskPropagator::add_frame", "frame.index",
            frame.index, "more than the last one, " + std::to_string(self.frames.back().index));
    require(image.size() == self.frames.back().image.full, "MaskPropagator::add_frame", "image",
            std::to_string(image.cols) + "x" + std::to_string(image.rows),
            "the size of the frames before");
  }
  self.frames.push_back(
      {frame.index, frame.timestamp, make_flow_image(image), copy_depth(frame.depth)});
  while (self.frames.size() > static_cast<std::size_t>(self.options.history)) {
    self.frames.pop_front();
  }
  self.result_is_fresh = false;
}

bool MaskPropagator::set_segmentation(std::uint64_t index, Segmentation segmentation) {
  Impl& self = *impl_;
  const std::size_t place = self.place_of(index);
  if (place == self.frames.size() || (self.source && index < self.source_index)) return false;
  const cv::Size size = self.frames[place].image.full;
  require(segmentation.width == size.width && segmentation.height == size.height,
          "MaskPropagator::set_segmentation", "segmentation",
          std::to_string(segmentation.width) + "x" + std::to_string(segmentation.height),
          "the frames' size");
  self.source = std::move(segmentation);
  self.source_index = index;
  self.start(place);
  self.result_is_fresh = false;
  return true;
}

std::optional<PropagatedSegmentation> MaskPropagator::current() {
  if (!impl_->result_is_fresh) impl_->compute();
  return impl_->result;
}

}  // namespace dynslam::segmentation
