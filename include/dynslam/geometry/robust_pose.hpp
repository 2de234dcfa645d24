// Ego-motion while half the image moves: several rigid motions are found, and the background's is
// chosen by evidence instead of by count.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/geometry/verdict.hpp"
#include "dynslam/geometry/views.hpp"

namespace dynslam::geometry {

/// N map points and where they are seen now. Empty arrays mean "not known".
struct PoseProblem {
  Points world;                      ///< map points, world frame, metres; NaN = left out
  Pixels pixels;                     ///< where each is seen, undistorted
  StridedSpan<const float> depths;   ///< measured depth, metres; <= 0 or NaN = none; empty = none
  StridedSpan<const float> scales;   ///< pixel noise relative to level 0 (1.2^octave); empty = 1
  StridedSpan<const float> weights;  ///< p(static) in [0, 1] from mask, memory, matching: order of
                                     ///< sampling and worth of an inlier; NaN = 0.5; empty = 0.5
  StridedSpan<const float> ages;     ///< frames or seconds since the map point was made; empty = 0

  std::size_t size() const { return world.size(); }
};

/// Where the camera is expected (constant velocity), and how surely.
struct PosePrior {
  RigidTransform T_cam_world;
  double sigma_rotation = 0.05;     ///< radians, > 0
  double sigma_translation = 0.05;  ///< metres, > 0
};

struct RobustPoseOptions {
  int max_hypotheses = 3;        ///< motions looked for one after another, 1..8
  int max_iterations = 300;      ///< samples a motion, >= 1
  double confidence = 0.99;      ///< of having drawn one good sample, (0, 1); ends sampling early
  double pixel_threshold = 3.0;  ///< pixels at level 0 that an inlier's image may be off, > 0
  double depth_threshold = 4.0;  ///< standard deviations that its depth may be off, > 0
  double depth_floor = 0.03;     ///< metres added to that, >= 0
  DepthNoise depth_noise;
  int min_inliers = 12;        ///< fewer are no motion, >= 4
  double min_share = 0.1;      ///< of all usable points, [0, 1): fewer are no motion
  double separation = 3.0;     ///< two motions whose images of the points differ by less (pixels,
                               ///< median) are one, > 0
  int refinements = 6;         ///< Gauss-Newton steps on the inliers, >= 0
  double prior_weight = 1.0;   ///< of the prior in the choice, >= 0 (0: by support alone)
  double age_weight = 0.5;     ///< of the map points' age, >= 0
  double extent_weight = 1.0;  ///< of spatial extent, image border and far points, >= 0
  double depth_weight = 4.0;   ///< of the dense depth check, >= 0
  std::uint64_t seed = 1;      ///< same seed, same result

  void validate() const;
};

/// One rigid motion and the evidence that it is the background's.
struct PoseHypothesis {
  RigidTransform T_cam_world;
  int inliers = 0;
  double support = 0.0;       ///< sum of the inliers' weights over the sum of all weights
  double rms = 0.0;           ///< pixels, of the inliers
  double prior_distance = 0;  ///< squared Mahalanobis distance to the prior, 0 without prior
  double extent = 0.0;        ///< share of the 8 x 6 image tiles with an inlier
  double border = 0.0;        ///< share of the inliers in border tiles
  double far_share = 0.0;     ///< share of the inliers beyond the median depth of all points
  double age = 0.0;           ///< mean age of the inliers over mean age of all points
  double depth_score = 0.0;   ///< answer of the depth check, share in [0, 1]; 0 without check
  double score = 0.0;         ///< what the choice goes by
};

enum class PoseStatus : std::uint8_t {
  kOk,
  kTooFewPoints,  ///< fewer than `min_inliers` usable points
  kNoConsensus,   ///< no motion has enough inliers
  kAmbiguous,     ///< a pose is given, but another motion scores almost as well (within 10 %)
};

struct RobustPoseResult {
  PoseStatus status = PoseStatus::kTooFewPoints;
  RigidTransform T_cam_world;          ///< of the chosen hypothesis; identity if none
  int chosen = -1;                     ///< index into `hypotheses`
  bool dominant_is_background = true;  ///< false: most points move with something else
  /// In the order found: what continues the prior, if anything does, then most support first.
  std::vector<PoseHypothesis> hypotheses;
  std::vector<std::int8_t> motion;  ///< N: hypothesis each point moves with, -1 = none

  bool ok() const { return status == PoseStatus::kOk || status == PoseStatus::kAmbiguous; }
};

/// Answers how well a pose explains the whole depth image, 0..1 (for instance the static share of
/// `judge_depth` at a coarse stride). Empty = no such check.
using DepthCheck = std::function<double(const RigidTransform& T_cam_world)>;

namespace detail {

/// One usable point of a problem.
struct PosePoint {
  Eigen::Vector3d world, camera;  ///< `camera`: unprojected with its depth, if it has one
  Eigen::Vector2d pixel;
  double depth = 0.0;  ///< metres, 0 = none
  double weight = 0.5, age = 0.0;
  double pixel_limit = 0.0, depth_limit = 0.0;  ///< errors of an inlier
  int index = -1;                               ///< in the problem
};

}  // namespace detail

/// Scratch of `estimate_pose`. No allocation after warm-up.
struct RobustPoseWorkspace {
  std::vector<detail::PosePoint> points;
  std::vector<std::uint8_t> taken;
  std::vector<int> order, active, inliers;
  std::vector<double> values;
};

/// Absolute camera pose from map points seen in an RGB-D (or stereo) image, with movers.
///
/// Minimal samples are three points with depth (3D-3D absolute orientation), drawn in PROSAC order
/// of `weights`; support is the weighted number of points whose image and depth agree; the best
/// sample is refined by robust Gauss-Newton on reprojection and depth. Inliers are taken out
/// and the search repeated for further motions. Without a prior and check the background is the
/// motion of greatest extent among equals; with them it may have a small minority of the points.
///
/// `prior` may be null; if given, the motion next to it is looked for first, and it is also tried
/// as a sample. Points without depth take part as 2D inliers. Fewer than three points with depth
/// and no prior: kTooFewPoints. Throws InvalidArgument for unequal sizes, invalid options or
/// camera. Deterministic for a seed. O(iterations x N) worst case; about 1 ms for 500 points.
/// Thread-safe with one workspace per thread. Sources: Horn, JOSA A 1987 (absolute orientation);
/// Chum and Matas, CVPR 2005 (PROSAC); sequential multi-model RANSAC. The choice among motions is
/// ours.
void estimate_pose(const PinholeCamera& camera, const PoseProblem& problem, const PosePrior* prior,
                   const DepthCheck& depth_check, const RobustPoseOptions& options,
                   RobustPoseWorkspace& workspace, RobustPoseResult& result);

}  // namespace dynslam::geometry

#include "dynslam/geometry/detail/robust_pose_impl.hpp"
