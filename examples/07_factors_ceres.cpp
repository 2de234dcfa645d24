// dynslam's factors inside a Ceres problem of one's own: two keyframes, the points between them,
// and a static weight for every observation of the second.
#include <cmath>
#include <cstdio>
#include <random>
#include <vector>

#include <ceres/solver.h>

#include "dynslam/factors/ceres.hpp"

int main() {
  using namespace dynslam::factors;
  dynslam::DepthCamera camera;
  camera.fx = camera.fy = 525.0, camera.cx = 319.5, camera.cy = 239.5;
  camera.width = 640, camera.height = 480;
  dynslam::Vector6d twist;
  twist << -0.2, 0.02, 0.05, 0.01, 0.04, 0.0;
  const dynslam::RigidTransform truth = dynslam::se3_exp(twist);

  std::mt19937 rng(3);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::normal_distribution<double> noise(0.0, 1.0);
  std::vector<Eigen::Vector3d> points, first, second;
  std::vector<bool> moves;
  for (int i = 0; i < 200; ++i) {
    const double u = 40.0 + 560.0 * uniform(rng), v = 40.0 + 400.0 * uniform(rng);
    const Eigen::Vector3d X = camera.unproject({u, v}, 1.5 + 3.0 * uniform(rng));
    moves.push_back(uniform(rng) < 0.25);
    const Eigen::Vector3d later = moves.back() ? X + Eigen::Vector3d(0.2, 0.0, 0.0) : X;
    first.push_back(camera.project3(X));
    second.push_back(camera.project3(truth * later));
    for (int k = 0; k < 3; ++k) first.back()[k] += noise(rng), second.back()[k] += noise(rng);
    points.push_back(X);
  }
  dynslam::RigidTransform origin, pose;  // the second keyframe starts where the first is
  std::vector<double> weights(points.size(), 1.0);

  // [ten-line example]
  const Eigen::Matrix3d L = stereo_sqrt_information(1.0);
  const double phi0 = 1.0, lambda = 9.0;
  ceres::Problem problem;
  add_pose_block(problem, origin);
  add_pose_block(problem, pose);
  problem.SetParameterBlockConstant(parameter_block(origin));
  for (std::size_t i = 0; i < points.size(); ++i) {
    double* point = parameter_block(points[i]);
    problem.AddResidualBlock(new ReprojectionCost<3>(camera, first[i], L), nullptr,
                             parameter_block(origin), point);
    problem.AddResidualBlock(new WeightedReprojectionCost<3>(camera, second[i], L), nullptr,
                             parameter_block(pose), point, &weights[i]);
    problem.AddResidualBlock(new WeightPriorCost(phi0, lambda), nullptr, &weights[i]);
  }
  // [ten-line example]

  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.max_num_iterations = 100;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);

  double moving = 0.0, still = 0.0, movers = 0.0;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    (moves[i] ? moving : still) += weights[i];
    movers += moves[i] ? 1.0 : 0.0;
  }
  const double error = (pose.inverse().t - truth.inverse().t).norm();
  std::printf("cost %.1f -> %.1f in %d iterations\n", summary.initial_cost, summary.final_cost,
              static_cast<int>(summary.iterations.size()) - 1);
  std::printf("second keyframe: %.2f cm off\n", 100.0 * error);
  std::printf("mean weight: %.2f of %.0f moving points, %.2f of the others\n", moving / movers,
              movers, still / (static_cast<double>(weights.size()) - movers));
  return summary.IsSolutionUsable() && error < 0.03 ? 0 : 1;
}
