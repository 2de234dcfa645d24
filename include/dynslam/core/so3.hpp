// Rotations: exponential and logarithm of SO(3).
#pragma once

#include <cmath>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace dynslam {

/// Matrix [v]x with [v]x w = v x w.
inline Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

namespace detail {

/// sin(x)/x, (1-cos x)/x^2 and (x-sin x)/x^3, exact to rounding near zero as
/// well.
struct SincSeries {
  double a, b, c;
  explicit SincSeries(double theta2) {
    if (theta2 < 1e-4) {
      a = 1.0 - theta2 / 6.0 * (1.0 - theta2 / 20.0 * (1.0 - theta2 / 42.0));
      b = 0.5 - theta2 / 24.0 * (1.0 - theta2 / 30.0 * (1.0 - theta2 / 56.0));
      c = 1.0 / 6.0 - theta2 / 120.0 * (1.0 - theta2 / 42.0 * (1.0 - theta2 / 72.0));
    } else {
      const double theta = std::sqrt(theta2);
      const double half = std::sin(0.5 * theta);
      a = std::sin(theta) / theta;
      b = 2.0 * half * half / theta2;
      c = (1.0 - a) / theta2;
    }
  }
};

}  // namespace detail

/// Rotation by |omega| radians about omega. Source: Rodrigues' formula.
inline Eigen::Matrix3d so3_exp(const Eigen::Vector3d& omega) {
  const detail::SincSeries s(omega.squaredNorm());
  const Eigen::Matrix3d w = skew(omega);
  return Eigen::Matrix3d::Identity() + s.a * w + s.b * (w * w);
}

/// Rotation vector of R, |omega| <= pi. Stable near 0 and near pi (through the
/// quaternion).
inline Eigen::Vector3d so3_log(const Eigen::Matrix3d& R) {
  Eigen::Quaterniond q(R);
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  const double n = q.vec().norm();
  if (n < 1e-10) return (2.0 / q.w()) * q.vec();
  return (2.0 * std::atan2(n, q.w()) / n) * q.vec();
}

/// Left Jacobian J of SO(3): exp(omega + d) = exp(J d) exp(omega) to first
/// order; also the V of SE(3)'s exponential.
inline Eigen::Matrix3d so3_left_jacobian(const Eigen::Vector3d& omega) {
  const detail::SincSeries s(omega.squaredNorm());
  const Eigen::Matrix3d w = skew(omega);
  return Eigen::Matrix3d::Identity() + s.b * w + s.c * (w * w);
}

/// Inverse of `so3_left_jacobian`, |omega| < 2 pi.
inline Eigen::Matrix3d so3_left_jacobian_inverse(const Eigen::Vector3d& omega) {
  const double theta2 = omega.squaredNorm();
  const Eigen::Matrix3d w = skew(omega);
  double k;  // (1 - (theta/2) cot(theta/2)) / theta^2
  if (theta2 < 1e-3) {
    k = 1.0 / 12.0 + theta2 / 720.0 * (1.0 + theta2 / 42.0 * (1.0 + theta2 / 40.0));
  } else {
    const double half = 0.5 * std::sqrt(theta2);
    k = (1.0 - half * std::cos(half) / std::sin(half)) / theta2;
  }
  return Eigen::Matrix3d::Identity() - 0.5 * w + k * (w * w);
}

}  // namespace dynslam
