// The life of a frame: prediction, pose, recovery, and whether it becomes a keyframe.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/slam/options.hpp"
#include "dynslam/slam/system.hpp"

#include "backend.hpp"
#include "feature_tracks.hpp"
#include "frame_builder.hpp"
#include "mono_initializer.hpp"
#include "mover_detector.hpp"
#include "past_frames.hpp"
#include "second_look.hpp"
#include "shared_map.hpp"
#include "tracked_frame.hpp"
#include "tracker.hpp"

namespace dynslam::slam {

/// Takes one frame after the other, on the caller's thread. Holds the map while it matches, and
/// lets go of it while features are extracted, surfaces aligned and movers found.
class TrackingSession {
 public:
  TrackingSession(const DepthCamera& camera, const SystemOptions& options, FrameBuilder& builder,
                  SharedMap& shared, Backend& backend);

  /// The frame is valid.
  FrameResult track(const FrameInput& frame);

  FeaturesView features() const { return view_of(last_); }
  /// The map there is was made before: the camera is lost in it. Before the first frame.
  void start_in_known_map();

  MoversView movers();

 private:
  void step(FrameResult& result);
  bool locate(FrameResult& result, TrackingLock& lock);
  bool initialize(FrameResult& result, TrackingLock& lock);
  bool initialize_mono(FrameResult& result);
  bool expect_motion(TrackingLock& lock);
  bool follow(TrackingLock& lock);
  bool relocalize();
  std::vector<KeyframeId> relocalization_candidates();
  void restart_if_hopeless();
  bool wants_keyframe(int inliers) const;
  bool looks_new() const;
  void make_keyframe(FrameResult& result, TrackingLock& lock);
  void find_movers(FrameResult& result, TrackingLock& lock);
  /// Whether the frame is elsewhere than any motion since the last one could have taken it.
  bool jumped() const;
  /// Looks back at an earlier frame; true if the camera was elsewhere than it was tracked.
  bool look_back(FrameResult& result, TrackingLock& lock);
  LastKeyframe last_keyframe() const;
  void forget_since_first_look(const RigidTransform& T_cam_world);
  void update_velocity();
  /// Estimates frames of a second ago once more, and keeps this one for that.
  void revise_past(FrameResult& result, bool located);
  void follow_corrections();
  template <typename Work>
  void without_map(TrackingLock& lock, const Work& work);

  SystemOptions options_;
  FrameBuilder& builder_;
  SharedMap& shared_;
  Backend& backend_;
  Tracker tracker_;
  MonoInitializer mono_;
  FeatureTracks tracks_;
  MoverDetector movers_;
  SecondLook second_look_;
  PastFrames past_;
  TrackedFrame current_, last_;
  TrackingState state_ = TrackingState::kNotInitialized;
  std::size_t frames_since_keyframe_ = 0;
  int most_inliers_ = 0;            // of the frames since the last keyframe
  std::size_t next_candidate_ = 0;  // where the search for a lost frame goes on
  double lost_since_ = 0.0;
  bool movers_found_ = false;         // in the last frame
  bool known_map_ = false;            // it is not dropped, however long the camera is lost
  RigidTransform T_cam_origin_;       // pose of the frame that a map begins with
  std::optional<Vector6d> velocity_;  // twist of T_cam_last a second
  std::optional<Vector6d> corrected_velocity_;  // the same by a second look at this frame
  std::optional<RigidTransform> told_;          // T_cam_world of the last frame as it was returned
  std::size_t told_loops_ = 0;                  // and the loops beside it
  std::uint64_t corrections_ = 0;               // of the map that the poses kept here know of
};

template <typename Work>
void TrackingSession::without_map(TrackingLock& lock, const Work& work) {
  lock.unlock();
  work();
  lock.lock();
  follow_corrections();
}

}  // namespace dynslam::slam
