#include "factors/pose_solver.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <new>
#include <utility>

#include <Eigen/Cholesky>

#include "dynslam/factors/lie_jacobians.hpp"
#include "dynslam/factors/static_weight.hpp"

#include "factors/damping.hpp"

namespace dynslam::factors {
namespace {

constexpr int kArrays = 18;
// Relative to a unit diagonal; below, a direction of the pose is not determined by the data.
constexpr double kDegeneratePivot = 1e-10;
// A step this small whose predicted gain drowns in rounding is taken without asking the cost.
constexpr double kPolishStep = 1e-6;
constexpr double kPolishRounding = 1e-13;
// The approach ends when a step gains less than this share of the cost.
constexpr double kNearGain = 0.03;

std::size_t padded(std::size_t n) {
  return (n + kernels::kPointPadding - 1) / kernels::kPointPadding * kernels::kPointPadding;
}

}  // namespace

void PoseArrays::reserve(std::size_t points) {
  if (block_ && points <= capacity_) return;
  const std::size_t n = padded(std::max<std::size_t>(points, 1));
  auto block = hwy::AllocateAligned<double>(n * kArrays);
  if (!block) throw std::bad_alloc();
  block_ = std::move(block);
  capacity_ = n;
  std::fill(block_.get(), block_.get() + n * kArrays, 0.0);
  double** const all[kArrays] = {&x,       &y,          &z,         &u,      &v,     &right,
                                 &info,    &info_right, &phi0,      &active, &trust, &s,
                                 &s_trial, &phi,        &phi_trial, &w,      &c,     &gw};
  for (int i = 0; i < kArrays; ++i) *all[i] = block_.get() + static_cast<std::size_t>(i) * n;
}

PoseSolver::PoseSolver(const PoseOptimizerOptions& options, PoseArrays& arrays,
                       const DepthCamera& camera, std::size_t size, const PosePrior* prior)
    : options_(options), a_(arrays), camera_(camera), size_(padded(size)), prior_(prior) {
  points_ = {size_, a_.x, a_.y, a_.z, a_.u, a_.v, a_.right, a_.info, a_.info_right};
}

kernels::View PoseSolver::view(const RigidTransform& T) const {
  kernels::View view{camera_.fx, camera_.fy, camera_.cx, camera_.cy, camera_.bf, {}, {}};
  for (int i = 0; i < 9; ++i) view.R[i] = T.R(i / 3, i % 3);
  for (int i = 0; i < 3; ++i) view.t[i] = T.t[i];
  return view;
}

void PoseSolver::start(const RigidTransform& T) {
  pose_ = T;
  kernels::residuals(view(T), points_, a_.s);
}

// Soft enough for the residuals as they are now, and never softer than `lambda`.
double PoseSolver::softened(double lambda) const {
  double sum = 0.0, total = 0.0;
  kernels::mean_residual(size_, a_.s, a_.trust, &sum, &total);
  const double mean = total > 0.0 ? sum / total : 0.0;
  const double wanted = kSoftness * kSoftness * mean * mean;
  return std::max(options_.lambda, std::min(lambda, wanted));
}

void PoseSolver::close_weights(double lambda) {
  for (std::size_t i = 0; i < size_; ++i) {
    const double s = a_.s[i] >= 0.0 ? a_.s[i] : kernels::kBehindSquared;
    a_.phi[i] = optimal_weight(a_.phi0[i], s, lambda);
  }
}

double PoseSolver::weigh(const double* s, const double* phi, const Phase& phase) {
  const double curvature = phase.near ? 1.0 : 0.0;
  gradient_weights_ = a_.w;
  if (options_.weights == WeightMode::kJoint && phase.near) {
    gradient_weights_ = a_.gw;
    return kernels::weigh_joint(phase.lambda, 2.0, size_, s, a_.active, a_.phi0, phi, a_.w, a_.c,
                                a_.gw);
  }
  using Kernel = kernels::Loss;
  if (options_.weights != WeightMode::kFixed) {
    return kernels::weigh(Kernel::kGemanMcClure, phase.lambda, curvature, size_, s, a_.trust, a_.w,
                          a_.c);
  }
  const RobustLoss& loss = options_.loss;
  const double c2 = loss.scale * loss.scale;
  switch (plain_ ? LossKind::kNone : loss.kind) {
    case LossKind::kNone:
      return kernels::weigh(Kernel::kLeastSquares, c2, curvature, size_, s, a_.trust, a_.w, a_.c);
    case LossKind::kHuber:
      return kernels::weigh(Kernel::kHuber, c2, curvature, size_, s, a_.trust, a_.w, a_.c);
    case LossKind::kGemanMcClure:
      return kernels::weigh(Kernel::kGemanMcClure, c2, curvature, size_, s, a_.trust, a_.w, a_.c);
    case LossKind::kCauchy:
    case LossKind::kBarron:
      break;
  }
  return weigh_plainly(s, curvature);
}

// Losses without a vector form.
double PoseSolver::weigh_plainly(const double* s, double curvature) {
  double cost = 0.0;
  for (std::size_t i = 0; i < size_; ++i) {
    const bool front = s[i] >= 0.0;
    a_.w[i] = a_.c[i] = 0.0;
    if (a_.trust[i] == 0.0) continue;
    const LossValue value = options_.loss(front ? s[i] : kernels::kBehindSquared);
    cost += a_.trust[i] * value.rho;
    if (!front) continue;
    a_.w[i] = a_.trust[i] * value.rho1;
    a_.c[i] = 2.0 * curvature * a_.trust[i] * value.rho2;
  }
  return 0.5 * cost;
}

double PoseSolver::prior_cost(const RigidTransform& T) const {
  if (!prior_) return 0.0;
  const Vector6d d = se3_log(T * prior_->mean.inverse());
  return 0.5 * d.dot(prior_->information * d);
}

PoseSolver::Normal PoseSolver::linearize() {
  kernels::Normal raw;
  kernels::normal_equations(view(pose_), points_, a_.w, a_.c, gradient_weights_, &raw);
  Normal normal;
  int k = 0;
  for (int i = 0; i < 6; ++i) {
    normal.g[i] = raw.g[i];
    for (int j = i; j < 6; ++j) normal.H(i, j) = normal.H(j, i) = raw.H[k++];
  }
  if (prior_) {
    const Vector6d d = se3_log(pose_ * prior_->mean.inverse());
    const Matrix6d J = left_jacobian_inverse<6>(se3_bracket(d));
    normal.H += J.transpose() * prior_->information * J;
    normal.g -= J.transpose() * (prior_->information * d);
  }
  return normal;
}

bool PoseSolver::solve(const Normal& normal, double damping, Vector6d* step) const {
  Matrix6d A = normal.H;
  const double floor = 1e-12 * A.diagonal().cwiseAbs().maxCoeff();
  for (int i = 0; i < 6; ++i) A(i, i) += damping * std::max(std::abs(A(i, i)), floor);
  const Eigen::LLT<Matrix6d> llt(A);
  if (llt.info() != Eigen::Success) return false;
  *step = llt.solve(normal.g);
  return step->allFinite();
}

// A step from the current linearization. Where the full Hessian is not convex, it was too early to
// leave the approach, whose Hessian always is.
bool PoseSolver::find_step(Phase* phase, double* cost, Vector6d* step) {
  if (solve(linearize(), phase->damping, step)) return true;
  phase->near = false;
  *cost = weigh(a_.s, a_.phi, *phase) + prior_cost(pose_);
  const Normal normal = linearize();
  while (!solve(normal, phase->damping, step)) {
    if (phase->damping > kMaxDamping) return false;
    phase->damping = std::max(10.0 * phase->damping, 1e-6);
  }
  return true;
}

// Two phases. Approach: weights in closed form under a prior that stiffens from step to step to
// its target, Gauss-Newton curvature; the same for Joint and Eliminated, so that both come to the
// same basin. Near the optimum: each mode's own Newton steps.
SolveStatus PoseSolver::run(bool graduate, bool plain) {
  const bool soft = graduate && options_.weights != WeightMode::kFixed;
  plain_ = plain;
  opened_ = false;
  Phase phase;
  phase.damping = options_.initial_damping;
  phase.lambda = soft ? softened(std::numeric_limits<double>::max()) : options_.lambda;
  double cost = weigh(a_.s, a_.phi, phase) + prior_cost(pose_);
  for (int i = 0; i < options_.max_iterations; ++i) {
    ++iterations_;
    Vector6d step;
    if (!find_step(&phase, &cost, &step)) return SolveStatus::kConverged;  // nothing pulls at all
    const RigidTransform trial = se3_exp(step) * pose_;
    kernels::residuals(view(trial), points_, a_.s_trial);
    if (phase.near && options_.weights == WeightMode::kJoint) {
      kernels::step_joint(view(pose_), points_, phase.lambda, 2.0, step.data(), a_.s, a_.phi0,
                          a_.phi, a_.phi_trial);
    }
    const double trial_cost = weigh(a_.s_trial, a_.phi_trial, phase) + prior_cost(trial);
    const double size = step.norm();
    const double slack = size < kPolishStep ? kPolishRounding * cost : 0.0;
    const bool leaps = phase.near && cost - trial_cost > kNearGain * cost;
    if (leaps || !(trial_cost <= cost + slack)) {
      if (size < options_.step_tolerance || phase.damping > kMaxDamping)
        return SolveStatus::kConverged;
      // A refused Newton step, or one that leaps, was taken too early; a refused step of the
      // approach was too long.
      if (!phase.near) phase.damping = std::max(16.0 * phase.damping, 1e-3);
      phase.near = false;
      cost = weigh(a_.s, a_.phi, phase) + prior_cost(pose_);  // the trial overwrote the weights
      continue;
    }
    const double gain = cost - trial_cost;
    pose_ = trial;
    cost = trial_cost;
    std::swap(a_.s, a_.s_trial);
    std::swap(a_.phi, a_.phi_trial);
    phase.damping = std::max(0.1 * phase.damping, kMinDamping);
    const bool on_target = phase.lambda <= options_.lambda;
    if (on_target && (size < options_.step_tolerance || gain < options_.cost_tolerance * cost))
      return SolveStatus::kConverged;
    if (!phase.near) {
      if (!on_target) phase.lambda = softened(phase.lambda / kStiffening);
      phase.near = on_target && gain < kNearGain * cost;
      if (phase.near) close_weights(phase.lambda), opened_ = true;
      if (phase.near || !on_target) cost = weigh(a_.s, a_.phi, phase) + prior_cost(pose_);
    }
  }
  return SolveStatus::kMaxIterations;
}

PoseSolver::Phase PoseSolver::final_phase() const {
  Phase phase;
  phase.lambda = options_.lambda;
  phase.near = true;
  return phase;
}

double PoseSolver::initial_cost() {
  close_weights(options_.lambda);
  return weigh(a_.s, a_.phi, final_phase()) + prior_cost(pose_);
}

double PoseSolver::finish() {
  // A Joint run that ended in its approach has not opened its weights.
  if (!opened_) close_weights(options_.lambda);
  return weigh(a_.s, a_.phi, final_phase()) + prior_cost(pose_);
}

bool PoseSolver::information(Matrix6d* H) {
  weigh(a_.s, a_.phi, final_phase());
  std::fill(a_.c, a_.c + size_, 0.0);
  *H = linearize().H;
  const Vector6d scale = H->diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  Matrix6d L = scale.asDiagonal() * *H * scale.asDiagonal();
  // Cholesky by hand: the smallest pivot of the scaled matrix tells how well it is determined.
  for (int j = 0; j < 6; ++j) {
    double pivot = L(j, j);
    for (int k = 0; k < j; ++k) pivot -= L(j, k) * L(j, k);
    if (!(pivot > kDegeneratePivot)) return false;
    L(j, j) = std::sqrt(pivot);
    for (int i = j + 1; i < 6; ++i) {
      double sum = L(i, j);
      for (int k = 0; k < j; ++k) sum -= L(i, k) * L(j, k);
      L(i, j) = sum / L(j, j);
    }
  }
  return true;
}

}  // namespace dynslam::factors
