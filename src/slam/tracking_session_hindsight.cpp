// What TrackingSession makes of earlier frames.
#include <algorithm>

#include "stopwatch.hpp"
#include "tracking_session.hpp"

namespace dynslam::slam {
namespace {

constexpr float kUnknownPoint = 0.5F;  // belief in a point of which nothing is known

}  // namespace

// What is known of the time since then rests on poses that are wrong. The points of the keyframe
// do not: they come from its own depth image.
void TrackingSession::forget_since_first_look(const RigidTransform& T_cam_world) {
  Map& map = shared_.map;
  const double began = second_look_.first().timestamp, now = current_.timestamp;
  const LastKeyframe last = second_look_.keyframe();
  const auto pose = [&](double timestamp) {
    return second_look_.between(timestamp, now, T_cam_world);
  };
  shared_.log.repose(map, began, last.id, pose);
  shared_.log.reference = last.id;
  for (const KeyframeId id : map.keyframe_ids()) {
    if (map.keyframe(id).number < last.made) continue;
    shared_.log.release(map, id, last.id);  // earlier frames may have come to hang on it
    map.erase_keyframe(id);
  }
  for (const PointId id : map.point_ids()) {
    MapPoint& point = map.point(id);
    point.static_weight = std::min(kUnknownPoint, point.static_weight);
    point.visible = point.found = 1;
  }
  corrections_ = ++shared_.corrections;
  movers_.repose(began, pose);
  tracks_.repose(began, pose);
}

LastKeyframe TrackingSession::last_keyframe() const {
  return {shared_.log.reference, shared_.map.keyframes_made()};
}

bool TrackingSession::look_back(FrameResult& result, TrackingLock& lock) {
  if (!options_.geometry || options_.localize_only || current_.depth.empty()) return false;
  const double now = current_.timestamp;
  // What was recognized by its looks need not be where it was expected.
  if (state_ != TrackingState::kTracked || second_look_.is_over(now)) {
    second_look_.begin_anew(current_, last_keyframe());
    return false;
  }
  if (!second_look_.is_due(now)) return false;
  std::optional<RigidTransform> T_cam_world;
  {
    const ScopedTimer timer(result.ms.geometry);
    without_map(lock, [&] {
      const auto motions = tracker_.guess_by_descriptors(second_look_.first(), current_);
      T_cam_world = second_look_.contradict(motions, current_);
    });
  }
  // The map may have been corrected, and the keyframe dropped, meanwhile.
  if (shared_.map.find_keyframe(second_look_.keyframe().id) == nullptr) second_look_.cancel();
  if (!T_cam_world || second_look_.is_cancelled()) return false;
  forget_since_first_look(*T_cam_world);
  corrected_velocity_ = second_look_.velocity(now, *T_cam_world);
  tracker_.forget_alignment();
  current_.start_over();
  current_.T_cam_world = *T_cam_world;
  find_movers(result, lock);
  result.inliers = tracker_.track_local_map(shared_.map, shared_.log.reference, current_, true);
  if (result.inliers < options_.tracking.min_inliers) current_.T_cam_world = *T_cam_world;
  return true;
}

// Keyframes are refined with the map.
void TrackingSession::revise_past(FrameResult& result, bool located) {
  if (options_.localize_only) return;
  const ScopedTimer timer(result.ms.optimize);
  if (located && !result.keyframe) {
    past_.add(current_, tracker_.matched_points(current_.features->size()), shared_.log.size());
  }
  past_.revise(current_.timestamp, shared_.map, tracker_, shared_.log);
  tracker_.take_times();
}

}  // namespace dynslam::slam
