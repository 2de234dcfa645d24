#include "slam/surface_normal.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "slam/vga_camera.hpp"

namespace dynslam::slam {
namespace {

// Depth of the plane normal.dot(X) = distance in every pixel, with a Kinect's noise.
cv::Mat plane_depth(const PinholeCamera& camera, const Eigen::Vector3d& normal, double distance,
                    unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0.0, 0.002);  // 1/m
  cv::Mat depth(camera.height, camera.width, CV_32FC1);
  for (int y = 0; y < depth.rows; ++y) {
    for (int x = 0; x < depth.cols; ++x) {
      const double inverse = normal.dot(camera.bearing({x, y})) / distance + noise(random);
      depth.at<float>(y, x) = inverse > 0.0 ? static_cast<float>(1.0 / inverse) : 0.0F;
    }
  }
  return depth;
}

Eigen::Vector3d slanted(double degrees) {
  const double angle = degrees * EIGEN_PI / 180.0;
  return {std::sin(angle), 0.0, std::cos(angle)};
}

double degrees_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::acos(std::min(1.0, a.dot(b))) * 180.0 / EIGEN_PI;
}

TEST(SurfaceNormal, IsThatOfThePlane) {
  for (const double slant : {-70.0, -30.0, 0.0, 45.0, 70.0}) {
    const Eigen::Vector3d truth = slanted(slant);
    for (unsigned seed = 1; seed <= 5; ++seed) {
      const cv::Mat depth = plane_depth(camera(), truth, 2.0 * truth.z(), seed);
      const auto normal = surface_normal(depth, {330.0F, 250.0F}, 10.0F, camera());
      ASSERT_TRUE(normal.has_value()) << slant;
      EXPECT_NEAR(normal->norm(), 1.0, 1e-9);
      EXPECT_LT(degrees_between(*normal, truth), 6.0) << slant;
    }
  }
}

TEST(SurfaceNormal, IsThatOfTheSurfaceOfThePixelBesideAnother) {
  const Eigen::Vector3d truth = slanted(40.0);
  cv::Mat depth = plane_depth(camera(), truth, 2.0 * truth.z(), 1);
  depth.colRange(334, depth.cols).setTo(1.2F);  // a third of the square
  const auto normal = surface_normal(depth, {330.0F, 250.0F}, 10.0F, camera());
  ASSERT_TRUE(normal.has_value());
  EXPECT_LT(degrees_between(*normal, truth), 8.0);
}

TEST(SurfaceNormal, IsNotToldAtEdgesAndWithoutDepth) {
  const cv::Mat plane = plane_depth(camera(), slanted(0.0), 2.0, 1);
  const auto at_middle = [](const cv::Mat& depth) {
    return surface_normal(depth, {330.0F, 250.0F}, 10.0F, camera());
  };
  ASSERT_TRUE(at_middle(plane).has_value());
  cv::Mat edge = plane.clone();
  edge.colRange(331, edge.cols).setTo(1.2F);
  EXPECT_FALSE(at_middle(edge).has_value());
  cv::Mat hole = plane.clone();
  hole.at<float>(250, 330) = std::numeric_limits<float>::quiet_NaN();
  EXPECT_FALSE(at_middle(hole).has_value());
  EXPECT_FALSE(at_middle(cv::Mat::zeros(480, 640, CV_32FC1)).has_value());
  EXPECT_FALSE(at_middle(cv::Mat(480, 640, CV_32FC1, -1.0F)).has_value());
  const float infinity = std::numeric_limits<float>::infinity();
  EXPECT_FALSE(at_middle(cv::Mat(480, 640, CV_32FC1, infinity)).has_value());
  EXPECT_FALSE(surface_normal(plane, {0.0F, 0.0F}, 10.0F, camera()).has_value());
  EXPECT_FALSE(surface_normal(plane, {-900.0F, 0.0F}, 10.0F, camera()).has_value());
}

}  // namespace
}  // namespace dynslam::slam
