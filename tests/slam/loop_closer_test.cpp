#include "slam/loop_closer.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "synthetic_map.hpp"

namespace dynslam::slam {
namespace {

constexpr double kStep = 20.0;  // degrees between keyframes: 18 make a turn
constexpr std::size_t kTurn = 18;
constexpr std::size_t kPart = 14;  // keyframes of which the last does not see the first's place
constexpr double kDrift = 0.004;   // radians and half as many metres a keyframe

RigidTransform drifted(std::size_t keyframe) {
  const double drift = kDrift * static_cast<double>(keyframe);
  Vector6d xi;
  xi << 0.5 * drift, 0.0, 0.3 * drift, 0.0, drift, 0.0;
  return se3_exp(xi) * SyntheticMap::true_pose(kStep * static_cast<double>(keyframe));
}

class LoopCloserTest : public ::testing::Test {
 protected:
  void walk(std::size_t first, std::size_t end) {
    for (std::size_t k = first; k < end; ++k) {
      RigidTransform T_cam_world = drifted(k);
      if (k > 0) {
        T_cam_world = T_cam_world * drifted(k - 1).inverse() *
                      world.shared.map.keyframe(ids.back()).T_cam_world;
      }
      ids.push_back(world.look(kStep * static_cast<double>(k), T_cam_world));
      closer.process(ids.back(), stop);
    }
  }
  // How far the pose of a keyframe relative to an older one is from the truth.
  double error(std::size_t query, std::size_t match) const {
    const Map& map = world.shared.map;
    const RigidTransform T =
        map.keyframe(ids[query]).T_cam_world * map.keyframe(ids[match]).T_cam_world.inverse();
    return se3_log(T * true_motion(query, match).inverse()).norm();
  }
  static RigidTransform true_motion(std::size_t query, std::size_t match) {
    return SyntheticMap::true_pose(kStep * static_cast<double>(query)) *
           SyntheticMap::true_pose(kStep * static_cast<double>(match)).inverse();
  }

  SyntheticMap world;
  std::atomic<bool> stop{false};
  LoopCloser closer{world.camera, SystemOptions(), unit_scales(), {}, world.shared};
  std::vector<KeyframeId> ids;
};

TEST_F(LoopCloserTest, ClosesATurnOfACameraThatHasDrifted) {
  walk(0, kTurn + 4);
  ASSERT_EQ(closer.closures().size(), 1U);
  const LoopClosure& loop = closer.closures().front();
  const std::size_t query = loop.query_frame / 10, match = loop.match_frame / 10;
  EXPECT_LE(std::abs(static_cast<int>(query) - static_cast<int>(match + kTurn)), 2);
  EXPECT_GE(loop.inliers, LoopOptions().min_inliers);
  EXPECT_LE(loop.inliers, loop.visible);
  EXPECT_EQ(loop.shared, 0);
  EXPECT_GT(loop.moved, 0.02);
  // The motion that was verified is the true one, not the one that drift has led to.
  EXPECT_LT(se3_log(loop.T_query_match * true_motion(query, match).inverse()).norm(), 0.01);
  const RigidTransform off = drifted(query) * drifted(match).inverse();
  EXPECT_GT(se3_log(off * true_motion(query, match).inverse()).norm(), 0.05);
  EXPECT_LT(error(query, match), 0.02);
  EXPECT_EQ(world.shared.corrections, 2U);  // the pose graph and the bundle adjustment
  // Points that both turns saw have become one.
  EXPECT_GT(world.shared.map.keyframe(ids[query]).covisible[ids[match]], 50);
}

TEST_F(LoopCloserTest, KeepsWhatIsNearAKeyframeWhereItIsSeen) {
  walk(0, kTurn + 4);
  ASSERT_EQ(closer.closures().size(), 1U);
  const Map& map = world.shared.map;
  const std::size_t query = closer.closures().front().query_frame / 10;
  for (std::size_t k = 0; k <= query; ++k) {
    const Keyframe& keyframe = map.keyframe(ids[k]);
    std::size_t points = 0, off = 0;
    for (std::size_t i = 0; i < keyframe.points.size(); ++i) {
      if (keyframe.points[i] == kNoId) continue;
      const Eigen::Vector2d pixel =
          world.camera.project(keyframe.T_cam_world * map.point(keyframe.points[i]).position);
      const cv::Point2f at = keyframe.features->keypoints[i].pt;
      ++points;
      if ((pixel - Eigen::Vector2d(at.x, at.y)).norm() > 3.0) ++off;
    }
    EXPECT_GT(points, 100U);
    EXPECT_LT(off, points / 50);
  }
}

TEST_F(LoopCloserTest, FindsNoLoopWhereOtherThingsAre) {
  walk(0, kPart);
  world.add_wall(1800);
  world.forget_points();
  walk(kPart, 2 * kPart);
  EXPECT_TRUE(closer.closures().empty());
}

TEST_F(LoopCloserTest, IsNotMisledByAnObjectThatWasCarriedElsewhere) {
  // 80 points in a box of half a metre, seen first straight ahead, later in another room.
  const auto box = [&](double degrees) {
    const RigidTransform T = SyntheticMap::true_pose(degrees).inverse();
    std::vector<Eigen::Vector3d> corners;
    for (int i = 0; i < 80; ++i) {
      corners.push_back(
          T * Eigen::Vector3d(0.06 * (i % 9) - 0.25, 0.06 * (i / 9) - 0.25, 2.0 + 0.02 * (i % 5)));
    }
    return corners;
  };
  for (const Eigen::Vector3d& corner : box(0.0)) world.add_point(corner);
  const std::vector<WallPoint> object(world.wall.end() - 80, world.wall.end());
  walk(0, kPart);
  world.add_wall(1800);
  const std::vector<Eigen::Vector3d> carried = box(kStep * (kPart + 4));
  for (std::size_t i = 0; i < object.size(); ++i) {
    world.wall.push_back({carried[i], object[i].descriptor});
  }
  world.forget_points();
  walk(kPart, 2 * kPart);
  EXPECT_TRUE(closer.closures().empty());
}

TEST_F(LoopCloserTest, ForgetsKeyframesThatWereErased) {
  walk(0, kTurn);
  world.shared.map.erase_keyframe(ids[0]);
  world.shared.map.erase_keyframe(ids[1]);
  walk(kTurn, kTurn + 1);
  for (const KeyframeId id :
       closer.database().similar(*world.shared.map.keyframe(ids[kTurn]).features, 10)) {
    EXPECT_NE(world.shared.map.find_keyframe(id), nullptr);
  }
}

TEST_F(LoopCloserTest, TellsAReturnThatTrackingJoinedOnceForEachPlace) {
  world.memory = 1000;
  const auto turn = [&] {
    for (std::size_t k = 0; k < kTurn; ++k) {
      const double degrees = kStep * static_cast<double>(ids.size() % kTurn);
      ids.push_back(world.look(degrees, SyntheticMap::true_pose(degrees)));
      closer.process(ids.back(), stop);
    }
    return closer.closures().size();
  };
  turn();
  turn();
  const std::size_t loops = turn();
  EXPECT_GT(loops, 0U);
  EXPECT_GT(closer.closures().front().shared, 0);
  EXPECT_EQ(turn(), loops);
}

TEST_F(LoopCloserTest, DoesNothingOnceItIsStopped) {
  walk(0, kTurn - 2);
  stop = true;
  walk(kTurn - 2, kTurn + 4);
  EXPECT_TRUE(closer.closures().empty());
  EXPECT_EQ(world.shared.corrections, 0U);
}

}  // namespace
}  // namespace dynslam::slam
