#include "dynslam/slam/two_view.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

#include "two_view_matches.hpp"

namespace dynslam::slam {
namespace {

double angle_deg(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * 180.0 / 3.14159265358979;
}

const RigidTransform kAside(so3_exp({0.02, -0.1, 0.03}), {-0.6, 0.1, 0.15});

void expect_motion(const Matches& matches, const TwoViewReconstruction& result, double degrees) {
  ASSERT_TRUE(result.ok()) << to_string(result.status);
  EXPECT_LT(rotation_angle(result.T_second_first.R, kAside.R) * 180.0 / 3.14159265, degrees);
  EXPECT_LT(angle_deg(result.T_second_first.t, kAside.t), 3.0 * degrees);
  // One scale takes all depths to the true ones, and wrong matches are left out.
  const double scale = kAside.t.norm() / result.T_second_first.t.norm();
  std::size_t near = 0, wrong = 0;
  for (std::size_t i = 0; i < matches.first.size(); ++i) {
    if (result.good[i] == 0) continue;
    if (matches.wrong[i]) ++wrong;
    const double depth = scale * result.points[i].z();
    if (std::abs(depth / matches.depths[i] - 1.0) < 0.1) ++near;
  }
  EXPECT_GT(static_cast<double>(near), 0.9 * static_cast<double>(result.count));
  EXPECT_LT(static_cast<double>(wrong), 0.05 * static_cast<double>(result.count));
}

TEST(TwoView, TakesTheEssentialMatrixInARoom) {
  const Matches matches(Scene::kRoom, kAside, 0.0);
  const TwoViewReconstruction result = matches.reconstruct();
  EXPECT_EQ(result.model, TwoViewModel::kEssential);
  EXPECT_GT(result.count, 280U);
  expect_motion(matches, result, 0.5);
}

TEST(TwoView, TakesTheHomographyOfAWall) {
  const Matches matches(Scene::kWall, kAside, 0.0);
  const TwoViewReconstruction result = matches.reconstruct();
  EXPECT_EQ(result.model, TwoViewModel::kHomography);
  EXPECT_GT(result.homography_share, 0.45);
  expect_motion(matches, result, 1.0);
}

TEST(TwoView, StandsFortyPercentOfOutliers) {
  for (const Scene scene : {Scene::kRoom, Scene::kWall}) {
    SCOPED_TRACE(scene == Scene::kRoom ? "room" : "wall");
    const Matches matches(scene, kAside, 0.4, 600);
    expect_motion(matches, matches.reconstruct(), 1.0);
  }
}

// Two motions explain a plane; unless one puts points behind the camera nobody can tell.
TEST(TwoView, RefusesAWallThatAllowsTwoMotions) {
  const TwoViewReconstruction result = Matches(Scene::kSlantedWall, kAside, 0.0).reconstruct();
  EXPECT_EQ(result.model, TwoViewModel::kHomography);
  EXPECT_EQ(result.status, TwoViewStatus::kAmbiguous);
}

// The essential matrix wins there, but has two valleys: with these seeds its sample is in the
// wrong.
TEST(TwoView, IsNotMisledByAWallThatIsNearlyFlat) {
  for (const unsigned seed : {86U, 135U, 155U, 172U, 176U}) {
    SCOPED_TRACE(seed);
    const Matches matches(Scene::kRoughWall, kAside, 0.0, 200, seed);
    expect_motion(matches, matches.reconstruct(), 1.0);
  }
}

TEST(TwoView, SetsTheMedianDepthToOne) {
  const Matches matches(Scene::kRoom, kAside, 0.0);
  const TwoViewReconstruction result = matches.reconstruct();
  ASSERT_TRUE(result.ok());
  std::vector<double> depths;
  for (std::size_t i = 0; i < result.good.size(); ++i) {
    if (result.good[i] != 0) depths.push_back(result.points[i].z());
  }
  std::sort(depths.begin(), depths.end());
  EXPECT_NEAR(depths[depths.size() / 2], 1.0, 1e-9);
}

TEST(TwoView, RefusesACameraThatOnlyTurned) {
  for (const double outliers : {0.0, 0.4}) {
    const RigidTransform turned(so3_exp({0.05, -0.12, 0.08}), Eigen::Vector3d::Zero());
    const TwoViewReconstruction result = Matches(Scene::kRoom, turned, outliers).reconstruct();
    EXPECT_FALSE(result.ok());
    EXPECT_GT(result.homography_share, 0.45);
  }
}

TEST(TwoView, RefusesAStepTooSmallForItsDirection) {
  const RigidTransform step(so3_exp({0.02, -0.1, 0.03}), {-0.03, 0.005, 0.0});
  EXPECT_EQ(Matches(Scene::kRoom, step, 0.0).reconstruct().status,
            TwoViewStatus::kTooLittleParallax);
}

// What stands still lies on the lines of any motion: only what moves says which it is.
TEST(TwoView, RefusesACameraAtRestBeforeSomethingThatMoves) {
  const Matches still(Scene::kRoom, RigidTransform(), 0.0);
  Matches mixed(Scene::kRoom, {Eigen::Matrix3d::Identity(), {-0.6, 0.1, 0.15}}, 0.0);
  for (std::size_t i = 0; i < still.first.size(); i += 2) {
    mixed.first[i] = still.first[i];
    mixed.second[i] = still.second[i];
  }
  EXPECT_FALSE(mixed.reconstruct().ok());
  TwoViewOptions trusting;
  trusting.min_point_share = 0.1;
  EXPECT_TRUE(mixed.reconstruct(trusting).ok());
}

TEST(TwoView, RefusesMatchesWithoutAnyCommonMotion) {
  EXPECT_FALSE(Matches(Scene::kRoom, kAside, 1.0).reconstruct().ok());
}

TEST(TwoView, CountsTooFewMatches) {
  EXPECT_EQ(Matches(Scene::kRoom, kAside, 0.0, 20).reconstruct().status,
            TwoViewStatus::kTooFewMatches);
  const std::vector<Eigen::Vector2d> none;
  EXPECT_EQ(
      reconstruct_two_views(camera(), as_points<double>(none), as_points<double>(none)).status,
      TwoViewStatus::kTooFewMatches);
}

TEST(TwoView, LeavesOutMatchesWithNaN) {
  Matches matches(Scene::kRoom, kAside, 0.0);
  matches.first[3].x() = std::numeric_limits<double>::quiet_NaN();
  const TwoViewReconstruction result = matches.reconstruct();
  ASSERT_TRUE(result.ok());
  EXPECT_EQ(result.good[3], 0);
  EXPECT_EQ(result.good.size(), matches.first.size());
}

TEST(TwoView, GivesTheSameBitsTwice) {
  const Matches matches(Scene::kRoom, kAside, 0.3);
  const TwoViewReconstruction a = matches.reconstruct(), b = matches.reconstruct();
  EXPECT_EQ(a.T_second_first.matrix(), b.T_second_first.matrix());
  EXPECT_EQ(a.good, b.good);
}

TEST(TwoView, RefusesSizesThatDiffer) {
  Matches matches(Scene::kRoom, kAside, 0.0);
  const std::vector<float> scales(7, 1.0F);
  EXPECT_THROW(reconstruct_two_views(camera(), as_points<double>(matches.first),
                                     as_points<double>(matches.second), scales),
               InvalidArgument);
  EXPECT_THROW(reconstruct_two_views(camera(), as_points<double>(matches.first),
                                     as_points<double>(matches.second), {}, scales),
               InvalidArgument);
  matches.second.pop_back();
  EXPECT_THROW(matches.reconstruct(), InvalidArgument);
}

TEST(TwoViewOptions, NameTheMemberThatBreaksItsRule) {
  const auto refuses = [](auto change) {
    TwoViewOptions options;
    change(options);
    EXPECT_THROW(options.validate(), InvalidArgument);
  };
  refuses([](TwoViewOptions& o) { o.min_points = 7; });
  refuses([](TwoViewOptions& o) { o.min_parallax_deg = 0.0; });
  refuses([](TwoViewOptions& o) { o.min_point_parallax_deg = 2.0; });
  refuses([](TwoViewOptions& o) { o.homography_share = 1.0; });
  refuses([](TwoViewOptions& o) { o.min_likelihood_gap = -1.0; });
  refuses([](TwoViewOptions& o) { o.max_direction_deg = 0.0; });
  refuses([](TwoViewOptions& o) { o.min_front_share = 0.0; });
  refuses([](TwoViewOptions& o) { o.min_point_share = 0.0; });
  refuses([](TwoViewOptions& o) { o.max_iterations = 0; });
}

}  // namespace
}  // namespace dynslam::slam
