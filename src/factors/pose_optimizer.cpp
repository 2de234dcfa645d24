#include "dynslam/factors/pose_optimizer.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "dynslam/core/errors.hpp"
#include "dynslam/factors/static_weight.hpp"

#include "factors/observations.hpp"
#include "factors/pose_solver.hpp"

namespace dynslam::factors {
namespace {

constexpr const char* kWhere = "PoseOptimizer::optimize";
constexpr double kLargestInformation = 1e12;

void check_size(std::size_t got, std::size_t expected, const char* name) {
  require(got == 0 || got == expected, kWhere, name, got, "as many as points_world, or none");
}

void check_range(Span<const float> values, float largest, const char* name, const char* expected) {
  for (const float value : values)
    require(!(value < 0.0F) && !(value > largest), kWhere, name, value, expected);
}

void check_prior(const PosePrior& prior) {
  require(prior.mean.all_finite(), kWhere, "prior.mean", "NaN or infinity", "a finite transform");
  require(prior.information.allFinite(), kWhere, "prior.information", "NaN or infinity",
          "a finite matrix");
  const Matrix6d& I = prior.information;
  const double largest = std::max(1e-300, I.cwiseAbs().maxCoeff());
  require((I - I.transpose()).cwiseAbs().maxCoeff() <= 1e-9 * largest, kWhere, "prior.information",
          "a matrix that is not symmetric", "a symmetric matrix");
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(I, Eigen::EigenvaluesOnly);
  require(eigen.eigenvalues()[0] >= -1e-9 * largest, kWhere, "prior.information",
          eigen.eigenvalues()[0], "no negative eigenvalue");
}

template <typename PixelScalar>
void check(const DepthCamera& camera, const PoseObservations<PixelScalar>& obs,
           const RigidTransform& initial, const PosePrior* prior) {
  camera.validate();
  const auto n = static_cast<std::size_t>(obs.points_world.cols());
  require(static_cast<std::size_t>(obs.pixels.cols()) == n, kWhere, "pixels", obs.pixels.cols(),
          "as many columns as points_world");
  check_size(obs.right_columns.size(), n, "right_columns");
  check_size(obs.inverse_sigma.size(), n, "inverse_sigma");
  check_size(obs.weights.size(), n, "weights");
  check_size(obs.right_inverse_sigma.size(), n, "right_inverse_sigma");
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  check_range(obs.weights, 1.0F, "weights", "static weights in [0, 1]");
  check_range(obs.inverse_sigma, kInfinity, "inverse_sigma", "1/sigma >= 0");
  check_range(obs.right_inverse_sigma, kInfinity, "right_inverse_sigma", "1/sigma >= 0");
  if (initial.all_finite()) {
    const double off = (initial.R.transpose() * initial.R - Eigen::Matrix3d::Identity()).norm();
    require(off < 1e-3 && initial.R.determinant() > 0.0, kWhere, "initial.R",
            "a matrix that is not a rotation", "a rotation");
  }
  if (prior) check_prior(*prior);
}

}  // namespace

void PoseOptimizerOptions::validate() const {
  const char* where = "PoseOptimizerOptions";
  require(std::isfinite(lambda) && lambda > 0.0, where, "lambda", lambda, "a positive number");
  loss.validate();
  require(rounds >= 1, where, "rounds", rounds, "at least 1");
  require(max_iterations >= 1, where, "max_iterations", max_iterations, "at least 1");
  require(chi2_mono > 0.0, where, "chi2_mono", chi2_mono, "a positive number");
  require(chi2_depth > 0.0, where, "chi2_depth", chi2_depth, "a positive number");
  require(min_observations >= 3, where, "min_observations", min_observations, "at least 3");
  require(step_tolerance >= 0.0, where, "step_tolerance", step_tolerance, "a number >= 0");
  require(cost_tolerance >= 0.0, where, "cost_tolerance", cost_tolerance, "a number >= 0");
  require(std::isfinite(initial_damping) && initial_damping > 0.0, where, "initial_damping",
          initial_damping, "a positive number");
}

struct PoseOptimizer::Workspace {
  PoseOptimizerOptions options;
  PoseArrays arrays;
  std::vector<std::uint8_t> inliers;
  std::vector<float> weights;
  std::vector<float> squared_residuals;
  std::size_t size = 0;

