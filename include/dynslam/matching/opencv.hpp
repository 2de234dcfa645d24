// OpenCV's matches and key points as input of `reject`. The only header of this room that needs
// OpenCV (the types of its core module).
#pragma once

#include <cstddef>
#include <limits>

#include <opencv2/core/types.hpp>

#include "dynslam/matching/traits.hpp"

namespace dynslam::matching {

template <>
struct MatchTraits<cv::DMatch> {
  static Match get(const cv::DMatch& match, std::size_t) {
    return {match.queryIdx, match.trainIdx, match.distance};
  }
};

/// OpenCV writes angle -1 where a detector gives none.
template <>
struct KeypointTraits<cv::KeyPoint> {
  static Keypoint get(const cv::KeyPoint& keypoint) {
    return {keypoint.pt.x, keypoint.pt.y,
            keypoint.angle < 0.0F ? std::numeric_limits<float>::quiet_NaN() : keypoint.angle,
            keypoint.size};
  }
};

}  // namespace dynslam::matching
