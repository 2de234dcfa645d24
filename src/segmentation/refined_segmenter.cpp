#include "dynslam/segmentation/refined_segmenter.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <opencv2/core.hpp>

#include "dynslam/core/errors.hpp"

#include "segmentation/mask_carrier.hpp"
#include "segmentation/stopwatch.hpp"

namespace dynslam::segmentation {

void RefinementOptions::validate() const {
  const auto share = [](double value, const char* name) {
    require(value >= 0.0 && value <= 1.0, "RefinementOptions", name, value, "a number from 0 to 1");
  };
  share(static_cast<double>(score), "score");
  require(max_bridged >= 0, "RefinementOptions", "max_bridged", max_bridged, "at least 0 frames");
  require(std::isfinite(max_gap) && max_gap > 0.0, "RefinementOptions", "max_gap", max_gap,
          "a positive number of seconds");
  share(min_overlap, "min_overlap");
  share(min_tracked, "min_tracked");
  depth.validate();
}

namespace {

// An instance that is remembered.
struct Track {
  Instance instance;   // as last seen or carried
  int missed = 0;      // frames since it was detected
  float depth = 0.0F;  // median under the mask, 0 = unknown
};

constexpr int kMinPixels = 64;    // a smaller rest of an instance is not carried on
constexpr double kMinKept = 0.5;  // share of a carried mask that must be at the expected depth

}  // namespace

struct RefinedSegmenter::Impl {
  std::unique_ptr<Segmenter> inner;
  RefinementOptions options;
  DepthRefiner refiner;

  std::vector<Track> tracks;
  FlowImage last_image;
  std::uint64_t last_index = 0;
  double last_timestamp = 0.0;
  int next_label = 1;

  void forget_if_new(const cv::Mat& image, const FrameInfo& frame);
  void carry_tracks(const FlowImage& image, const FrameInfo& frame);
  bool settle(Track& track, const FrameInfo& frame);
  void associate(Segmentation& found, const FrameInfo& frame);
};

void RefinedSegmenter::Impl::forget_if_new(const cv::Mat& image, const FrameInfo& frame) {
  const double gap = frame.timestamp - last_timestamp;
  if (!last_image.empty() && last_image.full == image.size() && frame.index > last_index &&
      gap >= 0.0 && gap <= options.max_gap) {
    return;
  }
  tracks.clear();
  last_image = {};
}

// Moves every track to the new frame; those that cannot be followed end.
void RefinedSegmenter::Impl::carry_tracks(const FlowImage& image, const FrameInfo& frame) {
  if (tracks.empty()) return;
  std::vector<Instance> before;
  for (const Track& track : tracks) before.push_back(track.instance);
  CarryOptions carry;
  carry.max_points = 60;
  auto carried = carry_instances(last_image, image, before, carry);
  std::vector<Track> alive;
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    Instance& instance = carried[i].instance;
    if (instance.box.empty() || carried[i].tracked < options.min_tracked) continue;
    if (keep_depth(instance, frame.depth, tracks[i].depth) < kMinKept) continue;
    if (cv::countNonZero(instance.mask) < kMinPixels) continue;
    alive.push_back(std::move(tracks[i]));
    alive.back().instance = std::move(instance);
  }
  tracks = std::move(alive);
}

// Fits a carried mask to the depth of the new frame; false if that shows something else.
bool RefinedSegmenter::Impl::settle(Track& track, const FrameInfo& frame) {
  if (options.follow_depth && !frame.depth.empty()) {
    Segmentation one;
    one.width = frame.depth.width;
    one.height = frame.depth.height;
    one.instances.push_back(std::move(track.instance));
    refiner.refine(one, frame.depth);
    track.instance = std::move(one.instances.front());
  }
  const float depth = median_depth(track.instance, frame.depth);
  const bool known = depth > 0.0F && track.depth > 0.0F;
  if (known && std::abs(depth - track.depth) > kMaxDepthJump * track.depth) return false;
  if (depth > 0.0F) track.depth = depth;
  return true;
}

