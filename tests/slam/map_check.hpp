// What Map promises of itself, checked from scratch.
#pragma once

#include <map>
#include <string>

#include "dynslam/slam/map.hpp"

namespace dynslam::slam::testing {

inline std::string problem_of_keyframe(const Map& map, KeyframeId id) {
  const Keyframe& keyframe = map.keyframe(id);
  const std::string name = "keyframe " + std::to_string(keyframe.number) + ": ";
  if (keyframe.points.size() != keyframe.features->size()) return name + "not a point a feature";
  if (!keyframe.T_cam_world.all_finite()) return name + "its pose is not finite";
  const Eigen::Matrix3d& R = keyframe.T_cam_world.R;
  const double off = (R.transpose() * R - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (off > 2e-6) return name + "its rotation is none";
  std::map<KeyframeId, int> shared;
  for (std::uint32_t i = 0; i < keyframe.points.size(); ++i) {
    if (keyframe.points[i] == kNoId) continue;
    const MapPoint* point = map.find_point(keyframe.points[i]);
    if (point == nullptr) return name + "a feature shows a point that is gone";
    int mutual = 0;
    for (const Observation& o : point->observations) {
      if (o.keyframe == id) mutual += o.feature == i ? 1 : 100;
      if (o.keyframe != id) ++shared[o.keyframe];
    }
    if (mutual != 1) return name + "a point does not know the feature that shows it";
  }
  if (keyframe.covisible != shared) return name + "its covisibility is miscounted";
  return {};
}

inline std::string problem_of_point(const Map& map, PointId id) {
  const MapPoint& point = map.point(id);
  const std::string name = "point " + std::to_string(id) + ": ";
  if (!point.position.allFinite() || !point.normal.allFinite()) return name + "is not finite";
  if (!(point.static_weight >= 0.0F && point.static_weight <= 1.0F)) {
    return name + "its weight is " + std::to_string(point.static_weight);
  }
  for (const Observation& o : point.observations) {
    const Keyframe* keyframe = map.find_keyframe(o.keyframe);
    if (keyframe == nullptr) return name + "is seen by a keyframe that is gone";
    if (o.feature >= keyframe->points.size() || keyframe->points[o.feature] != id) {
      return name + "a keyframe does not know what it sees";
    }
  }
  return {};
}

/// The first thing that is wrong with a map; empty if nothing is.
inline std::string problem_of(const Map& map) {
  std::size_t least = 0;
  for (const KeyframeId id : map.keyframe_ids()) {
    const std::size_t number = map.keyframe(id).number;
    if (number < least || number >= map.keyframes_made()) return "keyframes are misnumbered";
    least = number + 1;
    if (std::string problem = problem_of_keyframe(map, id); !problem.empty()) return problem;
  }
  for (const PointId id : map.point_ids()) {
    if (std::string problem = problem_of_point(map, id); !problem.empty()) return problem;
  }
  return {};
}

}  // namespace dynslam::slam::testing
