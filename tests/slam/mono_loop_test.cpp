// Loops of maps without depth, which drift in scale.
#include <algorithm>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "slam/loop_closer.hpp"
#include "slam/loop_scale.hpp"
#include "synthetic_map.hpp"

namespace dynslam::slam {
namespace {

constexpr double kStep = 20.0;  // degrees between keyframes: 18 make a turn
constexpr std::size_t kTurn = 18;
constexpr double kRadius = 0.5;  // metres, of the circle that the camera walks
constexpr double kGrowth = 1.2;  // of the unit of length over a turn

RigidTransform true_pose(std::size_t keyframe) {
  return SyntheticMap::true_pose(kStep * static_cast<double>(keyframe), kRadius);
}

SystemOptions mono_options(bool bundle_adjustment) {
  SystemOptions options;
  options.sensor = Sensor::kMono;
  options.bundle_adjustment = bundle_adjustment;
  return options;
}

class MonoLoopTest : public ::testing::TestWithParam<bool> {
 protected:
  MonoLoopTest() {
    world.radius = kRadius;
    world.has_depth = false;
  }

  // Keyframes whose motions are right but for a unit that grows all the time.
  void walk(std::size_t first, std::size_t end) {
    for (std::size_t k = first; k < end; ++k) {
      RigidTransform T_cam_world = true_pose(k);
      if (k > 0) {
        const RigidTransform step = true_pose(k) * true_pose(k - 1).inverse();
        T_cam_world = RigidTransform(step.R, unit * step.t) *
                      world.shared.map.keyframe(ids.back()).T_cam_world;
      }
      const factors::Similarity S_cam_world(1.0 / unit, T_cam_world.R, T_cam_world.t / unit);
      ids.push_back(world.look(kStep * static_cast<double>(k), S_cam_world));
      world.shared.log.reference = ids.back();
      world.shared.log.add(
          world.shared.map, static_cast<double>(k),
          RigidTransform(Eigen::Matrix3d::Identity(), {unit, 0.0, 0.0}) * T_cam_world);
      closer.process(ids.back(), stop);
      unit *= std::pow(kGrowth, 1.0 / kTurn) * world.shared.log.take_scale();
    }
  }

  // Greatest over least length of what is equally long in truth: the steps between keyframes.
  double spread_of_steps(std::size_t end) const {
    std::vector<double> steps;
    for (std::size_t k = 1; k < end; ++k) {
      steps.push_back((centre(k) - centre(k - 1)).norm());
    }
    const auto [least, most] = std::minmax_element(steps.begin(), steps.end());
    return *most / *least;
  }
  static double true_step() { return (true_pose(1) * true_pose(0).inverse()).t.norm(); }
  Eigen::Vector3d centre(std::size_t k) const {
    return world.shared.map.keyframe(ids[k]).T_cam_world.inverse().t;
  }

  SyntheticMap world;
  std::atomic<bool> stop{false};
  LoopCloser closer{world.camera, mono_options(GetParam()), unit_scales(), {}, world.shared};
  std::vector<KeyframeId> ids;
  double unit = 1.0;  // length in the map of a metre here
};

TEST_P(MonoLoopTest, MendsADriftOfScale) {
  for (std::size_t k = 0; closer.closures().empty() && k < kTurn + 6; ++k) walk(k, k + 1);
  ASSERT_EQ(closer.closures().size(), 1U);
  const LoopClosure& loop = closer.closures().front();
  const std::size_t query = loop.query_frame / 10, match = loop.match_frame / 10;
  const double drift = std::pow(kGrowth, static_cast<double>(query - match) / kTurn);
  std::printf("scale %.4f turns %.2f spread %.4f inl %d vis %d\n", loop.scale,
              double(query - match) / kTurn, spread_of_steps(ids.size()), loop.inliers,
              loop.visible);
  EXPECT_GT(drift, 1.15);
  EXPECT_NEAR(loop.scale, drift, 0.01);
  EXPECT_LT(spread_of_steps(ids.size()), 1.01);
  // Frames follow their keyframes in the new unit.
  const Trajectory frames = world.shared.log.trajectory(world.shared.map);
  for (std::size_t k = 1; k < ids.size(); ++k) {
    const double step = (centre(k) - centre(k - 1)).norm();
    EXPECT_NEAR((frames[k].T_world_cam.t - centre(k)).norm() / step, 1.0 / true_step(), 0.1);
  }
}

INSTANTIATE_TEST_SUITE_P(WithAndWithout, MonoLoopTest, ::testing::Bool());

}  // namespace
}  // namespace dynslam::slam
