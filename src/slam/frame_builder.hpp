// From an image to the features that the system works on.
#pragma once

#include <optional>
#include <vector>

#include <opencv2/core.hpp>

#include "dynslam/core/camera.hpp"
#include "dynslam/features/orb.hpp"
#include "dynslam/slam/frame.hpp"
#include "dynslam/slam/options.hpp"
#include "dynslam/slam/stereo_matcher.hpp"

#include "tracked_frame.hpp"

namespace dynslam::slam {

/// What moved in the frame before, outside of its own mask.
struct KnownMovers {
  cv::Mat mask;        ///< CV_8UC1, not 0 where something moved; empty: nothing is known
  double share = 0.0;  ///< of the image, 0..1
};

class FrameBuilder {
 public:
  FrameBuilder(const DepthCamera& camera, const SystemOptions& options);

  /// Throws InvalidArgument if an image is not what FrameInput says, or if it lacks what the sensor
  /// must give.
  void require_valid(const FrameInput& frame) const;

  /// With geometry the features are spread off what is masked and what moved a frame ago; the more
  /// of the image that hides, the more there are.
  FrameFeaturesPtr build(const FrameInput& frame, const KnownMovers& movers);

  /// Sets the depth of `copy`, without what is masked, and for the search for movers its mask and
  /// hidden depth; releases what the frame does not have or nobody asks for.
  void copy_depth(const FrameInput& frame, TrackedFrame& copy) const;

  /// Gives away the last image built from, grey, for memory to write the next one to.
  void swap_gray(cv::Mat& gray) { cv::swap(gray_, gray); }
  /// The same at a quarter of its size.
  const cv::Mat& gray_cells() const { return gray_cells_; }

  /// Sets the levels of the last image's pyramid; the views are valid until the next build(). None
  /// of a single camera's: points get their looks from a later keyframe than their places there.
  void view_levels(std::vector<GrayView>& levels) const;

  const std::vector<float>& scale_factors() const { return extractor_.scale_factors(); }

 private:
  features::OrbBudget budget(double masked_share, const KnownMovers& movers);
  void add_depth(const cv::Mat& depth, FrameFeatures& features) const;
  void add_stereo(const cv::Mat& right, FrameFeatures& features);

  DepthCamera camera_;
  Sensor sensor_;
  bool geometry_;
  double max_depth_;
  double max_stereo_depth_;
  features::OrbExtractor extractor_;
  std::optional<StereoMatcher> stereo_;
  cv::Mat gray_, gray_cells_, right_gray_, crowd_;
};

}  // namespace dynslam::slam
