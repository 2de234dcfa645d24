#include "dynslam/segmentation/mask_propagation.hpp"

#include <algorithm>
#include <cmath>
#include <deque>
#include <utility>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"

#include "segmentation/carried_surfaces.hpp"
#include "segmentation/corner_tracker.hpp"
#include "segmentation/depth_window.hpp"
#include "segmentation/mask_carrier.hpp"

namespace dynslam::segmentation {

void PropagationOptions::validate() const {
  require(history >= 2 && history <= 1000, "PropagationOptions", "history", history,
          "2 to 1000 frames");
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

// How far from the depth that was carried with it a cell may be, as a share: limbs move, noise is
// 1 to 2 %; less than two people one behind the other are apart.
constexpr float kMaxCarriedJump = 0.07F;
// What nothing but an occluder can have kept out of a mask may be many times what was seen.
constexpr double kMaxHiddenGrowth = 8.0;

// Without branches, so that it is vectorized.
void drop_in_row(const float* z, const float* carried, float change, const std::uint8_t* outside,
                 int width, std::uint8_t* in) {
  for (int x = 0; x < width; ++x) {
    const float expected = carried[x] * change;
    const float jump = measured(z[x]) ? std::abs(z[x] - expected) : 0.0F;
    const float limit = measured(expected) ? kMaxCarriedJump * expected : jump;
    const std::uint8_t kept = jump > limit ? 0 : in[x];
    in[x] = outside[x] != 0 ? 0 : kept;
  }
}

constexpr std::size_t kEnoughCorners = 4;  // that a motion can be told from
constexpr int kMinPart = 64;  // half-resolution cells of a surface that moves by itself

struct Remembered {
  std::uint64_t index = 0;
  double timestamp = 0.0;
  HalfDepth half;  // no cells if the frame has no depth
};

}  // namespace

struct MaskPropagator::Impl {
  PropagationOptions options;
  CornerTracker tracker{2, 1.5};
  DepthWindow window;
  cv::Size full;
  std::deque<Remembered> frames;  // oldest first
  cv::Mat depth;                  // of the newest frame, empty if it has none; may be the caller's
  cv::Mat own_depth;              // memory for a copy of it
  std::optional<Segmentation> source;
  std::uint64_t source_index = 0;
  std::optional<PropagatedSegmentation> result;
  bool result_is_fresh = false;

  // Scratch of the frame being computed.
  CarriedCorners corners;
  std::vector<std::uint8_t> outside;  // cells whose surface was outside all masks
  std::vector<std::uint8_t> hidden;   // cells around an instance that could not be seen before

