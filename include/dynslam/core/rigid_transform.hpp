// Rigid motions of space, SE(3).
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "dynslam/core/so3.hpp"

namespace dynslam {

/// Twist: translation part first, rotation part last, [rho; omega].
using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

/// x -> R x + t. `T_cam_world` takes world coordinates to camera coordinates.
///
/// 96 bytes with alignment 8 whatever instruction set the user compiles for
/// (Eigen's Isometry3d has 16, 32 or 64), so it may cross the boundary of a
/// compiled library by value. Perturbations are on the left throughout dynslam:
/// T <- exp(xi) T.
struct RigidTransform {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d t = Eigen::Vector3d::Zero();

  RigidTransform() = default;
  RigidTransform(const Eigen::Matrix3d& R_, const Eigen::Vector3d& t_) : R(R_), t(t_) {}
  /// From a unit quaternion (normalized here) and a translation.
  RigidTransform(const Eigen::Quaterniond& q, const Eigen::Vector3d& t_)
      : R(q.normalized().toRotationMatrix()), t(t_) {}
  /// From a 4x4 homogeneous (or 3x4) matrix.
  static RigidTransform from_matrix(const Eigen::Ref<const Eigen::MatrixXd>& m) {
    return {m.topLeftCorner<3, 3>(), m.topRightCorner<3, 1>()};
  }

  Eigen::Matrix4d matrix() const {
    Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
    m.topLeftCorner<3, 3>() = R;
    m.topRightCorner<3, 1>() = t;
    return m;
  }
  /// Unit quaternion with w >= 0.
  Eigen::Quaterniond quaternion() const {
    Eigen::Quaterniond q(R);
    q.normalize();
    if (q.w() < 0.0) q.coeffs() = -q.coeffs();
    return q;
  }

  RigidTransform inverse() const {
    Eigen::Matrix3d Rt = R;
    Rt.transposeInPlace();
    return {Rt, -(Rt * t)};
  }
  RigidTransform operator*(const RigidTransform& b) const { return {R * b.R, R * b.t + t}; }
  Eigen::Vector3d operator*(const Eigen::Vector3d& x) const { return R * x + t; }

  /// The same motion with R projected onto the rotations; call after long
  /// products.
  RigidTransform normalized() const { return {Eigen::Quaterniond(R), t}; }

  bool all_finite() const { return R.allFinite() && t.allFinite(); }
};

static_assert(sizeof(RigidTransform) == 96 && alignof(RigidTransform) == 8,
              "RigidTransform must have one layout in every mode");

/// Exponential of SE(3), xi = [rho; omega]. O(1), no allocation.
inline RigidTransform se3_exp(const Vector6d& xi) {
  const Eigen::Vector3d omega = xi.tail<3>();
  return {so3_exp(omega), so3_left_jacobian(omega) * xi.head<3>()};
}

/// Logarithm of SE(3): the xi with |omega| <= pi whose exponential is T.
inline Vector6d se3_log(const RigidTransform& T) {
  const Eigen::Vector3d omega = so3_log(T.R);
  Vector6d xi;
  xi << so3_left_jacobian_inverse(omega) * T.t, omega;
  return xi;
}

/// Adjoint: T exp(xi) T^-1 = exp(Ad(T) xi).
inline Matrix6d se3_adjoint(const RigidTransform& T) {
  Matrix6d ad;
  ad << T.R, skew(T.t) * T.R, Eigen::Matrix3d::Zero(), T.R;
  return ad;
}

/// Angle of the rotation between two motions, radians in [0, pi].
inline double rotation_angle(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b) {
  return so3_log(a.transpose() * b).norm();
}

/// Motion part of the way from a (s = 0) to b (s = 1), along the screw.
inline RigidTransform interpolate(const RigidTransform& a, const RigidTransform& b, double s) {
  return se3_exp(s * se3_log(b * a.inverse())) * a;
}

}  // namespace dynslam
