#include "slam/tracker.hpp"

#include <gtest/gtest.h>

#include "dynslam/core/so3.hpp"

#include "slam/synthetic_map.hpp"

namespace dynslam::slam {
namespace {

constexpr double kStep = 1.0 / 30.0;

SystemOptions with_geometry() {
  SystemOptions options;
  options.geometry = true;
  return options;
}

/// A camera that has stood still before a wall for a second: it is expected to go on like that.
class StandingCamera {
 public:
  StandingCamera() {
    world.add_wall(500);
    keyframe_ = world.look(0.0, RigidTransform());
    for (int i = 0; i < 30; ++i) track({}, {});
  }

  /// Tracks a frame from a camera at `truth`, whose last frame said `start`; returns its pose.
  RigidTransform track(const RigidTransform& truth, const RigidTransform& start) {
    std::vector<std::size_t> seen;
    TrackedFrame frame;
    frame.reset(world.see(truth, seen), 0.0);
    tracker_.begin_frame(last_, kStep);
    frame.T_cam_world = start;
    inliers = tracker_.track_local_map(world.shared.map, keyframe_, frame, false);
    features = seen.size();
    last_ = frame;
    return frame.T_cam_world;
  }

  SyntheticMap world;
  int inliers = 0;  ///< of the last frame
  std::size_t features = 0;

 private:
  Tracker tracker_{world.camera, with_geometry(), unit_scales()};
  KeyframeId keyframe_ = kNoId;
  TrackedFrame last_;
};

RigidTransform shifted(const Eigen::Vector3d& metres) {
  return {Eigen::Matrix3d::Identity(), metres};
}

TEST(TrackerExpectation, IsLetGoOfWhenNearlyAllFeaturesContradictIt) {
  StandingCamera camera;
  const RigidTransform truth = shifted({0.0, 0.0, 0.1});  // takes 90 m/s^2
  const RigidTransform found = camera.track(truth, truth);
  EXPECT_LT((found.t - truth.t).norm(), 0.005);
  EXPECT_GT(camera.inliers, 0.9 * static_cast<double>(camera.features));
}

TEST(TrackerExpectation, StandsAgainstAMoverThatMostFeaturesFollow) {
  StandingCamera camera;
  for (std::size_t i = 0; i < camera.world.wall.size(); ++i) {
    if (i % 5 < 3) camera.world.wall[i].position.z() -= 0.08;
  }
  const RigidTransform found = camera.track({}, shifted({0.0, 0.0, -0.04}));
  EXPECT_LT(found.t.norm(), 0.005);
  EXPECT_NEAR(camera.inliers, 0.4 * static_cast<double>(camera.features), 10.0);
}

}  // namespace
}  // namespace dynslam::slam
