// Bundle adjustment by Ceres over the factors of factors/ceres.hpp.
#include <algorithm>
#include <cmath>
#include <deque>
#include <limits>
#include <memory>
#include <tuple>
#include <vector>

#include <ceres/iteration_callback.h>
#include <ceres/ordered_groups.h>
#include <ceres/solver.h>

#include "dynslam/factors/bundle_adjustment.hpp"
#include "dynslam/factors/ceres.hpp"
#include "dynslam/factors/static_weight.hpp"

#include "factors/ceres_keyframe_cost.hpp"
#include "factors/ceres_routes.hpp"
#include "factors/ceres_solver.hpp"
#include "factors/observations.hpp"

namespace dynslam::factors {
namespace {

class AbortCallback final : public ceres::IterationCallback {
 public:
  explicit AbortCallback(const std::atomic<bool>* flag) : flag_(flag) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary&) override {
    return flag_ && flag_->load(std::memory_order_relaxed) ? ceres::SOLVER_TERMINATE_SUCCESSFULLY
                                                           : ceres::SOLVER_CONTINUE;
  }

 private:
  const std::atomic<bool>* flag_;
};

class Route {
 public:
  Route(const BundleProblem& problem, const BundleOptions& options)
      : in_(problem),
        options_(options),
        poses_(problem.T_cam_world.begin(), problem.T_cam_world.end()),
        keyframes_(problem.T_cam_world),
        points_(problem.points_world.begin(), problem.points_world.end()) {}

  BundleSummary run();

 private:
  bool held(Span<const std::uint8_t> flags, std::size_t i) const {
    return !flags.empty() && flags[i] != 0;
  }
  void select();
  template <int Rows>
  void add(std::size_t i, ceres::Problem* problem);
  ceres::LossFunction* loss_of(float weight);
  void build(ceres::Problem* problem, ceres::ParameterBlockOrdering* ordering);
  bool project(const BundleObservation& o, double* s) const;
  double cost() const;
  void write_back(BundleSummary* summary);

