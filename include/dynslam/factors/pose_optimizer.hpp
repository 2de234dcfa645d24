// Pose of one camera from weighted observations of known points.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/points.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/factors/robust_loss.hpp"

namespace dynslam::factors {

/// How static weights take part in an optimization (theory: P-Static section 4).
enum class WeightMode {
  kFixed,       ///< phi = phi0, cost 1/2 rho(phi0^2 s)... see PoseOptimizerOptions::loss
  kJoint,       ///< phi are parameters beside the pose, as in the paper
  kEliminated,  ///< phi replaced by their closed form: same optimum, price of the pose alone
};

/// Why an optimization stopped.
enum class SolveStatus {
  kConverged,      ///< step, gradient or cost change fell below its tolerance
  kMaxIterations,  ///< usable, but still moving
  kTooFewPoints,   ///< fewer usable observations than `min_observations`; pose is the initial one
  kDegenerate,  ///< data leave a direction of the pose undetermined (points on a line, coincident
                ///< points); the pose is finite, minimizes the cost, and is not to be trusted
  kNonFinite,   ///< the initial pose is not finite; returned unchanged
  kAborted,     ///< the abort flag was raised; the best state so far is returned
};

/// Name of a status, "Converged" etc.
const char* to_string(SolveStatus status);

/// Whether the result may be used as a pose: Converged or MaxIterations.
constexpr bool usable(SolveStatus status) {
  return status == SolveStatus::kConverged || status == SolveStatus::kMaxIterations;
}

/// Options of PoseOptimizer.
struct PoseOptimizerOptions {
  WeightMode weights = WeightMode::kEliminated;  ///< which of the three solvers
  double lambda = 9.0;  ///< stiffness of the weight prior, squared standard deviations, > 0: at
                        ///< s = lambda the optimal weight is half of phi0; engineering. kJoint
                        ///< and kEliminated only
  /// of `kFixed`, cost 1/2 phi0^2 rho(s); kJoint and kEliminated are robust by themselves
  RobustLoss loss = {LossKind::kHuber, 2.447, 1.0};
  int rounds = 1;  ///< rounds of optimization, >= 1; after each, every observation is tested
                   ///< against chi2 and outliers sit out the next round (ORB-SLAM's habit: 4)
  int max_iterations = 20;    ///< Levenberg-Marquardt iterations a round, >= 1
  double chi2_mono = 5.991;   ///< inlier bound on s for 2 rows, > 0; 95 % of chi^2 with 2 d.o.f.
  double chi2_depth = 7.815;  ///< inlier bound on s for 3 rows, > 0; 95 % of chi^2 with 3 d.o.f.
  bool loss_in_last_round = true;  ///< false: the last of several rounds is plain least squares
                                   ///< over the inliers (kFixed only; the field's habit)
  int min_observations = 4;        ///< usable observations below which nothing is done, >= 3
  double step_tolerance = 1e-7;    ///< stop when |xi| falls below (metres, radians), >= 0
  double cost_tolerance = 1e-7;    ///< stop when the relative decrease of cost falls below, >= 0
  double initial_damping = 1e-6;   ///< Levenberg-Marquardt damping relative to the diagonal, > 0
  bool compute_covariance = true;  ///< fill PoseResult::covariance

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Observations of one frame; views, read during the call only.
///
/// An observation takes part when its point, pixel and sigma are finite, its weight > 0 and its
/// point lies in front of the camera; otherwise it is dropped (from that iteration, if it is
/// behind the camera only there) and flagged in `PoseOptimizer::inliers()`. NaN is therefore "not
/// there", in any input. `PixelScalar` is float or double: cv::KeyPoint binds by
/// `as_points<float>(field(keypoints, &cv::KeyPoint::pt))`.
template <typename PixelScalar>
struct PoseObservations {
  PointsRef<double, 3> points_world;            ///< 3 x N, metres
  PointsRef<PixelScalar, 2> pixels;             ///< 2 x N, undistorted pixels
  StridedSpan<const float> right_columns = {};  ///< u_R of each, pixels; NaN or < 0: this one is
                                                ///< mono (2 rows). Empty: all mono
  Span<const float> inverse_sigma = {};         ///< 1/sigma, 1/pixels, > 0 (per octave:
                                                ///< scale_factor^-octave). Empty: 1
  Span<const float> weights = {};               ///< phi0 in [0, 1]. Empty: 1
  Span<const float> right_inverse_sigma = {};   ///< 1/sigma of the u_R row where it differs
                                                ///< (depth noise). Empty: inverse_sigma
};

/// What is known of the pose before looking: cost 1/2 d' information d, d = log(T mean^-1).
struct PosePrior {
  RigidTransform mean;                      ///< T_cam_world
  Matrix6d information = Matrix6d::Zero();  ///< inverse covariance of [rho; omega]
};

/// Result of PoseOptimizer::optimize. The pose is finite whenever the initial one was.
struct PoseResult {
  RigidTransform T_cam_world;
  SolveStatus status = SolveStatus::kTooFewPoints;
  std::optional<Matrix6d> covariance;  ///< of the left perturbation [rho; omega]: inverse of the
                                       ///< Gauss-Newton information (sum of phi^2 rho' J' S^-1 J
                                       ///< and prior); absent when not asked for or not usable
  double initial_cost = 0.0;           ///< before the first step, over usable observations
  double final_cost = 0.0;             ///< of the last round
  int iterations = 0;                  ///< Levenberg-Marquardt steps tried, all rounds together
  int observations = 0;                ///< usable ones
  int inliers = 0;                     ///< of these, within chi2 after the last round

  explicit operator bool() const { return usable(status); }
};

/// Levenberg-Marquardt on T_cam_world over SE(3) (left perturbation, exp(xi) T), vectorized over
/// the points.
///
/// Cost: O(N) an iteration; no allocation as long as N <= capacity (a larger N grows the
/// workspace once). An instance is a workspace: one per thread; two instances share nothing.
/// Deterministic on one instruction set. Source: theory.md section 5; P-Static section 4.
class PoseOptimizer {
 public:
  /// Throws InvalidArgument for options that break a rule. Allocates for `capacity` points.
  explicit PoseOptimizer(const PoseOptimizerOptions& options = {}, std::size_t capacity = 4096);
  ~PoseOptimizer();
  PoseOptimizer(PoseOptimizer&&) noexcept;
  PoseOptimizer& operator=(PoseOptimizer&&) noexcept;

  const PoseOptimizerOptions& options() const;
  /// Throws InvalidArgument; keeps the old options then.
  void set_options(const PoseOptimizerOptions& options);

  /// Best T_cam_world from `initial`. Throws InvalidArgument when views differ in size, weights
  /// leave [0, 1], a sigma is negative, or the prior is not finite; unlucky data are a status.
  PoseResult optimize(const DepthCamera& camera, const PoseObservations<float>& observations,
                      const RigidTransform& initial, const PosePrior* prior = nullptr);
  PoseResult optimize(const DepthCamera& camera, const PoseObservations<double>& observations,
                      const RigidTransform& initial, const PosePrior* prior = nullptr);

  /// Of the last optimize(), by observation; valid until the next call. 1 inlier, 0 outlier or not
  /// usable.
  Span<const std::uint8_t> inliers() const;
  /// Optimized weight phi (kFixed: phi0); 0 where not usable. Initializes the next frame.
  Span<const float> weights() const;
  /// s = r' S^-1 r at the result; infinity where not usable.
  Span<const float> squared_residuals() const;

 private:
  struct Workspace;
  std::unique_ptr<Workspace> workspace_;
};

}  // namespace dynslam::factors
