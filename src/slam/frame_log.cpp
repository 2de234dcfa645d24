#include "frame_log.hpp"

#include <vector>

namespace dynslam::slam {

RigidTransform FrameLog::pose_of(const Map& map, const Record& record) {
  if (record.reference == kWorld) return record.T_cam_reference;
  return record.T_cam_reference * map.keyframe(record.reference).T_cam_world;
}

void FrameLog::add(const Map& map, double timestamp,
                   const std::optional<RigidTransform>& T_cam_world) {
  Record record;
  record.timestamp = timestamp;
  if (T_cam_world) {
    record.reference = reference;
    record.T_cam_reference = *T_cam_world * map.keyframe(reference).T_cam_world.inverse();
  }
  records_.push_back(record);
}

void FrameLog::release(const Map& map, KeyframeId keyframe, KeyframeId fallback) {
  const std::vector<KeyframeId> neighbours = map.covisible_keyframes(keyframe, 1);
  const KeyframeId heir = neighbours.empty() ? fallback : neighbours.front();
  const RigidTransform T_keyframe_heir =
      map.keyframe(keyframe).T_cam_world * map.keyframe(heir).T_cam_world.inverse();
  for (Record& record : records_) {
    if (record.reference != keyframe) continue;
    record.reference = heir;
    record.T_cam_reference = record.T_cam_reference * T_keyframe_heir;
  }
  if (reference == keyframe) reference = heir;
}

void FrameLog::let_go_of_map(const Map& map) {
  for (Record& record : records_) {
    if (record.reference == kNoId) continue;
    record.T_cam_reference = pose_of(map, record);
    record.reference = kWorld;
  }
  reference = kNoId;
}

void FrameLog::repose(const Map& map, double after, KeyframeId keyframe,
                      const std::function<RigidTransform(double)>& pose) {
  const RigidTransform T_world_keyframe = map.keyframe(keyframe).T_cam_world.inverse();
  for (auto record = records_.rbegin(); record != records_.rend(); ++record) {
    if (record->timestamp <= after) break;
    if (record->reference == kNoId) continue;
    record->reference = keyframe;
    record->T_cam_reference = pose(record->timestamp) * T_world_keyframe;
  }
}

void FrameLog::rescale(const std::function<double(KeyframeId)>& factor) {
  for (Record& record : records_) {
    if (record.reference == kNoId || record.reference == kWorld) continue;
    const double scale = factor(record.reference);
    record.T_cam_reference.t *= scale;
    if (&record == &records_.back()) scale_ *= scale;
  }
}

KeyframeId FrameLog::reference_of(std::size_t index) const {
  const KeyframeId keyframe = records_[index].reference;
  return keyframe == kWorld ? kNoId : keyframe;
}

std::optional<RigidTransform> FrameLog::pose(const Map& map, std::size_t index) const {
  if (reference_of(index) == kNoId) return std::nullopt;
  return pose_of(map, records_[index]);
}

void FrameLog::set_pose(const Map& map, std::size_t index, const RigidTransform& T_cam_world) {
  Record& record = records_[index];
  record.T_cam_reference = T_cam_world * map.keyframe(record.reference).T_cam_world.inverse();
}

std::optional<RigidTransform> FrameLog::last_pose(const Map& map) const {
  if (records_.empty()) return std::nullopt;
  return pose(map, records_.size() - 1);
}

std::optional<RigidTransform> FrameLog::latest_pose(const Map& map) const {
  for (auto record = records_.rbegin(); record != records_.rend(); ++record) {
    if (record->reference != kNoId) return pose_of(map, *record);
  }
  return std::nullopt;
}

Trajectory FrameLog::trajectory(const Map& map) const {
  Trajectory poses;
  for (const Record& record : records_) {
    if (record.reference == kNoId) continue;
    poses.push_back({record.timestamp, pose_of(map, record).normalized().inverse()});
  }
  return poses;
}

}  // namespace dynslam::slam
