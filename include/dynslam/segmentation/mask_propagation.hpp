// Carries masks from the frame they were made for to the newest frame.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "dynslam/segmentation/depth_refinement.hpp"
#include "dynslam/segmentation/segmenter.hpp"

namespace dynslam::segmentation {

/// Depth rules for carried masks: as for fresh ones, but a carried mask may have missed more, so it
/// may grow more (max_growth 1.5, side_margin 0.5).
inline DepthRefinementOptions carried_depth_options() {
  DepthRefinementOptions options;
  options.max_growth = 1.5;
  options.side_margin = 0.5;
  return options;
}

/// How masks are carried.
struct PropagationOptions {
  int history = 16;           ///< frames kept, >= 2: a mask may be at most one less frames late
  double max_error_px = 1.5;  ///< forward-backward error of a tracked point, > 0 (Kalal 2010)
  int max_age = 15;           ///< frames after which an instance is given up, >= 1
  double half_life = 5.0;     ///< frames in which confidence halves, > 0 (engineering)
  bool follow_depth = true;   ///< refine carried masks with the depth of the frame, if it has any
  DepthRefinementOptions depth = carried_depth_options();

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Instances in the newest frame, some of them older than it.
struct PropagatedSegmentation {
  Segmentation segmentation;       ///< in the newest frame; score as at the source
  std::uint64_t source_index = 0;  ///< frame that the masks were made for
  int age = 0;                     ///< frames given since then; 0 = made for this frame
  double age_seconds = 0.0;
  std::vector<float> confidence;  ///< per instance, 0..1: falls with age and with lost points

  /// Probability that a pixel moves, CV_32FC1 in [0, 1], image size: the largest confidence of the
  /// instances in `chosen` (indices) that cover it; the border fades over `softness` pixels.
  cv::Mat soft_mask(const std::vector<std::size_t>& chosen, int softness) const;
};

/// Remembers the last frames and carries the newest segmentation to the newest of them.
///
/// A net of corners is followed from every frame to the next (pyramidal Lucas-Kanade, forward and
/// backward), whether masks come or not, so that the work of a frame is always the same. A mask
/// follows the smooth field of the motion of the corners inside it; then the depth of the newest
/// frame: out goes what is at another depth than the one carried along, and the surfaces that were
/// outside all masks at the source; in come the surfaces that continue the mask, as in
/// `DepthRefiner`, and without a limit of size where the source could not see (behind something
/// nearer, outside the image). Things that come out from behind an instance and stand before their
/// surroundings are added as instances of its class with `label` 0 and half its confidence: nobody
/// has judged them yet. An instance without tracked corners keeps its place and loses confidence
/// faster.
///
/// Not thread-safe: call it from the tracking thread, with results of `AsyncSegmenter::take`.
class MaskPropagator {
 public:
  /// Throws InvalidArgument for bad options.
  explicit MaskPropagator(const PropagationOptions& options = {});
  ~MaskPropagator();
  MaskPropagator(MaskPropagator&&) noexcept;
  MaskPropagator& operator=(MaskPropagator&&) noexcept;

  /// The next frame; `frame.index` must be larger than the last one's. Keeps a small grey copy of
  /// the newest frame and its depth, and for every remembered one the depth at half resolution
  /// (0.4 MB at 640x480). Throws InvalidArgument as `Segmenter::segment` does,
  /// for an index that does not grow, and for another image size than before. O(pixels).
  void add_frame(const cv::Mat& image, const FrameInfo& frame);

  /// The same without a copy of the depth: keeps a reference to it (CV_32FC1, or empty), whose
  /// pixels must not change until the next frame is added. `frame.depth` is not looked at. Throws
  /// InvalidArgument for a depth image of another type, too. O(pixels).
  void add_frame_shared(const cv::Mat& image, const cv::Mat& depth, FrameInfo frame);

  /// A segmentation of frame `index`, which may be older than the newest. False, and nothing
  /// happens, if that frame is not remembered any more or a newer segmentation is known already.
  /// Throws InvalidArgument, and keeps what it has, if the size is not that of the frames or an
  /// instance is not what a segmenter promises (`require_sound`).
  bool set_segmentation(std::uint64_t index, Segmentation segmentation);

  /// The newest segmentation in the newest frame; nothing before both are there, or when it is
  /// older than `max_age`. Computed on the first call after a change, then kept.
  std::optional<PropagatedSegmentation> current();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dynslam::segmentation
