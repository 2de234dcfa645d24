// How far away is what a view shows.
#pragma once

#include <optional>
#include <vector>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/slam/map.hpp"

#include "median.hpp"

namespace dynslam::slam {

/// Median distance along the camera's axis of those `points` that the map has, metres; nothing if
/// it has none of them. O(N), allocates.
inline std::optional<double> median_depth(const Map& map, const std::vector<PointId>& points,
                                          const RigidTransform& T_cam_world) {
  std::vector<double> depths;
  for (const PointId id : points) {
    const MapPoint* point = map.find_point(id);
    if (point != nullptr) depths.push_back((T_cam_world * point->position).z());
  }
  if (depths.empty()) return std::nullopt;
  return median(depths);
}

}  // namespace dynslam::slam
