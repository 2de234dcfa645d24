#include "two_view_motion.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>

#include "dynslam/core/so3.hpp"
#include "dynslam/factors/bundle_adjustment.hpp"

namespace dynslam::slam {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Matrix26d = Eigen::Matrix<double, 2, 6>;
using Matrix23d = Eigen::Matrix<double, 2, 3>;

// Squared error of a match to first order, whatever its point (Sampson 1982), over its variance.
double sampson(const Matrix3d& F, const PixelMatch& m) {
  const Vector3d line = F * m.first.homogeneous();
  const Vector3d back = F.transpose() * m.second.homogeneous();
  const double off = m.second.homogeneous().dot(line);
  const double variance = line.head<2>().squaredNorm() * m.second_scale * m.second_scale +
                          back.head<2>().squaredNorm() * m.first_scale * m.first_scale;
  return off * off / variance;
}

factors::BundleObservation observation(const Vector2d& pixel, double scale, std::uint32_t view,
                                       std::size_t point) {
  factors::BundleObservation o;
  o.keyframe = view;
  o.point = static_cast<std::uint32_t>(point);
  o.u = static_cast<float>(pixel.x());
  o.v = static_cast<float>(pixel.y());
  o.inverse_sigma = static_cast<float>(1.0 / scale);
  return o;
}

}  // namespace

double squared_line_distance(const Matrix3d& F, const Vector2d& first, const Vector2d& second) {
  const Vector3d line = F * first.homogeneous();
  const double off = second.homogeneous().dot(line);
  return off * off / line.head<2>().squaredNorm();
}

Matrix3d fundamental_matrix(const PinholeCamera& camera, const RigidTransform& T_second_first) {
  Matrix3d K_inverse;
  K_inverse << 1.0 / camera.fx, 0.0, -camera.cx / camera.fx, 0.0, 1.0 / camera.fy,
      -camera.cy / camera.fy, 0.0, 0.0, 1.0;
  return K_inverse.transpose() * skew(T_second_first.t) * T_second_first.R * K_inverse;
}

TwoViewMotion judge_motion(const PinholeCamera& camera, const std::vector<PixelMatch>& matches,
                           const RigidTransform& T_second_first, const TwoViewOptions& options) {
  TwoViewMotion motion;
  motion.T_second_first = T_second_first;
  motion.points.resize(matches.size());
  TriangulationOptions tests;
  tests.min_parallax_deg = options.min_point_parallax_deg;
  const Matrix3d F = fundamental_matrix(camera, T_second_first);
  for (std::size_t i = 0; i < matches.size(); ++i) {
    const PixelMatch& m = matches[i];
    TriangulatedPoint& point = motion.points[i];
    point = triangulate(camera, {RigidTransform(), m.first, m.first_scale},
                        {T_second_first, m.second, m.second_scale}, tests);
    const double error = sampson(F, m);
    if (error < kChi2Line) ++motion.explained;
    if (point.status == TriangulationStatus::kBehindCamera) {
      if (error < kChi2Line) ++motion.contrary;
      continue;
    }
    motion.likelihood += kChi2Line - std::min(error, kChi2Line);
    if (!point.ok()) continue;
    ++motion.good;
    if (point.parallax_deg >= options.min_parallax_deg) ++motion.wide;
  }
  return motion;
}

TwoViewMotion refine_motion(const PinholeCamera& camera, const std::vector<PixelMatch>& matches,
                            const TwoViewMotion& motion, const TwoViewOptions& options) {
  RigidTransform poses[] = {RigidTransform(), motion.T_second_first};
  const std::uint8_t held[] = {1, 0};
  std::vector<Vector3d> points;
  std::vector<factors::BundleObservation> observations;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    if (!motion.points[i].ok()) continue;
    const PixelMatch& m = matches[i];
    observations.push_back(observation(m.first, m.first_scale, 0, points.size()));
    observations.push_back(observation(m.second, m.second_scale, 1, points.size()));
    points.push_back(motion.points[i].position);
  }
  factors::BundleProblem problem;
  static_cast<PinholeCamera&>(problem.camera) = camera;
  problem.T_cam_world = poses;
  problem.keyframe_fixed = held;
  problem.points_world = points;
  problem.observations = observations;
  factors::BundleOptions bundle;
  bundle.max_iterations = 30;
  if (!factors::usable(factors::optimize_bundle(problem, bundle).status)) return motion;
  RigidTransform T = poses[1];
  const double length = T.t.norm();
  if (!T.all_finite() || !(length > 1e-9)) return motion;
  T.t /= length;
  return judge_motion(camera, matches, T, options);
}

double direction_uncertainty_deg(const PinholeCamera& camera,
                                 const std::vector<PixelMatch>& matches,
                                 const TwoViewMotion& motion) {
  const RigidTransform& T = motion.T_second_first;
  Matrix6d information = Matrix6d::Zero();  // of the perturbation [rho; omega] of T
  for (std::size_t i = 0; i < matches.size(); ++i) {
    if (!motion.points[i].ok()) continue;
    const PixelMatch& m = matches[i];
    const Vector3d& X = motion.points[i].position;
    const Vector3d Y = T * X;
    const Matrix23d J_first = camera.project_jacobian(X) / m.first_scale;
    const Matrix23d J = camera.project_jacobian(Y) / m.second_scale;
    Matrix26d J_pose;
    J_pose << J, -J * skew(Y);
    const Matrix23d J_point = J * T.R;
    const Matrix3d points = J_first.transpose() * J_first + J_point.transpose() * J_point;
    const Eigen::Matrix<double, 6, 3> cross = J_pose.transpose() * J_point;
    information += J_pose.transpose() * J_pose - cross * points.ldlt().solve(cross.transpose());
  }
  // Directions in which T may change: two across the translation, three of the rotation. A rotation
  // about the first camera's axes turns t too, so t is moved back: rho = d - omega x t.
  const Vector3d t = T.t.normalized();
  const Vector3d a = t.unitOrthogonal();
  Eigen::Matrix<double, 6, 5> basis = Eigen::Matrix<double, 6, 5>::Zero();
  basis.block<3, 1>(0, 0) = a;
  basis.block<3, 1>(0, 1) = t.cross(a);
  basis.block<3, 3>(0, 2) = skew(T.t);
  basis.block<3, 3>(3, 2).setIdentity();
  const Eigen::Matrix<double, 5, 5> reduced = basis.transpose() * information * basis;
  const Eigen::Matrix<double, 5, 5> covariance = reduced.inverse();
  if (!covariance.allFinite()) return 90.0;
  // The larger eigenvalue of what concerns the direction.
  const double variance = 0.5 * (covariance(0, 0) + covariance(1, 1)) +
                          std::hypot(0.5 * (covariance(0, 0) - covariance(1, 1)), covariance(0, 1));
  constexpr double kDegrees = 180.0 / 3.14159265358979323846;
  return variance > 0.0 ? std::min(90.0, std::sqrt(variance) / T.t.norm() * kDegrees) : 90.0;
}

}  // namespace dynslam::slam
