// The neighbourhood of a keyframe as a bundle adjustment problem, and back into the map.
#pragma once

#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/factors/bundle_adjustment.hpp"
#include "dynslam/slam/map.hpp"

namespace dynslam::slam {

class LocalBundle {
 public:
  /// Takes `keyframe` and up to `count` - 1 of its covisible keyframes to be moved, all their
  /// points, and holds the keyframes that see these points from outside.
  LocalBundle(const Map& map, KeyframeId keyframe, int count,
              const std::vector<float>& scale_factors);

  /// Optimizes; on success writes poses and points into the map and takes outliers out of it.
  void solve(const DepthCamera& camera, factors::BundleWorkspace& workspace, Map& map);

  /// Points that took part.
  const std::vector<PointId>& points() const { return points_; }

 private:
  void hold_observers(const Map& map);
  void add_observations(const Map& map, const std::vector<float>& scale_factors);
  void write_back(Map& map) const;

  std::vector<KeyframeId> keyframes_;  // the free ones first
  std::size_t free_count_ = 0;
  std::unordered_map<KeyframeId, std::uint32_t> index_;
  std::vector<PointId> points_;
  std::vector<RigidTransform> poses_;
  std::vector<std::uint8_t> fixed_;
  std::vector<Eigen::Vector3d> positions_;
  std::vector<factors::BundleObservation> observations_;
  std::vector<std::uint8_t> inliers_;
};

}  // namespace dynslam::slam