  void reserve(std::size_t n) {
    arrays.reserve(n);
    inliers.reserve(n);
    weights.reserve(n);
    squared_residuals.reserve(n);
  }

  template <typename PixelScalar>
  PoseResult optimize(const DepthCamera& camera, const PoseObservations<PixelScalar>& obs,
                      const RigidTransform& initial, const PosePrior* prior);
  template <typename PixelScalar>
  void gather(const PoseObservations<PixelScalar>& obs);
  int select(bool test);
  void report(PoseResult* result);
  bool within(std::size_t i) const {
    const double bound = arrays.info_right[i] > 0.0 ? options.chi2_depth : options.chi2_mono;
    return arrays.s[i] >= 0.0 && arrays.s[i] <= bound;
  }
};

// Copies the views into arrays; what is not usable becomes a point of weight 0 at the origin.
template <typename PixelScalar>
void PoseOptimizer::Workspace::gather(const PoseObservations<PixelScalar>& obs) {
  size = static_cast<std::size_t>(obs.points_world.cols());
  reserve(size);
  inliers.assign(size, 0);
  weights.assign(size, 0.0F);
  squared_residuals.assign(size, std::numeric_limits<float>::infinity());
  PoseArrays& a = arrays;
  for (std::size_t i = 0; i < size; ++i) {
    const auto col = static_cast<Eigen::Index>(i);
    const double* X = obs.points_world.col(col).data();
    const PixelScalar* p = obs.pixels.col(col).data();
    const double sigma = obs.inverse_sigma.empty() ? 1.0 : obs.inverse_sigma[i];
    const double weight = obs.weights.empty() ? 1.0 : obs.weights[i];
    const double info = sigma * sigma;
    const bool usable = in_reach(X[0]) && in_reach(X[1]) && in_reach(X[2]) && in_reach(p[0]) &&
                        in_reach(p[1]) && info > 0.0 && info < kLargestInformation && weight > 0.0;
    double right = 0.0, info_right = 0.0;
    if (usable && !obs.right_columns.empty() && obs.right_columns[i] >= 0.0F &&
        in_reach(obs.right_columns[i])) {
      const double own = obs.right_inverse_sigma.empty() ? sigma : obs.right_inverse_sigma[i];
      if (own > 0.0 && own * own < kLargestInformation) {
        right = obs.right_columns[i];
        info_right = own * own;
      }
    }
    a.x[i] = usable ? X[0] : 0.0;
    a.y[i] = usable ? X[1] : 0.0;
    a.z[i] = usable ? X[2] : 0.0;
    a.u[i] = usable ? p[0] : 0.0;
    a.v[i] = usable ? p[1] : 0.0;
    a.right[i] = right;
    a.info[i] = usable ? info : 0.0;
    a.info_right[i] = info_right;
    a.phi0[i] = usable ? weight : 0.0;
  }
  const std::size_t end =
      (size + kernels::kPointPadding - 1) / kernels::kPointPadding * kernels::kPointPadding;
  for (double* array : {a.x, a.y, a.z, a.u, a.v, a.right, a.info, a.info_right, a.phi0, a.phi,
                        a.phi_trial, a.active, a.trust})
    std::fill(array + size, array + end, 0.0);
}

// Who takes part in the next round: every usable observation, or those within chi2. Returns how
// many of them are in front of the camera.
int PoseOptimizer::Workspace::select(bool test) {
  int count = 0;
  PoseArrays& a = arrays;
  for (std::size_t i = 0; i < size; ++i) {
    const bool on = a.phi0[i] > 0.0 && (!test || within(i));
    a.active[i] = on ? 1.0 : 0.0;
    a.trust[i] = on ? a.phi0[i] * a.phi0[i] : 0.0;
    count += on && a.s[i] >= 0.0;
  }
  return count;
}

void PoseOptimizer::Workspace::report(PoseResult* result) {
  for (std::size_t i = 0; i < size; ++i) {
    if (!(arrays.phi0[i] > 0.0) || arrays.s[i] < 0.0) continue;
    const double s = arrays.s[i];
    squared_residuals[i] = static_cast<float>(s);
    inliers[i] = within(i) ? 1 : 0;
    result->inliers += inliers[i];
    const bool tested = arrays.active[i] > 0.0;
    double phi = arrays.phi0[i];
    if (options.weights == WeightMode::kJoint && tested)
      phi = arrays.phi[i];
    else if (options.weights != WeightMode::kFixed)
      phi = optimal_weight(phi, s, options.lambda);
    weights[i] = static_cast<float>(phi);
  }
}

template <typename PixelScalar>
PoseResult PoseOptimizer::Workspace::optimize(const DepthCamera& camera,
                                              const PoseObservations<PixelScalar>& obs,
                                              const RigidTransform& initial,
                                              const PosePrior* prior) {
  check(camera, obs, initial, prior);
  PoseResult result;
  result.T_cam_world = initial;
  gather(obs);
  if (!initial.all_finite()) {
    result.status = SolveStatus::kNonFinite;
    return result;
  }
  PoseSolver solver(options, arrays, camera, size, prior);
  solver.start(initial.normalized());
  result.observations = select(false);
  if (result.observations < options.min_observations) {
    report(&result);
    return result;
  }
  for (int round = 0; round < options.rounds; ++round) {
    if (round > 0 && select(true) < options.min_observations) {
      solver.start(initial.normalized());
      report(&result);
      result.status = SolveStatus::kTooFewPoints;
      result.iterations = solver.iterations();
      return result;
    }
    const bool plain = round > 0 && round + 1 == options.rounds && !options.loss_in_last_round;
    if (round == 0) result.initial_cost = solver.initial_cost();
    result.status = solver.run(round == 0, plain);
  }
  result.T_cam_world = solver.pose().normalized();
  result.final_cost = solver.finish();
  result.iterations = solver.iterations();
  Matrix6d H;
  if (!solver.information(&H)) {
    result.status = SolveStatus::kDegenerate;
  } else if (options.compute_covariance) {
    result.covariance = Eigen::LLT<Matrix6d>(H).solve(Matrix6d::Identity());
  }
  report(&result);
  return result;
}

PoseOptimizer::PoseOptimizer(const PoseOptimizerOptions& options, std::size_t capacity)
    : workspace_(std::make_unique<Workspace>()) {
  set_options(options);
  workspace_->reserve(capacity);
}

PoseOptimizer::~PoseOptimizer() = default;
PoseOptimizer::PoseOptimizer(PoseOptimizer&&) noexcept = default;
PoseOptimizer& PoseOptimizer::operator=(PoseOptimizer&&) noexcept = default;

const PoseOptimizerOptions& PoseOptimizer::options() const { return workspace_->options; }

void PoseOptimizer::set_options(const PoseOptimizerOptions& options) {
  options.validate();
  workspace_->options = options;
}

PoseResult PoseOptimizer::optimize(const DepthCamera& camera,
                                   const PoseObservations<float>& observations,
                                   const RigidTransform& initial, const PosePrior* prior) {
  return workspace_->optimize(camera, observations, initial, prior);
}

PoseResult PoseOptimizer::optimize(const DepthCamera& camera,
                                   const PoseObservations<double>& observations,
                                   const RigidTransform& initial, const PosePrior* prior) {
  return workspace_->optimize(camera, observations, initial, prior);
}

Span<const std::uint8_t> PoseOptimizer::inliers() const { return workspace_->inliers; }
Span<const float> PoseOptimizer::weights() const { return workspace_->weights; }
Span<const float> PoseOptimizer::squared_residuals() const { return workspace_->squared_residuals; }

}  // namespace dynslam::factors
