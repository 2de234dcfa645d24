// Local bundle adjustment, 20 keyframes (2 fixed) x 2000 points, 10 iterations: our Schur solver,
// Ceres over our analytic factors, and Ceres with automatic derivatives, written in two common
// ways, beside them.
#include <array>
#include <cmath>
#include <memory>
#include <vector>

#include <benchmark/benchmark.h>
#include <ceres/autodiff_cost_function.h>
#include <ceres/loss_function.h>
#include <ceres/ordered_groups.h>
#include <ceres/problem.h>
#include <ceres/rotation.h>
#include <ceres/solver.h>

#include "dynslam/factors/bundle_adjustment.hpp"
#include "dynslam/factors/ceres_manifolds.hpp"

#include "factors/synthetic_bundle.hpp"

namespace {

using namespace dynslam;
using namespace dynslam::factors;

#if DYNSLAM_CERES_HAS_MANIFOLD
using QuaternionBlock = ceres::QuaternionManifold;
#else
using QuaternionBlock = ceres::QuaternionParameterization;
#endif

constexpr int kIterations = 10;
constexpr double kHuber = 2.447;

template <int Rows>
struct AutodiffResidual {
  DepthCamera camera;
  Eigen::Vector3d measured;

  template <typename T>
  bool operator()(const T* pose, const T* X, T* residual) const {
    T c[3];
    ceres::AngleAxisRotatePoint(pose, X, c);
    for (int k = 0; k < 3; ++k) c[k] += pose[3 + k];
    const T u = camera.fx * c[0] / c[2] + camera.cx;
    residual[0] = measured[0] - u;
    residual[1] = measured[1] - (camera.fy * c[1] / c[2] + camera.cy);
    if constexpr (Rows == 3) residual[2] = measured[2] - (u - camera.bf / c[2]);
    return true;
  }
};

// The other common way: unit quaternion with its manifold, and translation.
template <int Rows>
struct QuaternionResidual {
  AutodiffResidual<Rows> plain;

  template <typename T>
  bool operator()(const T* q, const T* t, const T* X, T* residual) const {
    T c[3];
    ceres::QuaternionRotatePoint(q, X, c);
    const T nothing[6] = {T(0.0), T(0.0), T(0.0), t[0], t[1], t[2]};
    return plain(nothing, c, residual);
  }
};

synthetic::Bundle make_bundle(bool depth) {
  synthetic::BundleShape shape;
  shape.seen = 0.592;  // 15.7k observations
  shape.depth = depth ? 1.0 : 0.0;
  synthetic::Bundle b = synthetic::make_bundle(shape, 1);
  for (BundleObservation& o : b.observations)
    if (depth) o.right_column = std::max(o.right_column, 0.0F);
  return b;
}

double finish(ceres::Problem& problem, ceres::Solver::Options options) {
  options.linear_solver_type = ceres::SPARSE_SCHUR;
  options.max_num_iterations = kIterations;
  options.function_tolerance = options.gradient_tolerance = options.parameter_tolerance = 0.0;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return summary.final_cost;
}

// Quaternions, and the order of elimination left to Ceres, as its tutorials do.
template <int Rows>
double solve_by_quaternions(synthetic::Bundle& b) {
  std::vector<std::array<double, 7>> poses(b.poses.size());
  ceres::Problem problem;
  for (std::size_t k = 0; k < poses.size(); ++k) {
    const Eigen::Quaterniond q = b.poses[k].quaternion();
    const Eigen::Vector3d& t = b.poses[k].t;
    poses[k] = {q.w(), q.x(), q.y(), q.z(), t.x(), t.y(), t.z()};
    problem.AddParameterBlock(poses[k].data(), 4, new QuaternionBlock);
    problem.AddParameterBlock(poses[k].data() + 4, 3);
    if (!b.fixed[k]) continue;
    problem.SetParameterBlockConstant(poses[k].data());
    problem.SetParameterBlockConstant(poses[k].data() + 4);
  }
  for (const BundleObservation& o : b.observations) {
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<QuaternionResidual<Rows>, Rows, 4, 3, 3>(
            new QuaternionResidual<Rows>{{b.camera, {o.u, o.v, o.right_column}}}),
        new ceres::HuberLoss(kHuber), poses[o.keyframe].data(), poses[o.keyframe].data() + 4,
        b.points[o.point].data());
  }
  return finish(problem, {});
}

