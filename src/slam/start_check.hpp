// Second thoughts about the first motion of a map.
#pragma once

#include <optional>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"

#include "tracked_frame.hpp"

namespace dynslam::slam {

/// Compares a frame with the first one of its map once movers have left their places.
///
/// When a map begins nothing is known of what moves, nor how fast the camera is. Between two frames
/// one motion may then explain the background and what walks before it alike, halfway between the
/// two, and from there on each frame confirms the last. A few tenths of a second later no single
/// motion does. Of the motions that the features of both frames agree on, and the one that was
/// tracked, the background's is the one under which most of what both cameras see has stayed where
/// it was: what moves explains itself alone then. What is in conflict does not count, because under
/// the true motion everything that moves is.
class StartCheck {
 public:
  explicit StartCheck(const PinholeCamera& camera) : camera_(camera) {}

  /// A map begins with this frame.
  void begin(const TrackedFrame& first);
  /// The map is gone, or its start is not in question.
  void cancel() { first_.surface.clear(); }
  /// Whether the start is to be looked at again in a frame of this time.
  bool is_due(double timestamp) const;

  /// The frame that the map began with: its features, pose, time and surface.
  const TrackedFrame& first() const { return first_; }
  /// T_cam_world of a frame if it is clearly another than the one that was tracked; nothing if the
  /// start was right or cannot be told. `motions`: what else T_first_cam may be. O(motions x
  /// cells).
  std::optional<RigidTransform> contradict(Span<const RigidTransform> motions, TrackedFrame& frame);
  /// Where the camera was at a time between the first frame and one whose pose has been corrected.
  RigidTransform between(double timestamp, double corrected_timestamp,
                         const RigidTransform& corrected) const;

 private:
  PinholeCamera camera_;
  TrackedFrame first_;
  int looks_ = 0;
};

}  // namespace dynslam::slam
