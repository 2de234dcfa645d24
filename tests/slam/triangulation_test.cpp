#include "dynslam/slam/triangulation.hpp"

#include <cmath>
#include <limits>
#include <utility>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

#include "slam/vga_camera.hpp"

namespace dynslam::slam {
namespace {

// Both cameras look at X; the second stands `baseline` to the right and is turned a little.
struct Pair {
  PointSighting first, second;
  Pair(const Eigen::Vector3d& X, double baseline) {
    second.T_cam_world = {so3_exp({0.01, -0.02, 0.03}), {-baseline, 0.0, 0.0}};
    first.pixel = camera().project(X);
    second.pixel = camera().project(second.T_cam_world * X);
  }
};

const Eigen::Vector3d kPoint(0.3, -0.2, 4.0);

TEST(Triangulation, FindsThePointOfTwoExactSightings) {
  const Pair pair(kPoint, 0.5);
  const TriangulatedPoint point = triangulate(camera(), pair.first, pair.second);
  ASSERT_TRUE(point.ok()) << to_string(point.status);
  EXPECT_LT((point.position - kPoint).norm(), 1e-9);
  EXPECT_NEAR(point.parallax_deg, 7.1, 0.2);
}

TEST(Triangulation, SharesAnErrorBetweenBothImages) {
  Pair pair(kPoint, 0.5);
  pair.first.pixel.y() += 1.0;
  pair.second.pixel.y() -= 1.0;
  const TriangulatedPoint point = triangulate(camera(), pair.first, pair.second);
  ASSERT_TRUE(point.ok());
  const auto error = [&](const PointSighting& seen) {
    return (camera().project(seen.T_cam_world * point.position) - seen.pixel).norm();
  };
  EXPECT_NEAR(error(pair.first), error(pair.second), 0.05);
}

TEST(Triangulation, RefusesRaysThatAreNearlyParallel) {
  const Pair pair(kPoint, 0.01);
  const TriangulatedPoint point = triangulate(camera(), pair.first, pair.second);
  EXPECT_EQ(point.status, TriangulationStatus::kTooLittleParallax);
  EXPECT_GT(point.parallax_deg, 0.0);
}

TEST(Triangulation, RefusesAPureRotation) {
  const Pair pair(kPoint, 0.0);
  EXPECT_EQ(triangulate(camera(), pair.first, pair.second).status,
            TriangulationStatus::kTooLittleParallax);
}

TEST(Triangulation, RefusesAPointBehindTheCameras) {
  Pair pair(kPoint, 0.5);
  std::swap(pair.first.pixel, pair.second.pixel);  // the rays now part
  EXPECT_EQ(triangulate(camera(), pair.first, pair.second).status,
            TriangulationStatus::kBehindCamera);
}

TEST(Triangulation, RefusesAMatchOffItsEpipolarLine) {
  Pair pair(kPoint, 0.5);
  pair.second.pixel.y() += 8.0;
  EXPECT_EQ(triangulate(camera(), pair.first, pair.second).status,
            TriangulationStatus::kLargeError);
  pair.first.scale = pair.second.scale = 3.0;  // coarse features may be off by more
  EXPECT_TRUE(triangulate(camera(), pair.first, pair.second).ok());
}

TEST(Triangulation, RefusesAThingThatGrowsWithTheDistance) {
  Pair pair(kPoint, 0.5);
  pair.second.scale = 2.0;
  EXPECT_EQ(triangulate(camera(), pair.first, pair.second).status,
            TriangulationStatus::kScalesDisagree);
  TriangulationOptions options;
  options.max_scale_factor = 0.0;
  EXPECT_TRUE(triangulate(camera(), pair.first, pair.second, options).ok());
}

TEST(Triangulation, TellsNaNFromBadGeometry) {
  Pair pair(kPoint, 0.5);
  pair.first.pixel.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(triangulate(camera(), pair.first, pair.second).status, TriangulationStatus::kNotFinite);
}

TEST(TriangulationOptions, NameTheMemberThatBreaksItsRule) {
  const auto refuses = [](auto change) {
    TriangulationOptions options;
    change(options);
    EXPECT_THROW(options.validate(), InvalidArgument);
  };
  refuses([](TriangulationOptions& o) { o.min_parallax_deg = 0.0; });
  refuses([](TriangulationOptions& o) { o.max_chi2 = 0.0; });
  refuses([](TriangulationOptions& o) { o.max_scale_factor = 0.5; });
}

}  // namespace
}  // namespace dynslam::slam
