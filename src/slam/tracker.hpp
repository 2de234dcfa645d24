// Pose of each frame: from the last frame, then from the map.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <opencv2/core/types.hpp>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/match.hpp"
#include "dynslam/geometry/robust_pose.hpp"
#include "dynslam/matching/workspace.hpp"
#include "dynslam/slam/map.hpp"
#include "dynslam/slam/options.hpp"

#include "depth_alignment.hpp"
#include "local_map.hpp"
#include "motion_filter.hpp"
#include "point_looks.hpp"
#include "pose_estimation.hpp"
#include "tracked_frame.hpp"

namespace dynslam::slam {

constexpr double kGuessTranslation = 0.02;  // metres that the velocity may be off
constexpr double kGuessRotation = 0.02;     // radians

/// Milliseconds by stage, summed over a frame.
struct TrackerTimes {
  double match = 0.0;
  double optimize = 0.0;
};

class Tracker {
 public:
  Tracker(const DepthCamera& camera, const SystemOptions& options,
          const std::vector<float>& scale_factors);

  /// Pose of `frame` from `last` by constant velocity and windows. Fills pose and points of
  /// `frame`; false if that fails.
  ///
  /// With a `depth_check` several motions are looked for among the matches, and the one that the
  /// background follows is taken: the check says how well a pose explains the depth image.
  bool track_last_frame(const Map& map, const TrackedFrame& last, TrackedFrame& frame,
                        const geometry::DepthCheck& depth_check = {});

  /// Refines the pose with every map point that should be visible; returns the inliers. `wide`
  /// opens the windows (after a relocalization). Counts how often points should have been seen and
  /// were.
  int track_local_map(Map& map, KeyframeId reference, TrackedFrame& frame, bool wide);

  /// The map points that features of the frame that was tracked last were matched with, by feature,
  /// whether or not they agreed; kNoId = none. Of the first `features` of them: sought ones may
  /// have been let go of.
  std::vector<PointId> matched_points(std::size_t features) const;

  /// Pose of an earlier frame once more, from the points that it was matched with (`points`, by
  /// feature) as the map has them now, without those that are known to move. A frame that has its
  /// images still is then matched anew with what the map offers around `reference`. False, with the
  /// pose as it was, if too few agree. Leaves map, noise and motion as they are.
  bool estimate_again(const Map& map, KeyframeId reference, TrackedFrame& frame);

  /// Pose of a frame from the looks of it: matches descriptors with a keyframe's points and solves
  /// PnP. Fills pose and points; false if too few agree.
  bool match_keyframe(const Map& map, KeyframeId keyframe, TrackedFrame& frame);

  /// Aligns the depth images of two frames and expects the camera where that puts it: for frames
  /// with too few features. False if depth does not determine the motion.
  bool align_depth(TrackedFrame& last, TrackedFrame& frame);
  /// The same for frames so far apart that the motion may be anything: many starts, among them
  /// what the descriptors of both frames say. Tens of milliseconds.
  bool align_wide_step(TrackedFrame& last, TrackedFrame& frame);
  /// Refines where the camera is expected by aligning what stood still in the last frame, shape and
  /// brightness; directions that these leave open stay as they were.
  void align_background(TrackedFrame& last, TrackedFrame& frame);
  /// Motions between two frames, T_last_cam, that many of their descriptors agree on.
  std::vector<RigidTransform> guess_by_descriptors(const TrackedFrame& last,
                                                   const TrackedFrame& frame);
  /// Whether the pose of this frame rests on aligned depth.
  bool depth_aligned() const { return prior_.has_value(); }
  /// Whether that was done by align_wide_step, which may be off by a few pixels.
  bool wide_step() const { return wide_step_; }
  /// Begins a frame that comes `step` seconds after the last: nothing is aligned yet.
  void begin_frame(const TrackedFrame& last, double step) {
    step_ = step;
    forget_alignment();
    motion_.predict(last.T_cam_world, step);
  }
  /// Forgets what was aligned, and the motion that was to be expected.
  void forget_alignment() {
    motion_.forget_prediction();
    prior_.reset();
    wide_step_ = false;
  }

  void set_velocity(const RigidTransform& T_cam_last) { velocity_ = predicted_ = T_cam_last; }
  /// The unit of length is another one around here: lengths are `scale` times as long.
  void rescale(double scale) {
    velocity_.t *= scale;
    predicted_.t *= scale;
  }
  RigidTransform expected_pose(const TrackedFrame& last) const {
    return (velocity_ * last.T_cam_world).normalized();
  }
  /// Forgets how the camera moved: the pose it has now was not reached by moving.
  void forget_motion() { motion_.reset(); }
  void forget_velocity() { velocity_ = predicted_ = RigidTransform(); }

  const LocalMap& local_map() const { return local_map_; }
  TrackerTimes take_times();

