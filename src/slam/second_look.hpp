// Second thoughts about the motion since an earlier frame.
#pragma once

#include <cstddef>
#include <optional>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"

#include "tracked_frame.hpp"

namespace dynslam::slam {

/// The keyframe that a frame hangs on, and how many keyframes had been made by then.
struct LastKeyframe {
  KeyframeId id = kNoId;
  std::size_t made = 0;
};

/// Compares a frame with an earlier one once movers have left their places.
///
/// Between two frames one motion may explain the background and what walks before it alike, halfway
/// between the two, and from there on each frame confirms the last; above all when a map begins and
/// nothing is known of what moves. A few tenths of a second later no single motion explains both.
/// Of the motions that the features of both frames agree on, the one that was tracked, and those
/// that aligned depth makes of them, the background's is the one under which the largest surface
/// stays where it was. In square metres: what moves is near and fills the image, but it is of the
/// size of a person, and the background is not. What is in conflict does not count, because under
/// the true motion everything that moves is.
class SecondLook {
 public:
  explicit SecondLook(const PinholeCamera& camera) : camera_(camera) {}

  /// A map begins with this frame: it will be looked back at early and twice.
  void begin(TrackedFrame& first, const LastKeyframe& keyframe);
  /// From now on this frame is looked back at, once.
  void begin_anew(TrackedFrame& first, const LastKeyframe& keyframe);
  /// There is no frame to look back at any more.
  void cancel() { first_.surface.clear(); }
  bool is_cancelled() const { return first_.surface.empty(); }
  /// Whether the first frame is to be looked back at from a frame of this time.
  bool is_due(double timestamp) const;
  /// Whether it will not be looked back at any more.
  bool is_over(double timestamp) const;

  /// The frame that is looked back at: its features, pose, time and surface.
  const TrackedFrame& first() const { return first_; }
  /// The keyframe that it hangs on.
  const LastKeyframe& keyframe() const { return keyframe_; }
  /// T_cam_world of a frame if it is clearly another than the one that was tracked; nothing if that
  /// was right or cannot be told. `motions`: what else T_first_cam may be. O(motions x cells),
  /// about 0.5 ms each.
  std::optional<RigidTransform> contradict(Span<const RigidTransform> motions, TrackedFrame& frame);
  /// Where the camera was at a time between the first frame and one whose pose has been corrected.
  RigidTransform between(double timestamp, double corrected_timestamp,
                         const RigidTransform& corrected) const;
  /// Twist of T_cam_world a second of a camera that was corrected to be here.
  Vector6d velocity(double corrected_timestamp, const RigidTransform& corrected) const;

 private:
  void take(TrackedFrame& first, const LastKeyframe& keyframe, Span<const double> looks);
  double clearly() const;
  RigidTransform polished(const RigidTransform& T_first_cam, double certainty,
                          const TrackedFrame& frame) const;

  PinholeCamera camera_;
  TrackedFrame first_;
  LastKeyframe keyframe_;
  Span<const double> looks_;  // seconds after the first frame that are still to come
  int withstood_ = 0;         // looks since the map began or the camera was corrected
};

}  // namespace dynslam::slam
