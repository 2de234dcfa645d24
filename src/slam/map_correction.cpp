#include "map_correction.hpp"

#include <cstddef>

namespace dynslam::slam {
namespace {

using factors::Similarity;

constexpr std::size_t kAnchors = 50;  // neighbours that are asked for a pose

Similarity normalized(const Similarity& S) {
  return {S.s, RigidTransform(S.R, S.t).normalized().R, S.t};
}

}  // namespace

void MapCorrection::add(KeyframeId keyframe, const RigidTransform& T_cam_before,
                        const Similarity& S_cam_after) {
  S_after_before_[keyframe] = normalized(S_cam_after.inverse() * Similarity(T_cam_before));
}

double MapCorrection::scale_of(KeyframeId keyframe) const {
  const auto found = S_after_before_.find(keyframe);
  return found == S_after_before_.end() ? 1.0 : found->second.s;
}

MapCorrection::Moves MapCorrection::moves_of_all(const Map& map) const {
  Moves moves;
  Similarity latest;  // the move of the last keyframe that has one
  for (const KeyframeId id : map.keyframe_ids()) {
    auto found = S_after_before_.find(id);
    if (found != S_after_before_.end()) {
      latest = moves[id] = found->second;
      continue;
    }
    Similarity move = latest;
    for (const KeyframeId anchor : map.covisible_keyframes(id, kAnchors)) {
      found = S_after_before_.find(anchor);
      if (found == S_after_before_.end()) continue;
      move = found->second;
      break;
    }
    moves[id] = move;
  }
  return moves;
}

void MapCorrection::apply(SharedMap& shared) const {
  Map& map = shared.map;
  const Moves moves = moves_of_all(map);
  bool scaled = false;
  for (const auto& [id, move] : moves) {
    RigidTransform& T_cam_world = map.keyframe(id).T_cam_world;
    T_cam_world = (Similarity(T_cam_world) * move.inverse()).rigid().normalized();
    scaled = scaled || move.s != 1.0;
  }
  for (const PointId id : map.point_ids()) {
    MapPoint& point = map.point(id);
    if (point.observations.empty()) continue;
    const Similarity& move = moves.at(point.observations.front().keyframe);
    point.position = move * point.position;
    point.normal = move.R.cast<float>() * point.normal;
    point.min_distance *= static_cast<float>(move.s);
    point.max_distance *= static_cast<float>(move.s);
  }
  if (scaled) shared.log.rescale([&](KeyframeId id) { return moves.at(id).s; });
  ++shared.corrections;
}

}  // namespace dynslam::slam
