// Derivatives of the logarithm on SE(3) and Sim(3), for priors on poses and for pose graphs.
#pragma once

#include <cmath>

#include <Eigen/Core>
#include <Eigen/LU>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/so3.hpp"
#include "dynslam/factors/similarity.hpp"

namespace dynslam::factors {

/// Lie bracket with xi = [rho; omega] as a matrix: se3_bracket(a) b = [a, b].
inline Matrix6d se3_bracket(const Vector6d& xi) {
  Matrix6d ad;
  ad << skew(xi.tail<3>()), skew(xi.head<3>()), Eigen::Matrix3d::Zero(), skew(xi.tail<3>());
  return ad;
}

/// Lie bracket with xi = [rho; omega; sigma].
inline Matrix7d sim3_bracket(const Vector7d& xi) {
  const Eigen::Matrix3d omega = skew(xi.segment<3>(3));
  Matrix7d ad = Matrix7d::Zero();
  ad.block<3, 3>(0, 0) = omega + xi[6] * Eigen::Matrix3d::Identity();
  ad.block<3, 3>(0, 3) = skew(xi.head<3>());
  ad.block<3, 1>(0, 6) = -xi.head<3>();
  ad.block<3, 3>(3, 3) = omega;
  return ad;
}

/// Adjoint of a similarity: S exp(xi) S^-1 = exp(Ad(S) xi).
inline Matrix7d sim3_adjoint(const Similarity& S) {
  Matrix7d ad = Matrix7d::Zero();
  ad.block<3, 3>(0, 0) = S.s * S.R;
  ad.block<3, 3>(0, 3) = skew(S.t) * S.R;
  ad.block<3, 1>(0, 6) = -S.t;
  ad.block<3, 3>(3, 3) = S.R;
  ad(6, 6) = 1.0;
  return ad;
}

/// Left Jacobian J of a Lie group at xi from the bracket matrix of xi:
/// exp(xi + d) = exp(J d) exp(xi) to first order, J = sum_n bracket^n / (n + 1)!.
///
/// The series converges for every xi; it is summed to rounding. O(Dim^3) times about 25 terms.
template <int Dim>
Eigen::Matrix<double, Dim, Dim> left_jacobian(const Eigen::Matrix<double, Dim, Dim>& bracket) {
  using Matrix = Eigen::Matrix<double, Dim, Dim>;
  Matrix sum = Matrix::Identity();
  Matrix term = Matrix::Identity();
  for (int n = 1; n < 100; ++n) {
    term = (term * bracket / (n + 1.0)).eval();
    sum += term;
    if (!(term.cwiseAbs().maxCoeff() > 1e-17 * sum.cwiseAbs().maxCoeff())) break;
  }
  return sum;
}

/// Its inverse: log(exp(d) exp(xi)) = xi + J^-1 d to first order. |omega| < 2 pi.
template <int Dim>
Eigen::Matrix<double, Dim, Dim> left_jacobian_inverse(
    const Eigen::Matrix<double, Dim, Dim>& bracket) {
  return left_jacobian<Dim>(bracket).partialPivLu().inverse();
}

}  // namespace dynslam::factors