template <int Rows>
double solve_by_autodiff(synthetic::Bundle& b) {
  std::vector<std::array<double, 6>> poses(b.poses.size());
  for (std::size_t k = 0; k < poses.size(); ++k) {
    ceres::RotationMatrixToAngleAxis(b.poses[k].R.data(), poses[k].data());
    for (std::size_t i = 0; i < 3; ++i)
      poses[k][3 + i] = b.poses[k].t[static_cast<Eigen::Index>(i)];
  }
  ceres::Problem problem;
  ceres::Solver::Options options;
  options.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (const BundleObservation& o : b.observations) {
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<AutodiffResidual<Rows>, Rows, 6, 3>(
                                 new AutodiffResidual<Rows>{b.camera, {o.u, o.v, o.right_column}}),
                             new ceres::HuberLoss(kHuber), poses[o.keyframe].data(),
                             b.points[o.point].data());
    options.linear_solver_ordering->AddElementToGroup(b.points[o.point].data(), 0);
    options.linear_solver_ordering->AddElementToGroup(poses[o.keyframe].data(), 1);
  }
  for (std::size_t k = 0; k < poses.size(); ++k)
    if (b.fixed[k]) problem.SetParameterBlockConstant(poses[k].data());
  return finish(problem, options);
}

BundleOptions make_options(BundleSolver solver, WeightMode mode) {
  BundleOptions options;
  options.solver = solver;
  options.weights = mode;
  options.loss = {LossKind::kHuber, kHuber, 1.0};
  options.max_iterations = kIterations;
  options.cost_tolerance = 0.0;
  return options;
}

void BM_CeresAutodiff(benchmark::State& state, double (*solve3)(synthetic::Bundle&),
                      double (*solve2)(synthetic::Bundle&)) {
  const bool depth = state.range(0) != 0;
  const synthetic::Bundle start = make_bundle(depth);
  synthetic::Bundle own = start;
  const BundleSummary expected =
      optimize_bundle(own.view(), make_options(BundleSolver::kSchur, WeightMode::kFixed));
  double cost = 0.0;
  for (auto _ : state) {
    synthetic::Bundle b = start;
    cost = depth ? solve3(b) : solve2(b);
  }
  if (std::abs(cost - expected.final_cost) > 2e-4 * expected.final_cost)
    state.SkipWithError("Ceres and dynslam disagree");
  state.counters["observations"] = static_cast<double>(start.observations.size());
}

void BM_Own(benchmark::State& state, BundleSolver solver, WeightMode mode, int dense = 40) {
  const synthetic::Bundle start = make_bundle(state.range(0) != 0);
  BundleWorkspace workspace;
  BundleSummary summary;
  for (auto _ : state) {
    synthetic::Bundle b = start;
    BundleOptions options = make_options(solver, mode);
    options.ceres_dense_keyframes = dense;
    summary = optimize_bundle(b.view(), options, &workspace);
  }
  if (!usable(summary.status)) state.SkipWithError("not usable");
  state.counters["iterations"] = summary.iterations;
  state.counters["cost"] = summary.final_cost;
}

// 1: with depth, three rows each; 0: mono, two rows.
#define DYNSLAM_CASES Arg(1)->Arg(0)->Unit(benchmark::kMillisecond)
BENCHMARK_CAPTURE(BM_CeresAutodiff, Quaternion, &solve_by_quaternions<3>, &solve_by_quaternions<2>)
    ->DYNSLAM_CASES;
BENCHMARK_CAPTURE(BM_CeresAutodiff, AngleAxis, &solve_by_autodiff<3>, &solve_by_autodiff<2>)
    ->DYNSLAM_CASES;
BENCHMARK_CAPTURE(BM_Own, CeresAnalyticSparse, BundleSolver::kCeres, WeightMode::kFixed, 0)
    ->DYNSLAM_CASES;
BENCHMARK_CAPTURE(BM_Own, CeresAnalyticDense, BundleSolver::kCeres, WeightMode::kFixed)
    ->DYNSLAM_CASES;
BENCHMARK_CAPTURE(BM_Own, Schur, BundleSolver::kSchur, WeightMode::kFixed)->DYNSLAM_CASES;
BENCHMARK_CAPTURE(BM_Own, SchurEliminated, BundleSolver::kSchur, WeightMode::kEliminated)
    ->DYNSLAM_CASES;
BENCHMARK_CAPTURE(BM_Own, SchurJoint, BundleSolver::kSchur, WeightMode::kJoint)->DYNSLAM_CASES;

}  // namespace
