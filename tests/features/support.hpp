// What the tests of the room share: images without data, and a walk over the vector targets.
#pragma once

#include <cstdint>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include <hwy/highway.h>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/image_view.hpp"
#include "dynslam/core/opencv.hpp"

namespace dynslam::features::testing {

inline constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
inline constexpr float kInfinity = std::numeric_limits<float>::infinity();

inline DescriptorsView view(const cv::Mat& descriptors) {
  return as_view<const std::uint8_t>(descriptors);
}

/// Whole number in [low, high], the same with every standard library.
inline int uniform(std::mt19937& random, int low, int high) {
  return low + static_cast<int>(random() % static_cast<unsigned>(high - low + 1));
}

/// Overlapping turned rectangles of all sizes with a little noise: corners of many strengths on
/// many scales.
inline cv::Mat texture(int width, int height, unsigned seed = 1) {
  std::mt19937 random(seed);
  cv::Mat image(height, width, CV_8UC1, cv::Scalar(110));
  const int count = width * height / 500;
  for (int i = 0; i < count; ++i) {
    const cv::Point2f centre(static_cast<float>(uniform(random, 0, width)),
                             static_cast<float>(uniform(random, 0, height)));
    const int side = 80 / uniform(random, 1, 12) + 3;
    const cv::Size2f size(static_cast<float>(side), static_cast<float>(uniform(random, 3, side)));
    const cv::RotatedRect box(centre, size, static_cast<float>(uniform(random, 0, 179)));
    cv::Point2f corners[4];
    box.points(corners);
    cv::Point polygon[4];
    for (int k = 0; k < 4; ++k) polygon[k] = corners[k];
    cv::fillConvexPoly(image, polygon, 4, cv::Scalar(uniform(random, 0, 255)));
  }
  cv::GaussianBlur(image, image, cv::Size(3, 3), 0.7);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      std::uint8_t& pixel = image.at<std::uint8_t>(y, x);
      pixel = cv::saturate_cast<std::uint8_t>(pixel + uniform(random, -2, 2));
    }
  }
  return image;
}

/// Every pixel at random: the hardest case for kernels that skip what is flat.
inline cv::Mat noise(int width, int height, unsigned seed, int low = 0, int high = 255) {
  std::mt19937 random(seed);
  cv::Mat image(height, width, CV_8UC1);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      image.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(uniform(random, low, high));
    }
  }
  return image;
}

inline bool same_bytes(const cv::Mat& a, const cv::Mat& b) {
  return a.size() == b.size() && a.type() == b.type() &&
         (a.empty() || cv::norm(a, b, cv::NORM_INF) == 0.0);
}

/// Runs `test(name)` once with each kind of vector instructions that was compiled and that this
/// machine has.
template <typename Test>
void for_each_target(const Test& test) {
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().Update(target);
    test(std::string(hwy::TargetName(target)));
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}

}  // namespace dynslam::features::testing