  const BundleProblem& in_;
  const BundleOptions& options_;
  std::vector<RigidTransform> poses_;
  CeresKeyframes keyframes_;
  std::vector<Eigen::Vector3d> points_;
  std::vector<std::size_t> chosen_;
  std::vector<double> phi_;  // by observation
  // Kept here and lent to Ceres, which would keep a tree of everything that it owns.
  std::tuple<std::deque<KeyframeCost<2, false>>, std::deque<KeyframeCost<3, false>>,
             std::deque<KeyframeCost<2, true>>, std::deque<KeyframeCost<3, true>>>
      costs_;
  std::deque<WeightPriorCost> priors_;
  std::deque<RobustLossFunction> losses_;
  float last_weight_ = 0.0F;
  bool anything_free_ = false;
};

// The same rule as the Schur solver's: finite and trusted; three rows for a point that is free.
void Route::select() {
  std::vector<int> rows(points_.size(), 0);
  for (const BundleObservation& o : in_.observations)
    if (usable(o, points_[o.point])) rows[o.point] += has_depth(o) ? 3 : 2;
  phi_.assign(in_.observations.size(), 0.0);
  for (std::size_t i = 0; i < in_.observations.size(); ++i) {
    const BundleObservation& o = in_.observations[i];
    const bool point_held = held(in_.point_fixed, o.point);
    if (!usable(o, points_[o.point]) || (rows[o.point] < 3 && !point_held)) continue;
    chosen_.push_back(i);
    double s = 0.0;
    if (!project(o, &s)) s = 1e6;
    phi_[i] = optimal_weight(o.weight, s, options_.lambda);
    anything_free_ = anything_free_ || !point_held || !held(in_.keyframe_fixed, o.keyframe);
  }
}

bool Route::project(const BundleObservation& o, double* s) const {
  const Eigen::Vector3d X = poses_[o.keyframe] * points_[o.point];
  if (!PinholeCamera::in_domain(X)) return false;
  const Eigen::Vector3d p = in_.camera.project3(X);
  const double ru = o.inverse_sigma * (o.u - p[0]), rv = o.inverse_sigma * (o.v - p[1]);
  const double rr = has_depth(o) ? right_inverse_sigma(o) * (o.right_column - p[2]) : 0.0;
  *s = ru * ru + rv * rv + rr * rr;
  return *s < 1e30;
}

double Route::cost() const {
  double sum = 0.0;
  for (const std::size_t i : chosen_) {
    const BundleObservation& o = in_.observations[i];
    double s = 0.0;
    if (!project(o, &s)) s = 1e6;
    if (options_.weights == WeightMode::kFixed) {
      sum += 0.5 * o.weight * o.weight * options_.loss(s).rho;
    } else if (options_.weights == WeightMode::kJoint) {
      sum += weighted_cost(phi_[i], o.weight, s, options_.lambda);
    } else {
      sum += eliminated_cost(o.weight, s, options_.lambda);
    }
  }
  return sum;
}

template <int Rows>
void Route::add(std::size_t i, ceres::Problem* problem) {
  const BundleObservation& o = in_.observations[i];
  Eigen::Matrix<double, Rows, 1> measured;
  measured[0] = o.u;
  measured[1] = o.v;
  if constexpr (Rows == 3) measured[2] = o.right_column;
  CeresKeyframes::State& keyframe = keyframes_.states[o.keyframe];
  double* pose = keyframe.xi.data();
  double* point = parameter_block(points_[o.point]);
  if (options_.weights == WeightMode::kJoint) {
    auto& costs = std::get<std::deque<KeyframeCost<Rows, true>>>(costs_);
    costs.emplace_back(in_.camera, keyframe, measured, o.inverse_sigma, right_inverse_sigma(o));
    problem->AddResidualBlock(&costs.back(), nullptr, pose, point, &phi_[i]);
    priors_.emplace_back(o.weight, options_.lambda);
    problem->AddResidualBlock(&priors_.back(), nullptr, &phi_[i]);
    add_weight_block(*problem, phi_[i]);
    return;
  }
  auto& costs = std::get<std::deque<KeyframeCost<Rows, false>>>(costs_);
  costs.emplace_back(in_.camera, keyframe, measured, o.inverse_sigma, right_inverse_sigma(o));
  problem->AddResidualBlock(&costs.back(), loss_of(o.weight), pose, point);
}

// One loss for a run of equal weights; null where the loss is the square itself.
ceres::LossFunction* Route::loss_of(float weight) {
  const bool eliminated = options_.weights == WeightMode::kEliminated;
  if (!eliminated && options_.loss.kind == LossKind::kNone && weight == 1.0F) return nullptr;
  if (losses_.empty() || weight != last_weight_) {
    RobustLoss loss = options_.loss;
    if (eliminated) loss = {LossKind::kGemanMcClure, std::sqrt(options_.lambda), 0.0};
    losses_.emplace_back(loss, double{weight} * weight);
    last_weight_ = weight;
  }
  return &losses_.back();
}

// Points are eliminated first; each block is named once.
void Route::build(ceres::Problem* problem, ceres::ParameterBlockOrdering* ordering) {
  for (const std::size_t i : chosen_) {
    if (has_depth(in_.observations[i])) {
      add<3>(i, problem);
    } else {
      add<2>(i, problem);
    }
    if (options_.weights == WeightMode::kJoint) ordering->AddElementToGroup(&phi_[i], 1);
  }
  std::vector<std::uint8_t> point_seen(points_.size(), 0), keyframe_seen(poses_.size(), 0);
  for (const std::size_t i : chosen_) {
    point_seen[in_.observations[i].point] = 1;
    keyframe_seen[in_.observations[i].keyframe] = 1;
  }
  for (std::size_t p = 0; p < points_.size(); ++p) {
    if (!point_seen[p]) continue;
    ordering->AddElementToGroup(parameter_block(points_[p]), 0);
    if (held(in_.point_fixed, p)) problem->SetParameterBlockConstant(parameter_block(points_[p]));
  }
  for (std::size_t k = 0; k < poses_.size(); ++k) {
    if (!keyframe_seen[k]) continue;
    double* block = keyframes_.states[k].xi.data();
    ordering->AddElementToGroup(block, 1);
    if (held(in_.keyframe_fixed, k)) problem->SetParameterBlockConstant(block);
  }
}

const char* schur_name(const ceres::Solver::Summary& summary) {
  if (summary.linear_solver_type_used == ceres::DENSE_SCHUR) return "Ceres DENSE_SCHUR";
  if (summary.linear_solver_type_used != ceres::SPARSE_SCHUR) return "Ceres DENSE_QR";
  switch (summary.sparse_linear_algebra_library_type) {
    case ceres::SUITE_SPARSE:
      return "Ceres SPARSE_SCHUR (SUITE_SPARSE)";
    case ceres::EIGEN_SPARSE:
      return "Ceres SPARSE_SCHUR (EIGEN_SPARSE)";
    default:
      return "Ceres SPARSE_SCHUR (other)";
  }
}

BundleSummary Route::run() {
  BundleSummary summary;
  select();
  for (const std::size_t i : chosen_) {
    double s = 0.0;
    summary.observations += project(in_.observations[i], &s);
  }
  if (summary.observations == 0 || !anything_free_) {
    write_back(&summary);
    return summary;
  }
  summary.initial_cost = cost();
  ceres::Problem::Options problem_options;
  problem_options.evaluation_callback = &keyframes_;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.disable_all_safety_checks = true;  // the contract is checked already
  ceres::Problem problem(problem_options);
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  build(&problem, ordering.get());
  AbortCallback callback(options_.abort);
  ceres::Solver::Options solver;
  int free_keyframes = 0;
  for (std::size_t k = 0; k < poses_.size(); ++k)
    free_keyframes += held(in_.keyframe_fixed, k) ? 0 : 1;
  const bool dense =
      options_.weights != WeightMode::kJoint && free_keyframes <= options_.ceres_dense_keyframes;
  solver.linear_solver_type = dense ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
  solver.sparse_linear_algebra_library_type = best_sparse_library();
  solver.linear_solver_ordering = ordering;
  solver.jacobi_scaling = false;  // the damping is scaled by the diagonal as it is
  solver.max_num_iterations = options_.max_iterations;
  solver.function_tolerance = options_.cost_tolerance;
  solver.gradient_tolerance = 0.0;
  solver.parameter_tolerance = 0.0;
  solver.logging_type = ceres::SILENT;
  solver.num_threads = 1;
  solver.callbacks.push_back(&callback);
  ceres::Solver::Summary result;
  ceres::Solve(solver, &problem, &result);
  for (std::size_t k = 0; k < poses_.size(); ++k) {
    if (held(in_.keyframe_fixed, k)) continue;
    poses_[k] = CeresKeyframes::pose_of(keyframes_.states[k]);
  }
  summary.linear_solver = schur_name(result);
  summary.iterations = static_cast<int>(result.iterations.size()) - 1;
  summary.status = status_of(result);
  summary.final_cost = cost();
  write_back(&summary);
  return summary;
}

void Route::write_back(BundleSummary* summary) {
  std::fill(in_.inliers.begin(), in_.inliers.end(), std::uint8_t{0});
  std::fill(in_.weights.begin(), in_.weights.end(), 0.0F);
  std::fill(in_.squared_residuals.begin(), in_.squared_residuals.end(),
            std::numeric_limits<float>::infinity());
  for (const std::size_t i : chosen_) {
    const BundleObservation& o = in_.observations[i];
    double s = 0.0;
    if (!project(o, &s)) continue;
    const bool inlier = s <= (has_depth(o) ? options_.chi2_depth : options_.chi2_mono);
    summary->inliers += inlier;
    double phi = o.weight;
    if (options_.weights == WeightMode::kJoint) phi = phi_[i];
    if (options_.weights == WeightMode::kEliminated) phi = optimal_weight(phi, s, options_.lambda);
    if (!in_.inliers.empty()) in_.inliers[i] = inlier ? 1 : 0;
    if (!in_.weights.empty()) in_.weights[i] = static_cast<float>(phi);
    if (!in_.squared_residuals.empty()) in_.squared_residuals[i] = static_cast<float>(s);
  }
  if (summary->iterations == 0) return;
  for (const std::size_t i : chosen_) {
    const BundleObservation& o = in_.observations[i];
    if (!held(in_.keyframe_fixed, o.keyframe)) in_.T_cam_world[o.keyframe] = poses_[o.keyframe];
    if (!held(in_.point_fixed, o.point)) in_.points_world[o.point] = points_[o.point];
  }
}

}  // namespace

bool has_ceres() { return true; }

BundleSummary optimize_bundle_with_ceres(const BundleProblem& problem,
                                         const BundleOptions& options) {
  return Route(problem, options).run();
}

}  // namespace dynslam::factors
