// Pose of one frame from 500 RGB-D observations: our three modes, and Ceres with automatic
// derivatives and a Huber loss beside them.
#include <algorithm>

#include <benchmark/benchmark.h>
#include <ceres/autodiff_cost_function.h>
#include <ceres/loss_function.h>
#include <ceres/problem.h>
#include <ceres/rotation.h>
#include <ceres/solver.h>

#include "dynslam/factors/pose_optimizer.hpp"

#include "factors/synthetic.hpp"

namespace {

using namespace dynslam;
using namespace dynslam::factors;

// What one writes at first: angle axis and translation in one block, derivatives left to Ceres.
struct AutodiffPoseResidual {
  DepthCamera camera;
  Eigen::Vector3d point, measured;
  double inverse_sigma;

  template <typename T>
  bool operator()(const T* pose, T* residual) const {
    const T X[3] = {T(point.x()), T(point.y()), T(point.z())};
    T c[3];
    ceres::AngleAxisRotatePoint(pose, X, c);
    for (int k = 0; k < 3; ++k) c[k] += pose[3 + k];
    const T u = camera.fx * c[0] / c[2] + camera.cx;
    residual[0] = inverse_sigma * (measured[0] - u);
    residual[1] = inverse_sigma * (measured[1] - (camera.fy * c[1] / c[2] + camera.cy));
    residual[2] = inverse_sigma * (measured[2] - (u - camera.bf / c[2]));
    return true;
  }
};

synthetic::Frame make_frame(int points, double outliers) {
  synthetic::FrameOptions options;
  options.points = points;
  options.outliers = outliers;
  synthetic::Frame frame = synthetic::make_frame(options, 1);
  for (float& right : frame.right) right = std::max(right, 0.0F);  // all with depth, for both
  return frame;
}

RigidTransform solve_by_ceres(const synthetic::Frame& f) {
  double pose[6];
  ceres::RotationMatrixToAngleAxis(f.start.R.data(), pose);
  for (int k = 0; k < 3; ++k) pose[3 + k] = f.start.t[k];
  ceres::Problem problem;
  for (std::size_t i = 0; i < f.points.size(); ++i) {
    const Eigen::Vector3d m(f.pixels[i].x(), f.pixels[i].y(), f.right[i]);
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<AutodiffPoseResidual, 3, 6>(
            new AutodiffPoseResidual{f.camera, f.points[i], m, f.inverse_sigma[i]}),
        new ceres::HuberLoss(2.447), pose);
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.max_num_iterations = 10;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  Eigen::Matrix3d R;
  ceres::AngleAxisToRotationMatrix(pose, R.data());
  return {R, Eigen::Vector3d(pose[3], pose[4], pose[5])};
}

void BM_CeresAutodiffHuber(benchmark::State& state) {
  const synthetic::Frame f = make_frame(static_cast<int>(state.range(0)), 0.01 * state.range(1));
  PoseOptimizerOptions options;
  options.weights = WeightMode::kFixed;
  PoseOptimizer own(options);
  const PoseResult expected = own.optimize(f.camera, f.view(), f.start);
  if (se3_log(solve_by_ceres(f) * expected.T_cam_world.inverse()).norm() > 1e-3)
    state.SkipWithError("Ceres and dynslam disagree");
  for (auto _ : state) benchmark::DoNotOptimize(solve_by_ceres(f));
}

void BM_Own(benchmark::State& state, WeightMode mode, int rounds) {
  const synthetic::Frame f = make_frame(static_cast<int>(state.range(0)), 0.01 * state.range(1));
  PoseOptimizerOptions options;
  options.weights = mode;
  options.rounds = rounds;
  PoseOptimizer optimizer(options);
  const PoseResult result = optimizer.optimize(f.camera, f.view(), f.start);
  if (!result || synthetic::pose_error(result.T_cam_world, f.truth) > 0.02)
    state.SkipWithError("wrong pose");
  const PoseObservations<float> view = f.view();
  for (auto _ : state) benchmark::DoNotOptimize(optimizer.optimize(f.camera, view, f.start));
  state.counters["iterations"] = result.iterations;
}

#define DYNSLAM_SIZES Args({500, 0})->Args({500, 10})->Unit(benchmark::kMicrosecond)
BENCHMARK(BM_CeresAutodiffHuber)->DYNSLAM_SIZES;
BENCHMARK_CAPTURE(BM_Own, Fixed, WeightMode::kFixed, 1)->DYNSLAM_SIZES->Args({1000, 10});
BENCHMARK_CAPTURE(BM_Own, Joint, WeightMode::kJoint, 1)->DYNSLAM_SIZES->Args({1000, 10});
BENCHMARK_CAPTURE(BM_Own, Eliminated, WeightMode::kEliminated, 1)->DYNSLAM_SIZES->Args({1000, 10});
BENCHMARK_CAPTURE(BM_Own, FixedFourRounds, WeightMode::kFixed, 4)->DYNSLAM_SIZES;

}  // namespace