  DepthView depth_view() const { return depth.empty() ? DepthView() : as_view<const float>(depth); }
  std::size_t place_of(std::uint64_t index) const {
    std::size_t place = 0;
    while (place < frames.size() && frames[place].index != index) ++place;
    return place;
  }
  void begin_frame(const FrameInfo& frame);
  void add(const cv::Mat& image, const cv::Mat& newest_depth, const FrameInfo& frame);
  void require_next(const char* caller, const cv::Mat& image, const FrameInfo& frame) const;
  void remember_depth(const cv::Mat& newest);
  std::vector<int> count_corners(std::size_t place) const;
  PointTracks tracks_of(std::size_t instance) const;
  cv::Rect reach_of_masks() const;
  std::vector<cv::Rect> windows_of_masks() const;
  float depth_change(const PointTracks& tracks, const HalfDepth& before) const;
  CellMask move_parts(const CellMask& was, const PointTracks& all, const PointTracks& alike,
                      cv::Point2f common, const HalfDepth* before) const;
  void drop_other_depths(CellMask& mask, float change) const;
  void fit(Instance& instance, bool with_hidden);
  void carry(std::size_t i, std::size_t place, Instance& instance, double& tracked);
  void add_revealed(std::size_t place, PropagatedSegmentation& out);
  void carry_to_newest(std::size_t place, PropagatedSegmentation& out);
  void compute();
};

void MaskPropagator::Impl::remember_depth(const cv::Mat& newest) {
  HalfDepth& half = frames.back().half;
  if (newest.empty() || !options.follow_depth) {
    depth.release();
    half = {};
    return;
  }
  depth = newest;
  half.build(depth_view(), options.depth);
}

// The newest frame's place, with the memory of one that is forgotten.
void MaskPropagator::Impl::begin_frame(const FrameInfo& frame) {
  HalfDepth used;
  while (frames.size() >= static_cast<std::size_t>(options.history)) {
    used = std::move(frames.front().half);
    frames.pop_front();
  }
  frames.push_back({frame.index, frame.timestamp, std::move(used)});
}

// Corners that each instance had in its own frame.
std::vector<int> MaskPropagator::Impl::count_corners(std::size_t place) const {
  std::vector<int> counts(source->instances.size(), 0);
  for (const Corner& corner : tracker.of_frame(place)) {
    const int label = label_at(corner.at, source->instances);
    if (label >= 0) ++counts[static_cast<std::size_t>(label)];
  }
  return counts;
}

PointTracks MaskPropagator::Impl::tracks_of(std::size_t instance) const {
  PointTracks tracks;
  for (std::size_t i = 0; i < corners.pairs.size(); ++i) {
    if (corners.labels[i] != static_cast<int>(instance)) continue;
    tracks.from.push_back(corners.pairs[i].from);
    tracks.to.push_back(corners.pairs[i].to);
  }
  return tracks;
}

// How many times farther the corners are now than they were; 1 if that is not known.
float MaskPropagator::Impl::depth_change(const PointTracks& tracks, const HalfDepth& before) const {
  const HalfDepth& now = frames.back().half;
  std::vector<float> ratios;
  for (std::size_t i = 0; i < tracks.from.size(); ++i) {
    const float z0 = before.nearest(tracks.from[i]);
    const float z1 = now.nearest(tracks.to[i]);
    if (measured(z0) && measured(z1)) ratios.push_back(z1 / z0);
  }
  return ratios.size() < kEnoughCorners ? 1.0F : median_of(ratios);
}

// A mask may hold several things, each with a motion of its own (recorded masks, people side by
// side): every smooth surface goes with its own corners if it has enough, else with
// those that move alike.
CellMask MaskPropagator::Impl::move_parts(const CellMask& was, const PointTracks& all,
                                          const PointTracks& alike, cv::Point2f common,
                                          const HalfDepth* before) const {
  const cv::Size half((full.width + 1) / 2, (full.height + 1) / 2);
  if (before == nullptr) return move_cells(was, alike, common, half);
  CellMask whole;
  whole.cells = cv::Rect(cv::Point(), half);
  whole.in = cv::Mat::zeros(half, CV_8UC1);
  for (const CellMask& part : smooth_parts(was, options.depth, kMinPart)) {
    PointTracks own;
    for (std::size_t i = 0; i < all.from.size(); ++i) {
      const cv::Point cell = cv::Point(static_cast<int>(std::lround(all.from[i].x)),
                                       static_cast<int>(std::lround(all.from[i].y))) -
                             part.cells.tl();
      if (!cv::Rect(cv::Point(), part.cells.size()).contains(cell)) continue;
      if (part.in.at<std::uint8_t>(cell) == 0) continue;
      own.from.push_back(all.from[i]);
      own.to.push_back(all.to[i]);
    }
    cv::Point2f motion = common;
    if (own.from.size() >= kEnoughCorners) {
      motion = keep_the_common_motion(own);
    } else {
      own = alike;
    }
    CellMask moved = move_cells(part, own, motion, half);
    if (moved.cells.empty()) continue;
    drop_other_depths(moved, depth_change(own, *before));
    cv::Mat place = whole.in(moved.cells);
    cv::bitwise_or(place, moved.in, place);
  }
  return whole;
}

// Takes out what is at another depth than the carried one: what came before the instance, what it
// left behind; and what the corners say was outside all masks.
void MaskPropagator::Impl::drop_other_depths(CellMask& mask, float change) const {
  const HalfDepth& now = frames.back().half;
  for (int y = 0; y < mask.cells.height; ++y) {
    const auto row = static_cast<std::ptrdiff_t>(mask.cells.y + y) * now.width + mask.cells.x;
    drop_in_row(now.z.data() + row, mask.z.ptr<float>(y), change, outside.data() + row,
                mask.cells.width, mask.in.ptr(y));
  }
}

// As DepthRefiner::refine; then into what was hidden, where the limits of size do not hold.
void MaskPropagator::Impl::fit(Instance& instance, bool with_hidden) {
  if (!window.open(frames.back().half, options.depth, instance)) return;
  window.grow_beside_the_mask();
  if (with_hidden) window.grow_up_and_down(kMaxHiddenGrowth, hidden);
  window.add_parts_behind();
  window.fill_holes();
  window.write(depth_view(), instance);
}

// Instance `i` of the source in the newest frame; its box is empty if nothing is left of it.
void MaskPropagator::Impl::carry(std::size_t i, std::size_t place, Instance& instance,
                                 double& tracked) {
  const HalfDepth& before = frames[place].half;
  const bool deep = !depth.empty();
  const bool deep_before = deep && !before.z.empty();
  const PointTracks all = tracks_of(i);
  tracked = static_cast<double>(all.from.size());
  cv::Point2f common(0, 0);
  PointTracks alike = all;
  if (!alike.from.empty()) common = keep_the_common_motion(alike);
  const CellMask was = cell_mask(source->instances[i], deep_before ? &before : nullptr);
  CellMask mask = move_parts(was, all, alike, common, deep_before ? &before : nullptr);
  if (deep && !deep_before && !mask.cells.empty()) drop_other_depths(mask, 1.0F);
  instance = source->instances[i];
  paint_cells(mask, full, instance);
  if (!deep || instance.box.empty()) return;
  if (deep_before) {
    const auto margin =
        static_cast<int>(options.depth.side_margin * std::min(was.cells.width, was.cells.height));
    cells_hidden_before(was, common, before, frames.back().half, margin, hidden);
  }
  fit(instance, deep_before);
}

// What comes out from behind an instance and stands before its surroundings is a thing that nobody
// has judged yet: it counts as what hid it, until the network has seen it.
void MaskPropagator::Impl::add_revealed(std::size_t place, PropagatedSegmentation& out) {
  const HalfDepth& now = frames.back().half;
  std::vector<std::uint8_t> taken(now.z.size(), 0);
  for (const Instance& instance : out.segmentation.instances) {
    const CellMask mask = cell_mask(instance, nullptr);
    cv::Mat(now.height, now.width, CV_8UC1, taken.data())(mask.cells).setTo(1, mask.in);
  }
  const double decay = std::pow(0.5, out.age / options.half_life);
  for (const RevealedThing& thing :
       revealed_things(frames[place].half, now, source->instances, corners, options.depth, taken)) {
    Instance instance = source->instances[thing.hider];
    instance.label = 0;
    paint_cells(thing.mask, full, instance);
    if (instance.box.empty()) continue;
    out.segmentation.instances.push_back(std::move(instance));
    out.confidence.push_back(static_cast<float>(0.5 * decay));
  }
}

// Around the masks of the frame before, or else those that the network gave last, half resolution,
// as far as a corner is heard.
std::vector<cv::Rect> MaskPropagator::Impl::windows_of_masks() const {
  std::vector<cv::Rect> windows;
  const auto add = [&windows](const Segmentation& found) {
    for (const Instance& instance : found.instances) {
      const cv::Rect cells = cells_of(instance.box);
      windows.emplace_back(cells.x - kVoiceCells, cells.y - kVoiceCells,
                           cells.width + 2 * kVoiceCells, cells.height + 2 * kVoiceCells);
    }
  };
  if (result) {
    add(result->segmentation);
  } else if (source) {
    add(*source);
  }
  return windows;
}

// Where masks can be in the newest frame, half resolution.
cv::Rect MaskPropagator::Impl::reach_of_masks() const {
  cv::Rect reach;
  for (std::size_t i = 0; i < source->instances.size(); ++i) {
    const PointTracks tracks = tracks_of(i);
    const cv::Point2f common = tracks.from.empty() ? cv::Point2f() : tracks.to[0] - tracks.from[0];
    const cv::Rect moved = reach_of(cells_of(source->instances[i].box), tracks, common);
    reach = reach.empty() ? moved : reach | moved;
  }
  return reach;
}

void MaskPropagator::Impl::carry_to_newest(std::size_t place, PropagatedSegmentation& out) {
  corners.pairs = tracker.pairs_since(place);
  corners.labels.clear();
  for (const CornerPair& pair : corners.pairs) {
    corners.labels.push_back(label_at(pair.from, source->instances));
  }
  if (!depth.empty()) {
    surfaces_from_outside(frames.back().half, corners, options.depth, reach_of_masks(), outside);
  }
  const std::vector<int> counts = count_corners(place);
  const double decay = std::pow(0.5, out.age / options.half_life);
  for (std::size_t i = 0; i < source->instances.size(); ++i) {
    Instance instance;
    double tracked = 0.0;
    carry(i, place, instance, tracked);
    if (instance.box.empty()) continue;
    out.segmentation.instances.push_back(std::move(instance));
    // What lost all its corners keeps half of what age leaves.
    const double share = counts[i] > 0 ? tracked / counts[i] : 0.0;
    out.confidence.push_back(static_cast<float>(decay * (0.5 + 0.5 * share)));
  }
  if (!depth.empty() && !frames[place].half.z.empty()) add_revealed(place, out);
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
    carry_to_newest(from, out);
  }
  result = std::move(out);
}

