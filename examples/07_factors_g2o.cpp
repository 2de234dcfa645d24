// dynslam's weighted reprojection factor as an edge of g2o: the pose of a camera before known
// points, a quarter of which moved and have a low static weight.
//
// Compiled where g2o is installed; of g2o it needs the parts under the BSD licence alone.
#include <cmath>
#include <cstdio>
#include <memory>
#include <random>

#include <g2o/core/base_binary_edge.h>
#include <g2o/core/block_solver.h>
#include <g2o/core/optimization_algorithm_levenberg.h>
#include <g2o/core/sparse_optimizer.h>
#include <g2o/solvers/eigen/linear_solver_eigen.h>
#include <g2o/types/sba/types_six_dof_expmap.h>

#include "dynslam/factors/weighted_reprojection.hpp"

// [edge]
class StaticWeightEdge
    : public g2o::BaseBinaryEdge<3, Eigen::Vector3d, g2o::VertexPointXYZ, g2o::VertexSE3Expmap> {
 public:
  EIGEN_MAKE_ALIGNED_OPERATOR_NEW
  dynslam::DepthCamera camera;
  Eigen::Matrix3d L = Eigen::Matrix3d::Identity();  // S^-1/2; information stays the identity
  double phi = 1.0;

  void computeError() override { evaluate({}); }
  void linearizeOplus() override {
    Eigen::Matrix<double, 3, 6> by_pose;
    Eigen::Matrix3d by_point;
    if (!evaluate({&by_pose, &by_point})) by_pose.setZero(), by_point.setZero();
    _jacobianOplusXi = by_point;
    _jacobianOplusXj << by_pose.rightCols<3>(), by_pose.leftCols<3>();
  }
  bool read(std::istream&) override { return false; }
  bool write(std::ostream&) const override { return false; }

 private:
  bool evaluate(const dynslam::factors::ReprojectionJacobians<3>& wanted) {
    const auto* point = static_cast<const g2o::VertexPointXYZ*>(_vertices[0]);
    const auto* pose = static_cast<const g2o::VertexSE3Expmap*>(_vertices[1]);
    const dynslam::RigidTransform T(pose->estimate().rotation(), pose->estimate().translation());
    const bool in_front = dynslam::factors::weighted_reprojection<3>(
        camera, T, point->estimate(), _measurement, L, phi, _error, wanted);
    if (!in_front) _error.setConstant(phi * 577.0);  // 1000 sigma: no gain by going behind
    return in_front;
  }
};
// [edge]

int main() {
  dynslam::DepthCamera camera;
  camera.fx = camera.fy = 525.0, camera.cx = 319.5, camera.cy = 239.5;
  camera.width = 640, camera.height = 480;
  dynslam::Vector6d twist;
  twist << -0.2, 0.02, 0.05, 0.01, 0.04, 0.0;
  const dynslam::RigidTransform truth = dynslam::se3_exp(twist);

  g2o::SparseOptimizer optimizer;
  using Solver = g2o::BlockSolver_6_3;
  optimizer.setAlgorithm(new g2o::OptimizationAlgorithmLevenberg(std::make_unique<Solver>(
      std::make_unique<g2o::LinearSolverEigen<Solver::PoseMatrixType>>())));
  auto* pose = new g2o::VertexSE3Expmap;  // starts at the identity
  pose->setId(0);
  optimizer.addVertex(pose);
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::normal_distribution<double> noise(0.0, 1.0);
  for (int i = 1; i <= 200; ++i) {
    const double u = 40.0 + 560.0 * uniform(rng), v = 40.0 + 400.0 * uniform(rng);
    const Eigen::Vector3d X = camera.unproject({u, v}, 1.5 + 3.0 * uniform(rng));
    const bool moves = uniform(rng) < 0.25;
    auto* point = new g2o::VertexPointXYZ;
    point->setId(i);
    point->setEstimate(X);
    point->setFixed(true);
    optimizer.addVertex(point);
    auto* edge = new StaticWeightEdge;
    edge->camera = camera;
    edge->phi = moves ? 0.01 : 1.0;
    edge->setVertex(0, point);
    edge->setVertex(1, pose);
    const Eigen::Vector3d seen = moves ? X + Eigen::Vector3d(0.2, 0.0, 0.0) : X;
    edge->setMeasurement(camera.project3(truth * seen) +
                         Eigen::Vector3d(noise(rng), noise(rng), noise(rng)));
    edge->setInformation(Eigen::Matrix3d::Identity());
    optimizer.addEdge(edge);
  }
  optimizer.initializeOptimization();
  const int iterations = optimizer.optimize(20);
  const dynslam::RigidTransform T(pose->estimate().rotation(), pose->estimate().translation());
  const double error = (T.inverse().t - truth.inverse().t).norm();
  std::printf("g2o: %.2f cm off after %d iterations\n", 100.0 * error, iterations);
  return error < 0.02 ? 0 : 1;
}
