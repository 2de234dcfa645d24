// Images as the rooms want them.
#pragma once

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace dynslam::cli {

/// A frame's colour image, which may be grey already, in grey.
inline cv::Mat gray_of(const cv::Mat& color) {
  if (color.channels() == 1) return color;
  cv::Mat gray;
  cv::cvtColor(color, gray, cv::COLOR_BGR2GRAY);
  return gray;
}

}  // namespace dynslam::cli
