#include "dynslam/factors/similarity.hpp"

#include <cmath>

#include <Eigen/LU>

#include "dynslam/core/so3.hpp"

namespace dynslam::factors {
namespace {

// V = integral of exp(a A) for a from 0 to 1, by halving until the series is short:
// V(A) = (I + exp(A/2)) / 2 V(A/2). Returns exp(A) as well.
Eigen::Matrix3d integral_of_exp(const Eigen::Matrix3d& A, Eigen::Matrix3d* exp_A) {
  if (A.allFinite() && A.cwiseAbs().maxCoeff() > 0.5) {
    Eigen::Matrix3d half;
    const Eigen::Matrix3d V = integral_of_exp(0.5 * A, &half);
    *exp_A = half * half;
    return 0.5 * (V + half * V);
  }
  Eigen::Matrix3d sum = Eigen::Matrix3d::Identity();
  Eigen::Matrix3d term = sum;
  for (int n = 1; n < 20; ++n) {
    term = (term * A / (n + 1.0)).eval();
    sum += term;
  }
  *exp_A = Eigen::Matrix3d::Identity() + A * sum;
  return sum;
}

Eigen::Matrix3d translation_part(const Eigen::Vector3d& omega, double sigma) {
  Eigen::Matrix3d unused;
  return integral_of_exp(skew(omega) + sigma * Eigen::Matrix3d::Identity(), &unused);
}

}  // namespace

Similarity sim3_exp(const Vector7d& xi) {
  const Eigen::Vector3d omega = xi.segment<3>(3);
  return {std::exp(xi[6]), so3_exp(omega), translation_part(omega, xi[6]) * xi.head<3>()};
}

Vector7d sim3_log(const Similarity& S) {
  const Eigen::Vector3d omega = so3_log(S.R);
  const double sigma = std::log(S.s);
  Vector7d xi;
  xi << translation_part(omega, sigma).partialPivLu().solve(S.t), omega, sigma;
  return xi;
}

}  // namespace dynslam::factors
