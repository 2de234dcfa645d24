// From an image to the features that the system works on.
#pragma once

#include <optional>
#include <vector>

#include <opencv2/core/mat.hpp>

#include "dynslam/core/camera.hpp"
#include "dynslam/features/orb.hpp"
#include "dynslam/slam/frame.hpp"
#include "dynslam/slam/options.hpp"
#include "dynslam/slam/stereo_matcher.hpp"

namespace dynslam::slam {

class FrameBuilder {
 public:
  FrameBuilder(const DepthCamera& camera, const SystemOptions& options);

  /// Throws InvalidArgument if an image is not what FrameInput says, or if it lacks what the sensor
  /// must give.
  void require_valid(const FrameInput& frame) const;

  FrameFeaturesPtr build(const FrameInput& frame);

  /// Copies the depth image without what is masked; releases `depth` without one.
  void copy_depth(const FrameInput& frame, cv::Mat& depth) const;
  /// Copies mask and whole depth image of a frame that has both; else releases them.
  void copy_masked(const FrameInput& frame, cv::Mat& mask, cv::Mat& depth) const;

  /// The last image built from, grey; for gray input the caller's pixels.
  const cv::Mat& gray() const { return gray_; }
  /// The same at a quarter of its size.
  const cv::Mat& gray_cells() const { return gray_cells_; }

  const std::vector<float>& scale_factors() const { return extractor_.scale_factors(); }

 private:
  void add_depth(const cv::Mat& depth, FrameFeatures& features) const;
  void add_stereo(const cv::Mat& right, FrameFeatures& features);

  DepthCamera camera_;
  Sensor sensor_;
  double max_depth_;
  double max_stereo_depth_;
  features::OrbExtractor extractor_;
  std::optional<StereoMatcher> stereo_;
  cv::Mat gray_, gray_cells_, right_gray_;
};

}  // namespace dynslam::slam
