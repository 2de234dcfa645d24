#include "map_correction.hpp"

#include <cstddef>

namespace dynslam::slam {
namespace {

constexpr std::size_t kAnchors = 50;  // neighbours that are asked for a pose

}  // namespace

void MapCorrection::add(KeyframeId keyframe, const RigidTransform& T_cam_before,
                        const RigidTransform& T_cam_after) {
  T_after_before_[keyframe] = (T_cam_after.inverse() * T_cam_before).normalized();
}

void MapCorrection::apply(Map& map) const {
  std::unordered_map<KeyframeId, RigidTransform> moves;
  RigidTransform latest;  // the move of the last keyframe that has one
  for (const KeyframeId id : map.keyframe_ids()) {
    auto found = T_after_before_.find(id);
    if (found != T_after_before_.end()) {
      latest = moves[id] = found->second;
      continue;
    }
    RigidTransform move = latest;
    for (const KeyframeId anchor : map.covisible_keyframes(id, kAnchors)) {
      found = T_after_before_.find(anchor);
      if (found == T_after_before_.end()) continue;
      move = found->second;
      break;
    }
    moves[id] = move;
  }
  for (const auto& [id, move] : moves) {
    RigidTransform& T_cam_world = map.keyframe(id).T_cam_world;
    T_cam_world = (T_cam_world * move.inverse()).normalized();
  }
  for (const PointId id : map.point_ids()) {
    MapPoint& point = map.point(id);
    if (point.observations.empty()) continue;
    const RigidTransform& move = moves.at(point.observations.front().keyframe);
    point.position = move * point.position;
    point.normal = move.R.cast<float>() * point.normal;
  }
}

}  // namespace dynslam::slam
