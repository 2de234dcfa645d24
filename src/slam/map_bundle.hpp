// Keyframes and points as a bundle adjustment problem, and back into the map.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/factors/bundle_adjustment.hpp"
#include "dynslam/slam/map.hpp"

#include "residual_noise.hpp"
#include "shared_map.hpp"

namespace dynslam::slam {

constexpr int kMinShared = 15;  ///< points that make two keyframes neighbours

class MapBundle {
 public:
  /// Copies `keyframe` and up to `count` - 1 of its covisible keyframes to be moved, all their
  /// points, and the keyframes that see these points from outside, which are held. Call once.
  void collect_around(const Map& map, KeyframeId keyframe, int count,
                      const std::vector<float>& scale_factors);

  /// Copies all keyframes and the points that more than one of them sees. The oldest is held. The
  /// map must not be empty. Call once.
  void collect_all(const Map& map, const std::vector<float>& scale_factors);

  /// Optimizes the copy; false if nothing came of it, or `stop` was raised.
  bool solve(const DepthCamera& camera, factors::BundleWorkspace& workspace,
             const std::atomic<bool>& stop);

  /// Writes poses and points into the map and takes outliers out of it; what was erased since is
  /// left out.
  void write_back(Map& map) const;
  /// The same, and what is not part of the bundle moves with what is.
  void write_back_and_carry(SharedMap& shared) const;

  /// Points that took part.
  const std::vector<PointId>& points() const { return points_; }

 private:
  void hold_observers(const Map& map);
  void add_poses(const Map& map);
  void add_observations(const Map& map, const std::vector<float>& scale_factors);
  void write_points(Map& map) const;
  FeatureNoise noise(const DepthCamera& camera) const;

  std::vector<KeyframeId> keyframes_;  // the free ones first
  std::size_t free_count_ = 0;
  std::unordered_map<KeyframeId, std::uint32_t> index_;
  std::vector<PointId> points_;
  std::vector<RigidTransform> poses_, before_;
  std::vector<std::uint8_t> fixed_;
  std::vector<Eigen::Vector3d> positions_;
  std::vector<factors::BundleObservation> observations_;
  std::vector<float> alignment_sigmas_;  // by observation
  std::vector<std::uint8_t> inliers_;
};

}  // namespace dynslam::slam
