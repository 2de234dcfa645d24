#include "surface_normal.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Cholesky>

namespace dynslam::slam {
namespace {

constexpr int kSteps = 4;  // of the grid, from its middle
constexpr int kSamples = (2 * kSteps + 1) * (2 * kSteps + 1);
constexpr double kFewest = 0.6 * kSamples;  // samples of a plane
// Inverse metres that samples may be off the plane, by round: a Kinect's noise is 0.002. The first
// knows only how far the middle is.
constexpr double kTolerances[] = {0.06, 0.02, 0.0075, 0.0075};

struct Sample {
  Eigen::Vector3d ray;  // z = 1
  double inverse_depth;
};

}  // namespace

std::optional<Eigen::Vector3d> surface_normal(const cv::Mat& depth, cv::Point2f pixel, float radius,
                                              const PinholeCamera& camera) {
  std::array<Sample, kSamples> samples;
  std::size_t count = 0;
  double middle = 0.0;
  const float step = std::max(1.0F, radius / static_cast<float>(kSteps));
  for (int j = -kSteps; j <= kSteps; ++j) {
    for (int i = -kSteps; i <= kSteps; ++i) {
      const int x = cvRound(pixel.x + static_cast<float>(i) * step);
      const int y = cvRound(pixel.y + static_cast<float>(j) * step);
      if (x < 0 || y < 0 || x >= depth.cols || y >= depth.rows) continue;
      const float z = depth.at<float>(y, x);
      if (!(z > 0.0F)) continue;
      const Eigen::Vector3d ray((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0);
      samples[count++] = {ray, 1.0 / static_cast<double>(z)};
      if (i == 0 && j == 0) middle = samples[count - 1].inverse_depth;
    }
  }
  if (!(middle > 0.0) || static_cast<double>(count) < kFewest) return std::nullopt;
  Eigen::Vector3d plane(0.0, 0.0, middle);  // its inverse depth along a ray is their product
  for (const double tolerance : kTolerances) {
    Eigen::Matrix3d H = Eigen::Matrix3d::Zero();
    Eigen::Vector3d b = Eigen::Vector3d::Zero();
    int used = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const Sample& sample = samples[i];
      if (std::abs(plane.dot(sample.ray) - sample.inverse_depth) > tolerance) continue;
      H += sample.ray * sample.ray.transpose();
      b += sample.ray * sample.inverse_depth;
      ++used;
    }
    if (used < kFewest) return std::nullopt;
    plane = H.ldlt().solve(b);
  }
  if (!plane.allFinite() || plane.isZero()) return std::nullopt;
  return plane.normalized();
}

}  // namespace dynslam::slam
