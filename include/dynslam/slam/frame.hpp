// What the system keeps of an image.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include <opencv2/core/mat.hpp>
#include <opencv2/core/types.hpp>

#include "dynslam/core/image_view.hpp"
#include "dynslam/features/keypoint_grid.hpp"

namespace dynslam::slam {

/// One moment of the sensor, as the caller hands it in. Nothing is kept beyond the call but what
/// the features hold.
struct FrameInput {
  double timestamp = 0.0;  ///< seconds, strictly increasing
  cv::Mat image;           ///< 8UC3 (BGR) or 8UC1, size of the camera
  cv::Mat depth;           ///< 32FC1 metres, 0 or NaN = none, size of the image; may be empty
  cv::Mat mask;            ///< 8UC1, 0 static, 255 dynamic, size of the image; empty = all static
  cv::Mat right = {};      ///< the rectified right image, as `image`; empty unless kStereo
};

/// Features of one image; never changed once built, so shared between frames, keyframes and
/// threads.
struct FrameFeatures {
  std::vector<cv::KeyPoint> keypoints;  ///< N, level-0 pixels
  cv::Mat descriptors;                  ///< N x 32, CV_8U
  std::vector<float> depths;            ///< N, metres; 0 where there is none to build on
  std::vector<float> right_columns;     ///< N, u - bf / z; NaN where that is unknown
  std::vector<cv::Vec3b> colors;        ///< N, BGR
  /// N or fewer: how well a key point is known that was aligned with how its point looks, standard
  /// deviation in pixels of its level; 0, or missing, where it is a corner as it was found.
  /// Missing in features of stored maps.
  std::vector<float> alignment_sigmas;
  features::KeypointGrid grid;  ///< over the key points as they were found
  float masked_share = 0.0F;    ///< share of the image under the mask, 0..1
  /// So many of them, the last, are no corners: points of the map were found by their looks there,
  /// whose descriptors they have. 0 in features of stored maps.
  std::size_t sought = 0;

  std::size_t size() const { return keypoints.size(); }
  /// Whether a feature is one of those.
  bool is_sought(std::size_t i) const { return i >= size() - sought; }
  float alignment_sigma(std::size_t i) const {
    return i < alignment_sigmas.size() ? alignment_sigmas[i] : 0.0F;
  }
  const std::uint8_t* descriptor(std::size_t i) const {
    return descriptors.ptr<std::uint8_t>(static_cast<int>(i));
  }
  DescriptorsView descriptors_view() const { return first_descriptors(size()); }
  /// Of the corners alone: what this image tells that the map does not.
  DescriptorsView corner_descriptors() const { return first_descriptors(size() - sought); }

 private:
  DescriptorsView first_descriptors(std::size_t count) const {
    if (descriptors.empty()) return {};
    return {descriptors.data, descriptors.cols, static_cast<int>(count),
            static_cast<std::ptrdiff_t>(descriptors.step[0])};
  }
};

using FrameFeaturesPtr = std::shared_ptr<const FrameFeatures>;

}  // namespace dynslam::slam
