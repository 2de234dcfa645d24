// Whether two keyframes show one place: by their features, then by the map around them.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/factors/similarity.hpp"
#include "dynslam/loop/verification.hpp"
#include "dynslam/slam/options.hpp"

#include "keyframe_database.hpp"
#include "local_map.hpp"
#include "pose_estimation.hpp"
#include "shared_map.hpp"

namespace dynslam::slam {

/// An old place that a keyframe shows again.
struct LoopMatch {
  KeyframeId query = kNoId;
  KeyframeId match = kNoId;
  factors::Similarity S_query_match;  ///< of scale 1 where depth gives the unit
  int inliers = 0;                    ///< map points of the old place that the query confirms
  int visible = 0;                    ///< of those that it should see
  std::vector<std::pair<std::uint32_t, PointId>> points;  ///< query's feature shows old point
};

/// Verifies loops. Copies what it needs of the map under its lock, works without.
class LoopCheck {
 public:
  LoopCheck(const DepthCamera& camera, const std::vector<float>& scale_factors,
            const SystemOptions& options, SharedMap& shared, const KeyframeDatabase& database);

  /// First the motion between the two by three-point RANSAC over matched words, with depth on both
  /// sides; then all map points around the candidate are looked for in the query under that motion,
  /// and the pose is refined on them. Enough of them must agree in pixels and depth, and all over
  /// the part of the image that should show them; `found` is filled then.
  ///
  /// Without depth the motion is a similarity between the map points of both sides. How much the
  /// query's surroundings have grown is then the median over the points that both sides have of
  /// what is confirmed, which must agree on it.
  loop::Verification verify(KeyframeId query, KeyframeId candidate, LoopMatch& found);

 private:
  /// A keyframe's features and where their points are in its camera; NaN where that is not known.
  struct Side {
    FrameFeaturesPtr features;
    RigidTransform T_cam_world;
    std::vector<Eigen::Vector3d> points;
  };
  bool copy(KeyframeId id, Side& side) const;
  loop::Verification find_motion(KeyframeId query, KeyframeId candidate);
  int confirm(const RigidTransform& T_query_world, double radius, LoopMatch& found);
  std::size_t cell_of(cv::Point2f pixel) const;
  double confirmed_share() const;

  DepthCamera camera_;
  std::vector<float> scale_factors_;
  LoopOptions options_;
  bool with_scale_;
  SharedMap& shared_;
  const KeyframeDatabase& database_;
  Side query_, candidate_;
  LocalMap place_;  // the old place
  PoseEstimation pose_;
  RigidTransform refined_;
  std::vector<double> log_scales_;        // of confirmed points: distance at the query over that
  std::vector<int> visible_, confirmed_;  // by cell of the image: points of the place
};

}  // namespace dynslam::slam
