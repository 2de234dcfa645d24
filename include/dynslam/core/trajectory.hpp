// Poses over time: what a SLAM system writes and an evaluation reads.
#pragma once

#include <vector>

#include "dynslam/core/rigid_transform.hpp"

namespace dynslam {

/// Pose of the camera at a time. `T_world_cam` takes camera coordinates to world coordinates; its t
/// is the camera's position (the convention of TUM and KITTI files).
struct StampedPose {
  double timestamp = 0.0;  ///< seconds
  RigidTransform T_world_cam;
};

/// Poses with strictly increasing timestamps.
using Trajectory = std::vector<StampedPose>;

}  // namespace dynslam
