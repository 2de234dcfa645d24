#include "factors/schur_solver.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/LU>

#include "factors/damping.hpp"
#include "factors/schur_kernels.hpp"

namespace dynslam::factors {
namespace {

constexpr double kRounding = 1e-14;
// As in the pose optimizer: plain reweighting far from the optimum, and when that is over.
constexpr double kFarShare = 0.0;
constexpr double kNearBundleGain = 0.1;

// Inverse of a symmetric 3 x 3 matrix that is positive definite; false if it is not.
bool invert(const Eigen::Matrix3d& V, double* out) {
  const double c00 = V(1, 1) * V(2, 2) - V(1, 2) * V(1, 2);
  const double c01 = V(0, 2) * V(1, 2) - V(0, 1) * V(2, 2);
  const double c02 = V(0, 1) * V(1, 2) - V(0, 2) * V(1, 1);
  const double det = V(0, 0) * c00 + V(0, 1) * c01 + V(0, 2) * c02;
  if (!(V(0, 0) > 0.0) || !(det > 0.0) || !(V(0, 0) * V(1, 1) > V(0, 1) * V(0, 1))) return false;
  const double s = 1.0 / det;
  out[0] = s * c00, out[1] = out[3] = s * c01, out[2] = out[6] = s * c02;
  out[4] = s * (V(0, 0) * V(2, 2) - V(0, 2) * V(0, 2));
  out[5] = out[7] = s * (V(0, 1) * V(0, 2) - V(0, 0) * V(1, 2));
  out[8] = s * (V(0, 0) * V(1, 1) - V(0, 1) * V(0, 1));
  return std::isfinite(s);
}

}  // namespace

SchurSolver::Projection SchurSolver::project(const Item& item, const RigidTransform& T,
                                             const Eigen::Vector3d& point) const {
  Projection p;
  p.X = T.R * point + T.t;
  p.front = p.X.z() > kMinDepth;
  if (!p.front) {
    p.s = kBehindCamera;
    return p;
  }
  p.inv_z = 1.0 / p.X.z();
  p.x = p.X.x() * p.inv_z;
  p.y = p.X.y() * p.inv_z;
  const double u = camera_.fx * p.x + camera_.cx;
  p.ru = item.u - u;
  p.rv = item.v - (camera_.fy * p.y + camera_.cy);
  p.rr = item.right - (u - camera_.bf * p.inv_z);
  p.s = item.info * (p.ru * p.ru + p.rv * p.rv) + item.info_right * p.rr * p.rr;
  if (!(p.s < 1e30)) {  // overflow cannot be measured
    p.front = false;
    p.s = kBehindCamera;
  }
  return p;
}

// Normal equations at the current state; returns the cost.
double SchurSolver::linearize(const WeighingRule& rule) {
  for (Matrix6d& H : H_) H.setZero();
  for (Vector6d& b : b_) b.setZero();
  for (Eigen::Matrix3d& V : V_) V.setZero();
  for (Eigen::Vector3d& b : bp_) b.setZero();
  std::fill(cross_, cross_ + entry_camera_.size() * kernels::kCross, 0.0);
  double cost = 0.0;
  for (std::size_t i = 0; i < items_.size(); ++i) {
    const Item& item = items_[i];
    const RigidTransform& T = poses_[item.keyframe];
    const Projection p = project(item, T, points_[item.point]);
    const Weighing weighing = weigh(rule, p.s, item.phi0, phi_[i]);
    cost += weighing.cost;
    if (!p.front) {
      linear_[i].cross = 0.0;
      continue;
    }
    const double fu = camera_.fx * p.inv_z, fv = camera_.fy * p.inv_z;
    const double u2 = -fu * p.x, v2 = -fv * p.y, r2 = u2 + camera_.bf * p.inv_z * p.inv_z;
    const double eu = item.info * p.ru, ev = item.info * p.rv, er = item.info_right * p.rr;
    const Eigen::Vector3d a(fu * (eu + er), fv * ev, u2 * eu + v2 * ev + r2 * er);
    const double wi = weighing.w * item.info, wr = weighing.w * item.info_right;
    Eigen::Matrix3d A = weighing.c * a * a.transpose();
    A(0, 0) += (wi + wr) * fu * fu;
    A(1, 1) += wi * fv * fv;
    A(2, 2) += wi * (u2 * u2 + v2 * v2) + wr * r2 * r2;
    const double a02 = fu * (wi * u2 + wr * r2), a12 = wi * fv * v2;
    A(0, 2) += a02, A(2, 0) += a02;
    A(1, 2) += a12, A(2, 1) += a12;
    linear_[i] = {a, p.X, weighing.cross, phi_[i] * p.s + rule.lambda * (phi_[i] - item.phi0),
                  rule.lambda + p.s};
    const std::uint32_t camera = camera_of(item), point = free_point_of(item);
    const Eigen::Matrix3d cross_x = skew(p.X);
    if (camera != kNone) {
      const Eigen::Matrix3d XA = cross_x * A;
      Matrix6d& H = H_[camera];
      H.topLeftCorner<3, 3>() += A;
      H.bottomLeftCorner<3, 3>() += XA;
      H.bottomRightCorner<3, 3>() -= XA * cross_x;
      b_[camera].head<3>() += weighing.gw * a;
      b_[camera].tail<3>() += weighing.gw * p.X.cross(a);
    }
    if (point == kNone) continue;
    const Eigen::Matrix3d M = A * T.R;
    V_[point] += T.R.transpose() * M;
    bp_[point] += weighing.gw * (T.R.transpose() * a);
    if (camera == kNone) continue;
    using Columns =
        Eigen::Map<Eigen::Matrix<double, 6, 3>, 0, Eigen::OuterStride<kernels::kColumn>>;
    Columns W(cross_ + item.entry * kernels::kCross);
    W.topRows<3>() += M;
    W.bottomRows<3>() += cross_x * M;
  }
  return cost;
}

// Step (dc_, dp_) under a damping relative to the diagonal; false when the system is not positive
// definite.
bool SchurSolver::solve(double damping) {
  const std::size_t cameras = free_cameras_.size(), points = free_points_.size();
  for (std::size_t p = 0; p < points; ++p) {
    Eigen::Matrix3d V = V_[p];
    const double floor = 1e-12 * V.diagonal().maxCoeff() + 1e-300;
    for (int i = 0; i < 3; ++i) V(i, i) += damping * std::max(V(i, i), floor);
    // A point that nothing pulls at any more (weights of 0) stays where it is.
    if (!invert(V, &inverse_[9 * p])) std::fill_n(&inverse_[9 * p], 9, 0.0);
    for (std::size_t i = 0; i < 3; ++i) gradient_[3 * p + i] = bp_[p][static_cast<Eigen::Index>(i)];
  }
  std::fill(blocks_, blocks_ + block_count_ * kernels::kSquare, 0.0);
  for (std::size_t c = 0; c < cameras; ++c) {
    double* block = blocks_ + c * kernels::kSquare;
    const double floor = 1e-12 * H_[c].diagonal().maxCoeff() + 1e-300;
    for (int j = 0; j < 6; ++j) {
      for (int i = 0; i < 6; ++i) {
        const double value = i >= j ? H_[c](i, j) : H_[c](j, i);
        block[static_cast<std::size_t>(j) * kernels::kColumn + static_cast<std::size_t>(i)] = value;
      }
      block[static_cast<std::size_t>(j) * kernels::kColumn + static_cast<std::size_t>(j)] +=
          damping * std::max(H_[c](j, j), floor);
    }
    for (std::size_t i = 0; i < kernels::kColumn; ++i)
      rhs_[c * kernels::kColumn + i] = i < 6 ? b_[c][static_cast<Eigen::Index>(i)] : 0.0;
  }
  kernels::Elimination e;
  e.points = points;
  e.entry_begin = entry_begin_.data();
  e.entry_camera = entry_camera_.data();
  e.cross = cross_;
  e.inverse = inverse_.data();
  e.gradient = gradient_.data();
  e.pair_block = pair_block_.data();
  e.scratch = scratch_;
  e.blocks = blocks_;
  e.rhs = rhs_;
  kernels::eliminate_points(e);
  if (cameras > 0 && !reduced_.solve(blocks_, rhs_, &dc_)) return false;

  for (std::size_t p = 0; p < points; ++p) {
    Eigen::Vector3d b = bp_[p];
    for (std::uint32_t k = entry_begin_[p]; k < entry_begin_[p + 1]; ++k) {
      const double* W = cross_ + k * kernels::kCross;
      const double* d = dc_.data() + 6 * std::size_t{entry_camera_[k]};
      for (int m = 0; m < 3; ++m, W += kernels::kColumn)
        b[m] -= W[0] * d[0] + W[1] * d[1] + W[2] * d[2] + W[3] * d[3] + W[4] * d[4] + W[5] * d[5];
    }
    dp_[p] = Eigen::Map<const Eigen::Matrix3d>(&inverse_[9 * p]) * b;
    if (!dp_[p].allFinite()) return false;
  }
  return true;
}

// Applies the step to the trial state; returns its cost.
double SchurSolver::try_step(const WeighingRule& rule) {
  poses_trial_ = poses_;
  points_trial_ = points_;
  for (std::size_t c = 0; c < free_cameras_.size(); ++c) {
    const Vector6d xi = dc_.segment<6>(static_cast<Eigen::Index>(6 * c));
    poses_trial_[free_cameras_[c]] = se3_exp(xi) * poses_[free_cameras_[c]];
  }
  for (std::size_t p = 0; p < free_points_.size(); ++p) points_trial_[free_points_[p]] += dp_[p];
  const bool joint = rule.mode == WeightMode::kJoint;
  double cost = 0.0;
  for (std::size_t i = 0; i < items_.size(); ++i) {
    const Item& item = items_[i];
    const Projection p = project(item, poses_trial_[item.keyframe], points_trial_[item.point]);
    if (joint) {
      const Linear& l = linear_[i];
      Eigen::Vector3d move = Eigen::Vector3d::Zero();  // of the point in the camera
      const std::uint32_t camera = camera_of(item), point = free_point_of(item);
      if (camera != kNone) {
        const auto xi = dc_.segment<6>(6 * static_cast<Eigen::Index>(camera));
        move += xi.head<3>() + Eigen::Vector3d(xi.tail<3>()).cross(l.X);
      }
      if (point != kNone) move += poses_[item.keyframe].R * dp_[point];
      const double step = (l.cross * phi_[i] * l.a.dot(move) - l.slope) / l.A;
      phi_trial_[i] = p.front && l.cross > 0.0 ? std::min(1.0, std::max(0.0, phi_[i] + step))
                                               : optimal_weight(item.phi0, p.s, rule.lambda);
    }
    cost += weigh(rule, p.s, item.phi0, phi_trial_[i]).cost;
  }
  return cost;
}

void SchurSolver::accept() {
  poses_.swap(poses_trial_);
  points_.swap(points_trial_);
  phi_.swap(phi_trial_);
}

void SchurSolver::close_weights(double lambda) {
  phi_.resize(items_.size());
  phi_trial_.resize(items_.size());
  for (std::size_t i = 0; i < items_.size(); ++i) {
    const Item& item = items_[i];
    const double s = project(item, poses_[item.keyframe], points_[item.point]).s;
    phi_[i] = optimal_weight(item.phi0, s, lambda);
  }
}

int SchurSolver::front_count() const {
  int count = 0;
  for (const Item& item : items_)
    count += project(item, poses_[item.keyframe], points_[item.point]).front;
  return count;
}

double SchurSolver::cost(const WeighingRule& rule) const {
  double sum = 0.0;
  for (std::size_t i = 0; i < items_.size(); ++i) {
    const Item& item = items_[i];
    const double s = project(item, poses_[item.keyframe], points_[item.point]).s;
    sum += weigh(rule, s, item.phi0, phi_[i]).cost;
  }
  return sum;
}

// Stiffness of the weight prior: soft enough for the residuals as they are, within [target, most].
double SchurSolver::softened(double target, double most) const {
  double sum = 0.0, total = 0.0;
  for (const Item& item : items_) {
    const Projection p = project(item, poses_[item.keyframe], points_[item.point]);
    if (!p.front) continue;
    sum += item.phi0 * std::sqrt(p.s);
    total += item.phi0;
  }
  const double wanted = total > 0.0 ? kSoftness * kSoftness * sum * sum / (total * total) : 0.0;
  return std::max(target, std::min(most, wanted));
}

// A step; raises the damping when the system cannot be solved otherwise.
bool SchurSolver::find_step(double* damping) {
  while (!solve(*damping)) {
    if (*damping >= kMaxDamping) return false;
    *damping = std::max(100.0 * *damping, 1e-6);
  }
  return true;
}

SolveStatus SchurSolver::iterate(const BundleOptions& options, WeighingRule* rule,
                                 BundleSummary* summary) {
  const bool weighted = options.weights != WeightMode::kFixed;
  double damping = options.initial_damping;
  double cost = linearize(*rule);
  for (int i = 0; i < options.max_iterations; ++i) {
    if (options.abort && options.abort->load(std::memory_order_relaxed))
      return SolveStatus::kAborted;
    ++summary->iterations;
    if (!find_step(&damping)) return SolveStatus::kDegenerate;
    const double trial = try_step(*rule);
    if (!(trial <= cost * (1.0 + kRounding))) {
      if (damping >= kMaxDamping) return SolveStatus::kConverged;
      damping = std::max(16.0 * damping, 1e-4);
      if (rule->share < 1.0) continue;
      rule->share = kFarShare;
      linearize(*rule);
      continue;
    }
    const double gain = cost - trial;
    accept();
    cost = trial;
    damping = std::max(0.1 * damping, kMinDamping);
    if (weighted && rule->lambda > options.lambda) {
      rule->lambda = softened(options.lambda, rule->lambda / kStiffening);
      close_weights(rule->lambda);
      cost = linearize(*rule);
      continue;
    }
    if (gain <= options.cost_tolerance * cost) return SolveStatus::kConverged;
    rule->share = gain < kNearBundleGain * cost ? 1.0 : kFarShare;
    if (i + 1 < options.max_iterations) linearize(*rule);
  }
  return SolveStatus::kMaxIterations;
}

BundleSummary SchurSolver::run(const BundleProblem& problem, const BundleOptions& options) {
  BundleSummary summary;
  collect(problem);
  close_weights(options.lambda);
  summary.observations = front_count();
  if (summary.observations == 0 || (free_cameras_.empty() && free_points_.empty())) {
    write_back(problem, options, &summary);
    return summary;
  }
  index_blocks();
  close_weights(options.lambda);  // again: the items have been sorted
  summary.linear_solver =
      reduced_.dense() ? "own Schur, dense Cholesky" : "own Schur, sparse Cholesky (Eigen)";
  WeighingRule rule{options.weights, options.loss, options.lambda, kFarShare};
  summary.initial_cost = cost(rule);
  if (options.weights != WeightMode::kFixed) {
    rule.lambda = softened(options.lambda, std::numeric_limits<double>::max());
    close_weights(rule.lambda);
  }
  summary.status = iterate(options, &rule, &summary);
  if (rule.lambda > options.lambda) {
    rule.lambda = options.lambda;
    close_weights(rule.lambda);
  }
  summary.final_cost = cost(rule);
  write_back(problem, options, &summary);
  return summary;
}

void SchurSolver::write_back(const BundleProblem& problem, const BundleOptions& options,
                             BundleSummary* summary) {
  if (summary->iterations > 0) {
    for (const std::uint32_t k : free_cameras_) problem.T_cam_world[k] = poses_[k].normalized();
    for (const std::uint32_t p : free_points_) problem.points_world[p] = points_[p];
  }
  std::fill(problem.inliers.begin(), problem.inliers.end(), std::uint8_t{0});
  std::fill(problem.weights.begin(), problem.weights.end(), 0.0F);
  std::fill(problem.squared_residuals.begin(), problem.squared_residuals.end(),
            std::numeric_limits<float>::infinity());
  for (std::size_t i = 0; i < items_.size(); ++i) {
    const Item& item = items_[i];
    const Projection p = project(item, poses_[item.keyframe], points_[item.point]);
    if (!p.front) continue;
    const double bound = item.info_right > 0.0 ? options.chi2_depth : options.chi2_mono;
    const bool inlier = p.s <= bound;
    summary->inliers += inlier;
    double phi = item.phi0;
    if (options.weights == WeightMode::kJoint) phi = phi_[i];
    if (options.weights == WeightMode::kEliminated) phi = optimal_weight(phi, p.s, options.lambda);
    if (!problem.inliers.empty()) problem.inliers[item.original] = inlier ? 1 : 0;
    if (!problem.weights.empty()) problem.weights[item.original] = static_cast<float>(phi);
    if (!problem.squared_residuals.empty())
      problem.squared_residuals[item.original] = static_cast<float>(p.s);
  }
}

}  // namespace dynslam::factors
