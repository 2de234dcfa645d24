// Features followed from frame to frame, and what the weighted geometric constraint says of them.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/match.hpp"
#include "dynslam/geometry/verdict.hpp"
#include "dynslam/geometry/views.hpp"
#include "dynslam/geometry/weighted_constraint.hpp"

#include "tracked_frame.hpp"

namespace dynslam::slam {

/// Keeps the last frames with the chain of matches between them, static or not, and compares the
/// present frame with frames of up to a second ago.
class FeatureTracks {
 public:
  FeatureTracks(const DepthCamera& camera, const std::vector<float>& scale_factors);

  /// Judges every feature of a frame whose pose is known (P-Static section 3.2). O(features).
  void judge(const TrackedFrame& frame);
  /// By feature of the frame judged last.
  Span<const geometry::FeatureVerdict> verdicts() const { return verdicts_; }

  /// Keeps the frame judged last, under its final pose.
  void remember(const TrackedFrame& frame);
  void clear() { past_.clear(); }
  /// Takes the frames kept along when the world is laid out anew.
  void move_world(const RigidTransform& T_before_after);
  /// Gives the frames kept after a time other poses, T_cam_world by timestamp.
  void repose(double after, const std::function<RigidTransform(double)>& pose);

 private:
  struct Past {
    FrameFeaturesPtr features;
    double timestamp = 0.0;
    RigidTransform T_cam_world;
    std::vector<std::int32_t> previous;  // by feature: the feature of the frame before, -1 = none
    std::vector<float> scales, spreads;
    std::vector<float> odds;  // by feature: remembered log p(dynamic)/p(static)
  };
  void measure(const TrackedFrame& frame, Past& now) const;
  void recall(Past& now);
  geometry::FeaturesView view(const Past& past) const;

  PinholeCamera camera_;
  std::vector<float> scale_factors_;
  std::deque<Past> past_;  // newest first
  Past now_;
  std::vector<std::int32_t> chain_;
  std::vector<std::vector<Match>> matches_;
  std::vector<geometry::ReferenceView> references_;
  geometry::WeightedConstraintWorkspace workspace_;
  std::vector<geometry::FeatureVerdict> verdicts_;
};

}  // namespace dynslam::slam
