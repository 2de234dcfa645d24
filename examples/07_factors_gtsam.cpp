// dynslam's weighted reprojection factor as a factor of GTSAM: the pose of a camera before known
// points, a quarter of which moved and have a low static weight.
//
// Compiled where GTSAM (4.0 or later) is installed.
#include <cmath>
#include <cstdio>
#include <random>

#include <gtsam/geometry/Point3.h>
#include <gtsam/geometry/Pose3.h>
#include <gtsam/inference/Symbol.h>
#include <gtsam/nonlinear/LevenbergMarquardtOptimizer.h>
#include <gtsam/nonlinear/NonlinearEquality.h>
#include <gtsam/nonlinear/NonlinearFactorGraph.h>
#include <gtsam/nonlinear/Values.h>

#include "dynslam/factors/weighted_reprojection.hpp"

#if GTSAM_VERSION_NUMERIC >= 40300
using OptionalJacobian = gtsam::OptionalMatrixType;  // a pointer
#else
using OptionalJacobian = boost::optional<gtsam::Matrix&>;
#endif

// [factor]
class StaticWeightFactor : public gtsam::NoiseModelFactor2<gtsam::Pose3, gtsam::Point3> {
 public:
  StaticWeightFactor(gtsam::Key pose, gtsam::Key point, const dynslam::DepthCamera& camera,
                     const Eigen::Vector3d& measured, const Eigen::Matrix3d& L, double phi)
      : gtsam::NoiseModelFactor2<gtsam::Pose3, gtsam::Point3>(gtsam::noiseModel::Unit::Create(3),
                                                              pose, point),
        camera_(camera),
        measured_(measured),
        L_(L),
        phi_(phi) {}

  gtsam::Vector evaluateError(const gtsam::Pose3& T_world_cam, const gtsam::Point3& X,
                              OptionalJacobian H_pose, OptionalJacobian H_point) const override {
    const gtsam::Pose3 inverse = T_world_cam.inverse();
    const dynslam::RigidTransform T(inverse.rotation().matrix(), inverse.translation());
    Eigen::Matrix<double, 3, 6> by_pose = Eigen::Matrix<double, 3, 6>::Zero();
    Eigen::Matrix3d by_point = Eigen::Matrix3d::Zero();
    Eigen::Vector3d e = Eigen::Vector3d::Constant(phi_ * 577.0);  // behind the camera: 1000 sigma
    dynslam::factors::weighted_reprojection<3>(camera_, T, X, measured_, L_, phi_, e,
                                               {&by_pose, &by_point});
    if (H_pose) {
      H_pose->resize(3, 6);
      *H_pose << -by_pose.rightCols<3>(), -by_pose.leftCols<3>();
    }
    if (H_point) *H_point = by_point;
    return e;
  }

 private:
  dynslam::DepthCamera camera_;
  Eigen::Vector3d measured_;
  Eigen::Matrix3d L_;
  double phi_;
};
// [factor]

int main() {
  dynslam::DepthCamera camera;
  camera.fx = camera.fy = 525.0, camera.cx = 319.5, camera.cy = 239.5;
  camera.width = 640, camera.height = 480;
  dynslam::Vector6d twist;
  twist << -0.2, 0.02, 0.05, 0.01, 0.04, 0.0;
  const dynslam::RigidTransform truth = dynslam::se3_exp(twist);

  gtsam::NonlinearFactorGraph graph;
  gtsam::Values start;
  const gtsam::Key pose = gtsam::Symbol('x', 0);
  start.insert(pose, gtsam::Pose3());
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::normal_distribution<double> noise(0.0, 1.0);
  for (int i = 0; i < 200; ++i) {
    const double u = 40.0 + 560.0 * uniform(rng), v = 40.0 + 400.0 * uniform(rng);
    const Eigen::Vector3d X = camera.unproject({u, v}, 1.5 + 3.0 * uniform(rng));
    const bool moves = uniform(rng) < 0.25;
    const gtsam::Key point = gtsam::Symbol('p', static_cast<unsigned>(i));
    start.insert<gtsam::Point3>(point, X);
    graph.emplace_shared<gtsam::NonlinearEquality<gtsam::Point3>>(point, X);
    const Eigen::Vector3d seen = moves ? X + Eigen::Vector3d(0.2, 0.0, 0.0) : X;
    const Eigen::Vector3d measured =
        camera.project3(truth * seen) + Eigen::Vector3d(noise(rng), noise(rng), noise(rng));
    graph.emplace_shared<StaticWeightFactor>(pose, point, camera, measured,
                                             Eigen::Matrix3d::Identity(), moves ? 0.01 : 1.0);
  }
  gtsam::LevenbergMarquardtOptimizer optimizer(graph, start);
  const gtsam::Pose3 T_world_cam = optimizer.optimize().at<gtsam::Pose3>(pose);
  const double error = (T_world_cam.translation() - truth.inverse().t).norm();
  std::printf("GTSAM: %.2f cm off after %d iterations\n", 100.0 * error,
              static_cast<int>(optimizer.iterations()));
  return error < 0.02 ? 0 : 1;
}
