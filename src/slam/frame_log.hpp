// Where every frame was, relative to the map.
#pragma once

#include <cstddef>
#include <deque>
#include <functional>
#include <optional>
#include <utility>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/trajectory.hpp"
#include "dynslam/slam/map.hpp"

namespace dynslam::slam {

/// Poses of all frames relative to keyframes, so that they follow when the map is corrected.
class FrameLog {
 public:
  /// The keyframe that tracking goes by; new frames hang on it. kNoId: none.
  KeyframeId reference = kNoId;

  /// Appends a frame, with its pose if it has one.
  void add(const Map& map, double timestamp, const std::optional<RigidTransform>& T_cam_world);
  /// Hangs the frames of a keyframe on its best neighbour, or on `fallback`; call before the
  /// keyframe is erased. O(frames).
  void release(const Map& map, KeyframeId keyframe, KeyframeId fallback);
  /// Keeps the poses as they are now, because the map is about to be dropped.
  void let_go_of_map(const Map& map);

  /// Gives the frames after a time other poses, T_cam_world by timestamp, all relative to one
  /// keyframe. Frames without a pose stay so. O(frames since).
  void repose(const Map& map, double after, KeyframeId keyframe,
              const std::function<RigidTransform(double)>& pose);

  /// Multiplies the distance of each frame from its keyframe by a factor of that keyframe.
  /// O(frames).
  void rescale(const std::function<double(KeyframeId)>& factor);
  /// By how much lengths around the last frame have grown since this was last asked.
  double take_scale() { return std::exchange(scale_, 1.0); }

  /// T_cam_world of a frame by its running number, under the present map, if it has one.
  std::optional<RigidTransform> pose(const Map& map, std::size_t index) const;
  /// Gives a frame that has a pose under the present map another, T_cam_world.
  void set_pose(const Map& map, std::size_t index, const RigidTransform& T_cam_world);
  /// The keyframe that a frame hangs on; kNoId if it has no pose under the present map.
  KeyframeId reference_of(std::size_t index) const;

  std::size_t size() const { return records_.size(); }
  bool empty() const { return records_.empty(); }
  double last_timestamp() const { return records_.back().timestamp; }
  /// T_cam_world of the last frame under the present map, if it has one.
  std::optional<RigidTransform> last_pose(const Map& map) const;
  /// T_cam_world of the last frame that has a pose. O(frames lost since).
  std::optional<RigidTransform> latest_pose(const Map& map) const;
  /// Poses camera to world of the frames that have one. O(frames).
  Trajectory trajectory(const Map& map) const;

 private:
  struct Record {
    double timestamp;
    KeyframeId reference = kNoId;  // kNoId: no pose; kWorld: of a map that is gone
    RigidTransform T_cam_reference;
  };
  static constexpr KeyframeId kWorld = kNoId - 1;
  static RigidTransform pose_of(const Map& map, const Record& record);

  std::deque<Record> records_;  // grows without a second copy of a long run
  double scale_ = 1.0;          // of the last record's surroundings, by what they were
};

}  // namespace dynslam::slam
