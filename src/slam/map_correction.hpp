// Moves a map as a whole without tearing it.
#pragma once

#include <unordered_map>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/factors/similarity.hpp"
#include "dynslam/slam/map.hpp"

#include "shared_map.hpp"

namespace dynslam::slam {

/// New poses for keyframes, computed from a copy of the map, and what they mean for the rest of it.
///
/// A keyframe that went from T_cam_world to S'_cam_world takes its surroundings along by
/// D = S'_cam_world^-1 T_cam_world, x' = D x. Keyframes that were made or refined since the copy
/// was taken keep their place relative to those surroundings. Without depth the scale of D may
/// differ from place to place; what is seen stays at the same pixels then, and distances, those
/// between frames and their keyframes as well, follow the scale.
class MapCorrection {
 public:
  void add(KeyframeId keyframe, const RigidTransform& T_cam_before,
           const factors::Similarity& S_cam_after);

  /// Moves all keyframes and points: a keyframe without a pose of its own follows the one that it
  /// shares most points with, or the latest one made before it; a point follows the keyframe that
  /// saw it first. The caller holds the map. O(keyframes + points), with scale + O(frames).
  void apply(SharedMap& shared) const;

  /// By how much lengths around a keyframe grow; 1 for one that was not added.
  double scale_of(KeyframeId keyframe) const;

 private:
  using Moves = std::unordered_map<KeyframeId, factors::Similarity>;
  Moves moves_of_all(const Map& map) const;

  Moves S_after_before_;  // of the world around it
};

}  // namespace dynslam::slam
