// Moves a map as a whole without tearing it.
#pragma once

#include <unordered_map>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/slam/map.hpp"

namespace dynslam::slam {

/// New poses for keyframes, computed from a copy of the map, and what they mean for the rest of it.
///
/// A keyframe that went from T_cam_world to T'_cam_world takes its surroundings along by
/// D = T'_cam_world^-1 T_cam_world, x' = D x. Keyframes that were made or refined since the copy
/// was taken keep their place relative to those surroundings.
class MapCorrection {
 public:
  void add(KeyframeId keyframe, const RigidTransform& T_cam_before,
           const RigidTransform& T_cam_after);

  /// Moves all keyframes and points: a keyframe without a pose of its own follows the one that it
  /// shares most points with, or the latest one made before it; a point follows the keyframe that
  /// saw it first. O(keyframes + points).
  void apply(Map& map) const;

 private:
  std::unordered_map<KeyframeId, RigidTransform> T_after_before_;  // of the world around it
};

}  // namespace dynslam::slam
