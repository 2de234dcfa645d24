#include "slam/map_correction.hpp"

#include <gtest/gtest.h>

#include "slam/frame_log.hpp"
#include "slam/loop_correction.hpp"
#include "synthetic_map.hpp"

namespace dynslam::slam {
namespace {

RigidTransform small_motion(double size) {
  Vector6d xi;
  xi << size, -size, 0.5 * size, 0.2 * size, size, -0.3 * size;
  return se3_exp(xi);
}

RigidTransform pose(const SyntheticMap& world, KeyframeId id) {
  return world.shared.map.keyframe(id).T_cam_world;
}

TEST(MapCorrection, MovesPointsWithTheKeyframeThatSawThemFirst) {
  SyntheticMap world;
  Map& map = world.shared.map;
  const KeyframeId id = world.look(0.0, SyntheticMap::true_pose(0.0));
  const PointId point = map.keyframe(id).points[5];
  const Eigen::Vector3d in_camera = pose(world, id) * map.point(point).position;
  MapCorrection correction;
  const RigidTransform after = small_motion(0.1) * pose(world, id);
  correction.add(id, pose(world, id), factors::Similarity(after));
  correction.apply(world.shared);
  EXPECT_TRUE(pose(world, id).matrix().isApprox(after.matrix(), 1e-9));
  EXPECT_TRUE((pose(world, id) * map.point(point).position).isApprox(in_camera, 1e-9));
  EXPECT_NEAR(map.point(point).normal.norm(), 1.0, 1e-5);
}

TEST(MapCorrection, TakesAlongWhatWasMadeOrRefinedMeanwhile) {
  SyntheticMap world;
  const KeyframeId a = world.look(0.0, SyntheticMap::true_pose(0.0));
  const RigidTransform before = pose(world, a), after = small_motion(0.1) * before;
  MapCorrection correction;
  correction.add(a, before, factors::Similarity(after));
  // Since the copy was taken, `a` was refined and `b` was made beside it.
  world.shared.map.keyframe(a).T_cam_world = small_motion(0.01) * before;
  const KeyframeId b = world.look(10.0, SyntheticMap::true_pose(10.0));
  const RigidTransform T_b_a = pose(world, b) * pose(world, a).inverse();
  correction.apply(world.shared);
  EXPECT_TRUE(pose(world, a).matrix().isApprox((small_motion(0.01) * after).matrix(), 1e-9));
  EXPECT_TRUE((pose(world, b) * pose(world, a).inverse()).matrix().isApprox(T_b_a.matrix(), 1e-9));
}

TEST(MapCorrection, LeavesWhatIsSeenAtItsPixelsWhenTheUnitChanges) {
  SyntheticMap world;
  Map& map = world.shared.map;
  FrameLog& log = world.shared.log;
  const KeyframeId id = world.look(0.0, SyntheticMap::true_pose(0.0));
  log.reference = id;
  log.add(map, 0.0, small_motion(0.1) * pose(world, id));
  const MapPoint before = map.point(map.keyframe(id).points[5]);
  const Eigen::Vector3d in_camera = pose(world, id) * before.position;
  const RigidTransform after = small_motion(0.1) * pose(world, id);
  MapCorrection correction;
  // Lengths double: in the camera's old unit the new world is half as large.
  correction.add(id, pose(world, id), factors::Similarity(0.5, after.R, 0.5 * after.t));
  EXPECT_NEAR(correction.scale_of(id), 2.0, 1e-12);
  EXPECT_EQ(correction.scale_of(kNoId), 1.0);
  correction.apply(world.shared);
  EXPECT_EQ(world.shared.corrections, 1U);
  EXPECT_TRUE(pose(world, id).matrix().isApprox(after.matrix(), 1e-9));
  const MapPoint& point = map.point(map.keyframe(id).points[5]);
  EXPECT_TRUE((pose(world, id) * point.position).isApprox(2.0 * in_camera, 1e-9));
  EXPECT_FLOAT_EQ(point.min_distance, 2.0F * before.min_distance);
  EXPECT_FLOAT_EQ(point.max_distance, 2.0F * before.max_distance);
  const RigidTransform T_frame_keyframe = *log.last_pose(map) * pose(world, id).inverse();
  EXPECT_TRUE(T_frame_keyframe.t.isApprox(2.0 * small_motion(0.1).t, 1e-9));
  EXPECT_NEAR(log.take_scale(), 2.0, 1e-12);
  EXPECT_EQ(log.take_scale(), 1.0);
}

TEST(EssentialGraph, SpreadsTheErrorOfALoopOverTheTurn) {
  SyntheticMap world;
  std::vector<KeyframeId> ids;
  for (int k = 0; k <= 18; ++k) {
    ids.push_back(
        world.look(20.0 * k, small_motion(0.005 * k) * SyntheticMap::true_pose(20.0 * k)));
  }
  EssentialGraph graph(false);
  graph.collect(world.shared.map, {});
  LoopMatch loop;
  loop.query = ids[18];
  loop.match = ids[0];
  loop.inliers = 200;
  ASSERT_TRUE(graph.add_loop(loop));
  ASSERT_TRUE(graph.solve());
  const RigidTransform first = pose(world, ids[0]);
  std::vector<RigidTransform> before;
  for (const KeyframeId id : ids) before.push_back(pose(world, id));
  const double gap = se3_log(before[18] * before[0].inverse()).norm();
  EXPECT_GT(gap, 0.1);
  graph.correction().apply(world.shared);
  EXPECT_TRUE(pose(world, ids[0]).matrix().isApprox(first.matrix(), 1e-6));
  EXPECT_LT(se3_log(pose(world, ids[18]) * pose(world, ids[0]).inverse()).norm(), gap / 4.0);
  for (std::size_t k = 1; k < ids.size(); ++k) {
    const RigidTransform now = pose(world, ids[k]) * pose(world, ids[k - 1]).inverse();
    const RigidTransform then = before[k] * before[k - 1].inverse();
    EXPECT_LT(se3_log(now * then.inverse()).norm(), 3.0 * gap / 18.0) << k;
  }
  loop.query = kNoId;
  EXPECT_FALSE(graph.add_loop(loop));
}

TEST(FrameLog, KeepsThePosesOfFramesWhoseKeyframeGoes) {
  SyntheticMap world;
  const Map& map = world.shared.map;
  FrameLog& log = world.shared.log;
  const KeyframeId a = world.look(0.0, SyntheticMap::true_pose(0.0));
  const KeyframeId b = world.look(10.0, SyntheticMap::true_pose(10.0));
  log.reference = a;
  log.add(map, 0.0, small_motion(0.02));
  log.add(map, 0.1, std::nullopt);
  log.add(map, 0.2, small_motion(0.05));
  log.release(map, a, b);
  EXPECT_EQ(log.reference, b);
  world.shared.map.erase_keyframe(a);
  EXPECT_EQ(log.size(), 3U);
  EXPECT_EQ(log.last_timestamp(), 0.2);
  EXPECT_TRUE(log.last_pose(map)->matrix().isApprox(small_motion(0.05).matrix(), 1e-9));
  const Trajectory trajectory = log.trajectory(map);
  ASSERT_EQ(trajectory.size(), 2U);
  EXPECT_EQ(trajectory[1].timestamp, 0.2);
  log.let_go_of_map(map);
  world.shared.map.clear();
  EXPECT_EQ(log.trajectory(map).size(), 2U);
  EXPECT_FALSE(log.last_pose(map).has_value());
}

}  // namespace
}  // namespace dynslam::slam
