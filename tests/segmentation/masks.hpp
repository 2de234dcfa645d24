// Masks and images of the tests of this room.
#pragma once

#include <algorithm>

#include <opencv2/core.hpp>

#include "dynslam/segmentation/segmenter.hpp"

namespace dynslam::segmentation {

inline const cv::Size kSize(320, 240);  ///< of the scenes

inline cv::Mat grey(int width, int height) {
  return cv::Mat(height, width, CV_8UC3, cv::Scalar::all(99));
}

/// All instances in one mask of the image's size.
inline cv::Mat whole(const Segmentation& found) {
  cv::Mat mask = cv::Mat::zeros(found.height, found.width, CV_8UC1);
  for (const Instance& instance : found.instances) mask(instance.box) |= instance.mask;
  return mask;
}

/// Intersection over union; 0 of two empty masks.
inline double iou(const cv::Mat& a, const cv::Mat& b) {
  return static_cast<double>(cv::countNonZero(a & b)) / std::max(1, cv::countNonZero(a | b));
}

}  // namespace dynslam::segmentation