MaskPropagator::MaskPropagator(const PropagationOptions& options)
    : impl_(std::make_unique<Impl>()) {
  options.validate();
  impl_->options = options;
  impl_->tracker = CornerTracker(static_cast<std::size_t>(options.history), options.max_error_px);
}
MaskPropagator::~MaskPropagator() = default;
MaskPropagator::MaskPropagator(MaskPropagator&&) noexcept = default;
MaskPropagator& MaskPropagator::operator=(MaskPropagator&&) noexcept = default;

void MaskPropagator::Impl::require_next(const char* caller, const cv::Mat& image,
                                        const FrameInfo& frame) const {
  require_segmentable(caller, image, frame);
  if (frames.empty()) return;
  require(frame.index > frames.back().index, caller, "frame.index", frame.index,
          "more than the last one, " + std::to_string(frames.back().index));
  require(image.size() == full, caller, "image",
          std::to_string(image.cols) + "x" + std::to_string(image.rows),
          "the size of the frames before");
}

// What was checked by `require_next`.
void MaskPropagator::Impl::add(const cv::Mat& image, const cv::Mat& newest_depth,
                               const FrameInfo& frame) {
  full = image.size();
  begin_frame(frame);
  remember_depth(newest_depth);
  tracker.add(make_flow_image(image), frames.back().half, windows_of_masks());
  result_is_fresh = false;
}

