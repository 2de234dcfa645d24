// What Tracker makes of an earlier frame, now that more is known of the points it was matched with.
#include <algorithm>

#include "tracker.hpp"

namespace dynslam::slam {
namespace {

constexpr float kBelieved = 0.5F;  // least belief in a point that tells of an earlier frame
constexpr int kPlenty = 3;         // times as many inliers as a frame needs to be tracked

}  // namespace

std::vector<PointId> Tracker::matched_points(std::size_t features) const {
  std::vector<PointId> points(features, kNoId);
  for (const PointMatch& match : matches_) {
    if (match.feature < features) points[match.feature] = predictions_.ids[match.source];
  }
  return points;
}

// Matches of what the frame was matched with then.
void Tracker::recall_matches(const Map& map, const TrackedFrame& frame) {
  predictions_.resize(frame.points.size());
  matches_.clear();
  for (std::uint32_t i = 0; i < frame.points.size(); ++i) {
    const MapPoint* point = map.find_point(frame.points[i]);
    if (point == nullptr) continue;
    predictions_.ids[i] = frame.points[i];
    predictions_.weights[i] = point->static_weight;
    matches_.push_back(
        {i, i, point->position, initial_weight(point->static_weight, frame.staticness[i])});
  }
}

bool Tracker::solve_again(TrackedFrame& frame) {
  const auto enough = static_cast<std::size_t>(kPlenty * options_.min_inliers);
  const auto moves = [this](const PointMatch& match) {
    return geometry_ && predictions_.weights[match.source] < kBelieved;
  };
  matches_.erase(std::remove_if(matches_.begin(), matches_.end(), moves), matches_.end());
  if (matches_.size() < enough) return false;
  if (geometry_) prefer_proven(frame.T_cam_world);
  const factors::PoseResult result = pose_.solve(matches_, *frame.features, frame.T_cam_world);
  if (!result || result.inliers < static_cast<int>(enough)) return false;
  frame.T_cam_world = result.T_cam_world;
  return true;
}

bool Tracker::estimate_again(const Map& map, KeyframeId reference, TrackedFrame& frame) {
  recall_matches(map, frame);
  if (!solve_again(frame)) return false;
  if (frame.levels.empty()) return true;
  frame.drop_sought();
  match_local_map(map, reference, frame, false);
  if (solve_again(frame) && match_looks(map, frame)) solve_again(frame);
  return true;
}

}  // namespace dynslam::slam
