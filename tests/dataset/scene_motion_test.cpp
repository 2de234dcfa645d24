#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>

#include <Eigen/LU>
#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/so3.hpp"
#include "dynslam/dataset/scene.hpp"

#include "dataset/scene_testing.hpp"

namespace dynslam::dataset {
namespace {

constexpr double kDegree = 3.14159265358979323846 / 180.0;

TEST(RenderedScene, HandHeldCameraWandersSmoothlyAndStartsQuietly) {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    const RenderedScene scene(small(seed));
    double way = 0.0, turn = 0.0, quiet_way = 0.0;
    for (std::size_t i = 0; i < 900; ++i) {
      const RigidTransform step = scene.T_world_cam(i).inverse() * scene.T_world_cam(i + 1);
      const double angle = so3_log(step.R).norm();
      ASSERT_LT(step.t.norm(), 0.030) << i;  // 0.9 m/s
      ASSERT_LT(angle, 1.5 * kDegree) << i;  // 45 deg/s
      way += step.t.norm();
      turn += angle;
      if (i < 20) quiet_way += step.t.norm();
    }
    EXPECT_GT(way / 30.0, 0.15);
    EXPECT_LT(way / 30.0, 0.40);
    EXPECT_GT(turn / 30.0, 7.0 * kDegree);
    EXPECT_LT(turn / 30.0, 25.0 * kDegree);
    EXPECT_LT(quiet_way / 20.0, 0.6 * way / 900.0);
  }
}

TEST(RenderedScene, GoesOnForEver) {
  const RenderedScene scene(small(9));
  for (const std::size_t i : {100000U, 999999U, 30000000U}) {
    const RigidTransform T = scene.T_world_cam(i);
    ASSERT_TRUE(T.all_finite());
    EXPECT_LT((T.R * T.R.transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-12);
    EXPECT_LT(std::abs(T.t.x()), 1.0);
    EXPECT_LT(T.t.y(), -0.8);
    EXPECT_GT(T.t.y(), -2.3);
    double least = 0.0;
    cv::minMaxLoc(scene.exact_depth(i), &least);
    EXPECT_GT(least, 0.3);
  }
}

TEST(RenderedScene, TremorIsMillimetresAndCanBeSwitchedOff) {
  SceneOptions options = small();
  const RenderedScene shaky(options);
  options.tremor = 0.0;
  const RenderedScene calm(options);
  double most = 0.0, angle = 0.0;
  for (std::size_t i = 0; i < 300; ++i) {
    const RigidTransform d = calm.T_world_cam(i).inverse() * shaky.T_world_cam(i);
    most = std::max(most, d.t.norm());
    angle = std::max(angle, so3_log(d.R).norm());
  }
  EXPECT_GT(most, 0.0008);
  EXPECT_LT(most, 0.004);
  EXPECT_GT(angle, 0.1 * kDegree);
  EXPECT_LT(angle, 0.5 * kDegree);
}

TEST(RenderedScene, PureRotationKeepsTheCentreAndObeysTheHomography) {
  SceneOptions options = small(2);
  options.motion = CameraMotion::kPureRotation;
  const RenderedScene scene(options);
  Eigen::Matrix3d K;
  const DepthCamera& c = scene.camera();
  K << c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1;
  for (const std::size_t i : {0U, 40U, 333U}) {
    const RigidTransform a = scene.T_world_cam(i), b = scene.T_world_cam(i + 15);
    EXPECT_EQ(a.t, b.t);
    EXPECT_GT(rotation_angle(a.R, b.R), 0.5 * kDegree);
    const Eigen::Matrix3d H = K * b.R.transpose() * a.R * K.inverse();
    for (int k = 0; k < 20; ++k) {
      const Eigen::Vector2d p(7.0 * k + 3.0, 5.0 * k + 9.0);
      const auto match = scene.correspondence(i, p, i + 15);
      ASSERT_TRUE(match.has_value());
      if (match->label != kStaticLabel) continue;
      EXPECT_LT(((H * p.homogeneous()).hnormalized() - match->pixel).norm(), 1e-8);
    }
  }
}

TEST(RenderedScene, ForwardMotionIsAlongTheOpticalAxis) {
  SceneOptions options = small();
  options.motion = CameraMotion::kForward;
  const RenderedScene scene(options);
  const RigidTransform step = scene.T_world_cam(30).inverse() * scene.T_world_cam(60);
  EXPECT_LT((step.R - Eigen::Matrix3d::Identity()).norm(), 1e-12);
  EXPECT_LT(step.t.head<2>().norm(), 1e-12);
  EXPECT_GT(step.t.z(), 0.05);
}

TEST(RenderedScene, SidewaysMotionIsAlongTheImageRows) {
  SceneOptions options = small();
  options.motion = CameraMotion::kSideways;
  const RenderedScene scene(options);
  const RigidTransform step = scene.T_world_cam(30).inverse() * scene.T_world_cam(60);
  EXPECT_LT((step.R - Eigen::Matrix3d::Identity()).norm(), 1e-12);
  EXPECT_LT(step.t.tail<2>().norm(), 1e-12);
  EXPECT_GT(step.t.x(), 0.05);
}

TEST(RenderedScene, RoundMotionTurnsOnceAndComesBack) {
  SceneOptions options = small();
  options.motion = CameraMotion::kRound;
  const RenderedScene scene(options);
  double turned = 0.0;
  for (std::size_t i = 60; i < 660; ++i) {  // 20 s, once the quiet beginning is over
    const RigidTransform step = scene.T_world_cam(i).inverse() * scene.T_world_cam(i + 1);
    turned += so3_log(step.R).norm();
  }
  EXPECT_NEAR(turned, 2.0 * std::acos(-1.0), 0.2);
  EXPECT_LT((scene.T_world_cam(60).t - scene.T_world_cam(660).t).norm(), 1e-9);
  EXPECT_NEAR((scene.T_world_cam(60).t - scene.T_world_cam(360).t).norm(), 1.0, 1e-9);
}

TEST(RenderedScene, NothingMovesAtSpeedZero) {
  SceneOptions options = small();
  options.camera_speed = options.tremor = options.mover_speed = 0.0;
  const RenderedScene scene(options);
  EXPECT_EQ(scene.T_world_cam(0).t, scene.T_world_cam(500).t);
  EXPECT_TRUE(same_bits(scene.exact_depth(0), scene.exact_depth(500)));
  EXPECT_GT(share_of_movers(scene.truth(0).mask), 0.0);
}

TEST(RenderedScene, MoversCoverASharePlentyForLongAndKeepTheirDistance) {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    const RenderedScene scene(small(seed, 80, 60));
    double sum = 0.0, boxes = 0.0;
    int many = 0;
    double nearest = 100.0;
    for (std::size_t i = 0; i < 300; ++i) {
      const SceneTruth truth = scene.truth(i);
      const double share = share_of_movers(truth.mask);
      sum += share;
      many += share > 0.2 ? 1 : 0;
      boxes += static_cast<double>(cv::countNonZero(truth.mask == kCarriedBoxLabel)) /
               static_cast<double>(truth.mask.total());
      double least = 0.0;
      cv::minMaxLoc(truth.depth, &least, nullptr, nullptr, nullptr, truth.mask);
      if (share > 0.0) nearest = std::min(nearest, least);
    }
    EXPECT_GT(sum / 300.0, 0.15) << seed;
    EXPECT_LT(sum / 300.0, 0.45) << seed;
    EXPECT_GT(many, 150) << seed;
    EXPECT_GT(boxes / 300.0, 0.01) << seed;
    EXPECT_GT(nearest, 0.35) << seed;
  }
}

TEST(RenderedScene, MoversKeepOneDirectionForMoreThanASecond) {
  const RenderedScene scene(small(1));
  // A torso: the surface of a person that is seen most at first is good enough.
  const SceneTruth truth = scene.truth(0);
  std::map<int, int> seen;
  for (int y = 0; y < truth.mask.rows; ++y) {
    for (int x = 0; x < truth.mask.cols; ++x) {
      if (truth.mask.at<std::uint8_t>(y, x) == kPersonLabel)
        ++seen[truth.surface.at<std::uint16_t>(y, x)];
    }
  }
  ASSERT_FALSE(seen.empty());
  const int body = std::max_element(seen.begin(), seen.end(), [](const auto& a, const auto& b) {
                     return a.second < b.second;
                   })->first;
  int longest = 0;
  double way = 0.0;
  for (std::size_t start = 0; start < 300; start += 5) {
    const auto velocity = [&](std::size_t i) -> Eigen::Vector3d {
      return 30.0 * (scene.T_world_surface(body, i + 1).t - scene.T_world_surface(body, i).t);
    };
    const Eigen::Vector3d first = velocity(start).normalized();
    int length = 0;
    while (length < 200 &&
           velocity(start + static_cast<std::size_t>(length)).normalized().dot(first) > 0.7)
      ++length;
    longest = std::max(longest, length);
    way += velocity(start).norm();
  }
  EXPECT_GT(longest, 30);
  EXPECT_GT(way / 60.0, 0.5);
  EXPECT_LT(way / 60.0, 1.5);
}

}  // namespace
}  // namespace dynslam::dataset