void MaskPropagator::add_frame(const cv::Mat& image, const FrameInfo& frame) {
  impl_->require_next("MaskPropagator::add_frame", image, frame);
  if (impl_->options.follow_depth) as_mat(frame.depth).copyTo(impl_->own_depth);
  impl_->add(image, impl_->own_depth, frame);
}

void MaskPropagator::add_frame_shared(const cv::Mat& image, const cv::Mat& depth, FrameInfo frame) {
  constexpr const char* kName = "MaskPropagator::add_frame_shared";
  require_depth_image(kName, depth);
  frame.depth = as_view<const float>(depth);
  impl_->require_next(kName, image, frame);
  impl_->add(image, depth, frame);
}

bool MaskPropagator::set_segmentation(std::uint64_t index, Segmentation segmentation) {
  Impl& self = *impl_;
  const std::size_t place = self.place_of(index);
  if (place == self.frames.size() || (self.source && index < self.source_index)) return false;
  require_sound("MaskPropagator::set_segmentation", segmentation, self.full);
  self.source = std::move(segmentation);
  self.source_index = index;
  self.result_is_fresh = false;
  return true;
}

std::optional<PropagatedSegmentation> MaskPropagator::current() {
  if (!impl_->result_is_fresh) impl_->compute();
  return impl_->result;
}

}  // namespace dynslam::segmentation