// Joins detections to tracks, best first; then decides who is seen.
void RefinedSegmenter::Impl::associate(Segmentation& found, const FrameInfo& frame) {
  std::vector<bool> matched(tracks.size(), false);
  std::vector<Instance> seen;
  for (Instance& detection : found.instances) {
    std::size_t best = tracks.size();
    double best_iou = options.min_overlap;
    for (std::size_t t = 0; t < matched.size(); ++t) {
      if (matched[t] || tracks[t].instance.class_id != detection.class_id) continue;
      const double iou = overlap_of(detection, tracks[t].instance).iou();
      if (iou > best_iou) {
        best = t;
        best_iou = iou;
      }
    }
    const bool known = best < tracks.size();
    if (!known && detection.score < options.score) continue;
    if (!known) {
      tracks.emplace_back();
      tracks.back().instance.label = next_label++;
    } else {
      matched[best] = true;
    }
    Track& track = known ? tracks[best] : tracks.back();
    detection.label = track.instance.label;
    detection.score = std::max(detection.score, options.score);
    track.instance = detection;
    track.missed = 0;
    track.depth = median_depth(detection, frame.depth);
    seen.push_back(std::move(detection));
  }
  // What was not detected goes on for a while, unless the others cover it already.
  std::vector<Track> kept;
  for (std::size_t t = 0; t < tracks.size(); ++t) {
    Track& track = tracks[t];
    if (t < matched.size() && !matched[t]) {
      const bool covered = std::any_of(seen.begin(), seen.end(), [&](const Instance& other) {
        return other.class_id == track.instance.class_id &&
               overlap_of(track.instance, other).of_smaller() > 0.7;
      });
      if (covered || ++track.missed > options.max_bridged || !settle(track, frame)) continue;
      seen.push_back(track.instance);
    }
    kept.push_back(std::move(track));
  }
  tracks = std::move(kept);
  std::stable_sort(seen.begin(), seen.end(),
                   [](const Instance& a, const Instance& b) { return a.score > b.score; });
  found.instances = std::move(seen);
}

RefinedSegmenter::RefinedSegmenter(std::unique_ptr<Segmenter> inner,
                                   const RefinementOptions& options)
    : impl_(std::make_unique<Impl>()) {
  require(inner != nullptr, "RefinedSegmenter", "inner", "null", "a segmenter");
  options.validate();
  impl_->inner = std::move(inner);
  impl_->options = options;
  impl_->refiner = DepthRefiner(options.depth);
}

RefinedSegmenter::~RefinedSegmenter() = default;

Segmentation RefinedSegmenter::segment(const cv::Mat& image, const FrameInfo& frame) {
  const Stopwatch total;
  require_segmentable("RefinedSegmenter::segment", image, frame);
  Impl& self = *impl_;
  Segmentation found = self.inner->segment(image, frame);
  if (self.options.masks_from_boxes) {
    self.refiner.masks_from_boxes(found, frame.depth);
  } else if (self.options.follow_depth) {
    self.refiner.refine(found, frame.depth);
  }
  if (self.options.bridge) {
    self.forget_if_new(image, frame);
    FlowImage flow = make_flow_image(image);
    self.carry_tracks(flow, frame);
    self.associate(found, frame);
    self.last_image = std::move(flow);
    self.last_index = frame.index;
    self.last_timestamp = frame.timestamp;
  } else {
    auto& list = found.instances;
    list.erase(std::remove_if(list.begin(), list.end(),
                              [&](const Instance& i) { return i.score < self.options.score; }),
               list.end());
  }
  found.total_ms = total.ms();
  return found;
}

const std::vector<std::string>& RefinedSegmenter::class_names() const {
  return impl_->inner->class_names();
}

SegmenterInfo RefinedSegmenter::info() const { return impl_->inner->info(); }

}  // namespace dynslam::segmentation
