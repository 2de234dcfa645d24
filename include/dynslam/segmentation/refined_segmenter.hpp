// Makes any segmenter's answers steadier: masks that follow depth, and short memories of instances.
#pragma once

#include <memory>

#include "dynslam/segmentation/depth_refinement.hpp"
#include "dynslam/segmentation/segmenter.hpp"

namespace dynslam::segmentation {

/// What is done to a segmenter's answers.
struct RefinementOptions {
  /// Fit masks to the depth of frames that have it.
  bool follow_depth = true;
  /// Make masks from boxes and depth (for networks that give boxes only); implies nothing else.
  bool masks_from_boxes = false;
  /// Remember instances from frame to frame. Only for frames of one camera in their order.
  bool bridge = true;
  float score = 0.3F;    ///< from here on a detection counts by itself, 0..1 (YOLO's usual value)
  int max_bridged = 5;   ///< frames that a remembered instance lives without a detection, >= 0
  double max_gap = 1.0;  ///< seconds between frames after which everything is forgotten, > 0
  double min_overlap = 0.3;  ///< IoU that makes a detection that of a remembered instance, 0..1
  double min_tracked = 0.3;  ///< share of corners that must be found again, 0..1
  DepthRefinementOptions depth;

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Decorates a segmenter.
///
/// With `bridge`, every instance is remembered and carried from frame to frame by optical flow (and
/// depth). A detection weaker than `score` counts only where a remembered instance is (so give the
/// inner segmenter a lower threshold, 0.1 say; Zhang 2022, ByteTrack); an instance that was not
/// detected goes on for `max_bridged` frames while its corners are found again and its depth does
/// not jump. `Instance::label` becomes the number of the instance, from 1; an accepted instance
/// never has a score below `score`.
///
/// Memory is dropped when the image size changes, `FrameInfo::index` does not grow, or time jumps
/// by more than `max_gap` or backwards.
class RefinedSegmenter final : public Segmenter {
 public:
  /// Throws InvalidArgument if `inner` is null or an option breaks its rule.
  explicit RefinedSegmenter(std::unique_ptr<Segmenter> inner,
                            const RefinementOptions& options = {});
  ~RefinedSegmenter() override;

  /// As the inner segmenter. Costs in addition about 2 ms for depth and 4 ms for memory at 640x480.
  Segmentation segment(const cv::Mat& image, const FrameInfo& frame) override;
  const std::vector<std::string>& class_names() const override;
  SegmenterInfo info() const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dynslam::segmentation