 private:
  /// Points of the world that may be seen, and where.
  struct Predictions {
    std::vector<PointId> ids;
    std::vector<Eigen::Vector3d> positions;
    std::vector<float> weights;
    std::vector<cv::Point2f> pixels;
    std::vector<float> radii;
    std::vector<int> octaves, min_octaves, max_octaves;
    void resize(std::size_t n);
  };

  /// Matches as a problem of several motions.
  struct MotionProblem {
    std::vector<Eigen::Vector3d> world;
    std::vector<cv::Point2f> pixels;
    std::vector<float> depths, scales, weights, ages;
    geometry::RobustPoseWorkspace workspace;
    geometry::RobustPoseResult result;
    void clear();
    void add(const Eigen::Vector3d& point, cv::Point2f pixel, float depth, float scale,
             float weight, float age);
    geometry::PoseProblem problem() const;
  };

  bool match_last_frame(const Map& map, const TrackedFrame& last, double radius,
                        TrackedFrame& frame, const geometry::DepthCheck& depth_check);
  /// Looks for several motions among `matches_` and keeps those matches that follow the
  /// background's, with its pose in `frame`; all of them where no motion stands out.
  void keep_background(const Map& map, const TrackedFrame& last,
                       const geometry::DepthCheck& depth_check, TrackedFrame& frame);
  void set_prior(const TrackedFrame& last, const SurfaceAlignment& alignment);
  void predict_from_last(const Map& map, const TrackedFrame& last, double radius,
                         const RigidTransform& T_cam_world);
  void predict_from_map(const RigidTransform& T_cam_world, double radius);
  /// Fills `matches_` with the points of the local map that are found.
  void match_local_map(const Map& map, KeyframeId reference, TrackedFrame& frame, bool wide);
  void match_predictions(DescriptorsView descriptors, float ratio, const TrackedFrame& frame);
  bool solve_pnp(const std::vector<Eigen::Vector3d>& points, const FrameFeatures& features,
                 const std::vector<Match>& matches, RigidTransform& T_cam_world,
                 std::vector<Match>& inliers) const;
  /// phi0 of a match: what segmentation (it left the feature), geometry and the last frames say.
  float initial_weight(float remembered, float geometric) const;
  void reject_matches(const TrackedFrame& last, const TrackedFrame& frame);
  /// Sets how far the surfaces lie that `matches_` are on.
  void measure_distance(const RigidTransform& T_cam_world);
  /// Worth of a match by the belief that its point stands still.
  float worth(float belief, const Eigen::Vector3d& position,
              const RigidTransform& T_cam_world) const;
  void prefer_proven(const RigidTransform& T_cam_world);
  void remember_weights(Map& map, const TrackedFrame& frame) const;
  /// Optimizes the pose over `matches_` and writes points and rejections; returns the inliers.
  int optimize(TrackedFrame& frame, const std::vector<PointId>& ids,
               const std::optional<factors::PosePrior>& prior);
  /// The same with what is expected of the pose, unless features contradict that.
  int optimize_as_expected(TrackedFrame& frame, const std::optional<factors::PosePrior>& expected);
  /// Moves the key points of `matches_` to where their points look as they do in the map, and seeks
  /// the points without a match by their looks; true if `matches_` changed by that.
  bool match_looks(const Map& map, TrackedFrame& frame);
  /// Fills `matches_` with what an earlier frame was matched with then.
  void recall_matches(const Map& map, const TrackedFrame& frame);
  /// Optimizes the pose of an earlier frame over `matches_`, without what is known to move; false
  /// if too few agree.
  bool solve_again(TrackedFrame& frame);
  double agreeing_weight() const;
  /// What the motion so far and the alignment of surfaces say of the pose together.
  std::optional<factors::PosePrior> expected_motion();
  /// The frame has the pose that was optimized last: a step of the motion so far.
  void remember_motion(const TrackedFrame& frame);

  DepthCamera camera_;
  TrackingOptions options_;
  bool weighted_, geometry_, reject_matches_, learns_, metric_;
  std::vector<float> scale_factors_;
  PoseEstimation pose_;
  LookFinder looks_;
  LocalMap local_map_;
  RigidTransform velocity_;                  // T_cam_last, by aligned surfaces where there are any
  RigidTransform predicted_;                 // the same by the motion so far alone
  std::optional<factors::PosePrior> prior_;  // by aligned surfaces
  MotionFilter motion_;
  std::optional<Matrix6d> covariance_;  // of the pose that was optimized last
  double step_ = 0.0;                   // seconds since the last frame
  bool wide_step_ = false;
  double middle_distance_ = 1.0;  // metres, median of the points matched
  TrackerTimes times_;
  Predictions predictions_;
  std::vector<Match> found_;
  std::vector<PointMatch> matches_;
  std::vector<SoughtPoint> sought_;
  std::vector<std::uint8_t> taken_, keep_;
  matching::Workspace rejection_;
  MotionProblem motions_;
};

}  // namespace dynslam::slam
