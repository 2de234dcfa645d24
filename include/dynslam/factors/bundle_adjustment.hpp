// Local bundle adjustment over keyframes, points and static weights.
#pragma once

#include <atomic>
#include <cstdint>
#include <limits>
#include <memory>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/factors/pose_optimizer.hpp"
#include "dynslam/factors/robust_loss.hpp"

namespace dynslam::factors {

/// One sighting of a point from a keyframe.
struct BundleObservation {
  std::uint32_t keyframe = 0;  ///< index into BundleProblem::T_cam_world
  std::uint32_t point = 0;     ///< index into BundleProblem::points_world
  float u = 0.0F;              ///< undistorted pixels
  float v = 0.0F;
  float right_column = std::numeric_limits<float>::quiet_NaN();  ///< u_R; NaN or < 0: mono
  float inverse_sigma = 1.0F;                                    ///< 1/pixels, > 0
  float weight = 1.0F;                                           ///< phi0 in [0, 1]
  /// 1/sigma of the u_R row where it differs (depth noise), >= 0; 0: as without depth; NaN:
  /// inverse_sigma.
  float right_inverse_sigma = std::numeric_limits<float>::quiet_NaN();
};

/// What to optimize; views, states are changed in place.
struct BundleProblem {
  DepthCamera camera;                       ///< of all keyframes
  Span<RigidTransform> T_cam_world;         ///< in/out
  Span<const std::uint8_t> keyframe_fixed;  ///< 1 = held; empty: the caller holds none (the gauge
                                            ///< is then held by damping alone)
  Span<Eigen::Vector3d> points_world;       ///< in/out, metres
  Span<const std::uint8_t> point_fixed;     ///< 1 = held; empty: none
  Span<const BundleObservation> observations;
  /// Outputs by observation; each may be empty (not wanted).
  Span<std::uint8_t> inliers;     ///< 1 when within chi2 at the result and in front of the camera
  Span<float> weights;            ///< optimized phi; 0 where not usable
  Span<float> squared_residuals;  ///< s = r' S^-1 r; infinity where not usable
};

/// Which solver runs.
enum class BundleSolver {
  kSchur,  ///< dynslam's own: points eliminated, reduced camera system by Cholesky
  kCeres,  ///< Ceres SPARSE_SCHUR over the same factors; needs a build with Ceres
};

/// Options of optimize_bundle.
struct BundleOptions {
  BundleSolver solver = BundleSolver::kSchur;
  WeightMode weights = WeightMode::kFixed;  ///< kJoint/kEliminated: one phi per observation
  double lambda = 9.0;                      ///< see PoseOptimizerOptions::lambda, > 0
  RobustLoss loss = {LossKind::kHuber, 2.447, 1.0};  ///< of `kFixed`: cost 1/2 phi0^2 rho(s)
  int max_iterations = 10;                           ///< >= 1
  double chi2_mono = 5.991;                          ///< inlier bound on s, 2 rows, > 0
  double chi2_depth = 7.815;                         ///< inlier bound on s, 3 rows, > 0
  double cost_tolerance = 1e-6;   ///< stop on relative decrease below, >= 0 (0: never)
  double initial_damping = 1e-5;  ///< relative to the diagonal, > 0
  /// Ceres only: DENSE_SCHUR up to this many free keyframes, SPARSE_SCHUR above, >= 0 (0: always
  /// sparse); engineering. kJoint is always sparse
  int ceres_dense_keyframes = 40;
  const std::atomic<bool>* abort = nullptr;  ///< polled between iterations; may be raised from
                                             ///< another thread; the best state so far is kept

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// What happened.
struct BundleSummary {
  SolveStatus status = SolveStatus::kTooFewPoints;
  double initial_cost = 0.0;
  double final_cost = 0.0;
  int iterations = 0;
  int observations = 0;  ///< usable ones
  int inliers = 0;
  const char* linear_solver = "";  ///< which one ran, e.g. "own Schur, dense Cholesky",
                                   ///< "Ceres SPARSE_SCHUR (SUITE_SPARSE)"
};

/// Scratch memory of the Schur solver; keep one to avoid allocating each time. One per thread.
class BundleWorkspace {
 public:
  BundleWorkspace();
  ~BundleWorkspace();
  BundleWorkspace(BundleWorkspace&&) noexcept;
  BundleWorkspace& operator=(BundleWorkspace&&) noexcept;

  struct Impl;
  Impl& impl() { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

/// Whether BundleSolver::kCeres and the pose graph were compiled in.
bool has_ceres();

/// Minimizes over free keyframes and points (and weights, by mode)
///   sum of 1/2 phi0^2 rho(s)  or  1/2 [phi^2 s + lambda (phi - phi0)^2].
///
/// Throws InvalidArgument for indices out of range, sizes that differ, weights outside [0, 1],
/// a non-finite keyframe, or solver Ceres in a build without it; the problem is untouched then.
/// Observations with NaN, of a NaN point, of weight 0, or of a free point with fewer than three
/// rows do not take part; behind the camera they do not pull. Thread-safe for distinct problems and
/// workspaces. O(observations * covisibility) an iteration.
BundleSummary optimize_bundle(const BundleProblem& problem, const BundleOptions& options = {},
                              BundleWorkspace* workspace = nullptr);

}  // namespace dynslam::factors
