// Refinement of a rigid motion on its inliers; a part of robust_pose.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Core>

#include "dynslam/geometry/detail/rigid_search.hpp"

namespace dynslam::geometry::detail {

/// One step of Gauss-Newton with Huber weights on image and depth of the inliers.
inline bool gauss_newton_step(const PinholeCamera& camera, Span<const PosePoint> points,
                              const std::vector<int>& inliers, RigidTransform& T) {
  Matrix6d H = 1e-9 * Matrix6d::Identity();
  Vector6d g = Vector6d::Zero();
  for (const int i : inliers) {
    const PosePoint& point = points[static_cast<std::size_t>(i)];
    const Eigen::Vector3d X = T * point.world;
    if (!(X.z() > kMinDepth)) continue;
    Eigen::Matrix<double, 3, 6> dX;
    dX << Eigen::Matrix3d::Identity(), -skew(X);
    // A third of the limit is taken for one sigma.
    const double image_scale = 3.0 / point.pixel_limit;
    const Eigen::Vector2d r = image_scale * (camera.project(X) - point.pixel);
    const Eigen::Matrix<double, 2, 6> J = image_scale * camera.project_jacobian(X) * dX;
    const double norm = r.norm();
    const double huber = (0.05 + point.weight) * (norm > 1.0 ? 1.0 / norm : 1.0);
    H += huber * J.transpose() * J;
    g += huber * J.transpose() * r;
    if (point.depth <= 0.0) continue;
    const double depth_scale = 3.0 / point.depth_limit;
    const double rz = depth_scale * (X.z() - point.depth);
    const Eigen::Matrix<double, 1, 6> Jz = depth_scale * dX.row(2);
    const double huber_z = (0.05 + point.weight) * (std::abs(rz) > 1.0 ? 1.0 / std::abs(rz) : 1.0);
    H += huber_z * Jz.transpose() * Jz;
    g += huber_z * Jz.transpose() * rz;
  }
  const Vector6d xi = -H.ldlt().solve(g);
  if (!xi.allFinite()) return false;
  T = se3_exp(xi) * T;
  return xi.norm() > 1e-7;
}

/// Refines a motion on its inliers, collected anew before each step; keeps the pose with the
/// greatest support.
inline void refine_motion(const PinholeCamera& camera, const RobustPoseOptions& o,
                          RobustPoseWorkspace& w, RigidTransform& T) {
  const Span<const PosePoint> points = w.points;
  RigidTransform current = T;
  double best = measure_support(camera, points, w.taken, T, o).value;
  for (int step = 0; step < o.refinements; ++step) {
    collect_inliers(camera, points, w.taken, current, o, w.inliers);
    if (w.inliers.size() < 4) break;
    const bool moved = gauss_newton_step(camera, points, w.inliers, current);
    const double value = measure_support(camera, points, w.taken, current, o).value;
    if (value > best) {
      best = value;
      T = current;
    }
    if (!moved) break;
  }
  T = T.normalized();
}

}  // namespace dynslam::geometry::detail
