// Similarities of space, Sim(3), for loops of monocular maps.
#pragma once

#include <Eigen/Core>

#include "dynslam/core/rigid_transform.hpp"

namespace dynslam::factors {

/// Tangent of Sim(3): [rho; omega; sigma], sigma = log of the scale.
using Vector7d = Eigen::Matrix<double, 7, 1>;
using Matrix7d = Eigen::Matrix<double, 7, 7>;

/// x -> s R x + t.
struct Similarity {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d t = Eigen::Vector3d::Zero();
  double s = 1.0;  ///< > 0

  Similarity() = default;
  Similarity(double s_, const Eigen::Matrix3d& R_, const Eigen::Vector3d& t_)
      : R(R_), t(t_), s(s_) {}
  /// A rigid motion is a similarity of scale 1.
  explicit Similarity(const RigidTransform& T) : R(T.R), t(T.t) {}

  Similarity inverse() const {
    Eigen::Matrix3d Rt = R;
    Rt.transposeInPlace();
    return {1.0 / s, Rt, -(Rt * t) / s};
  }
  Similarity operator*(const Similarity& b) const { return {s * b.s, R * b.R, s * (R * b.t) + t}; }
  Eigen::Vector3d operator*(const Eigen::Vector3d& x) const { return s * (R * x) + t; }

  /// The rigid motion with the same camera centre and rotation, for a camera-from-world
  /// similarity: R, t / s.
  RigidTransform rigid() const { return {R, t / s}; }
  bool all_finite() const { return R.allFinite() && t.allFinite() && s - s == 0.0; }
};

/// Exponential of Sim(3), xi = [rho; omega; sigma]. O(1), no allocation.
Similarity sim3_exp(const Vector7d& xi);

/// Logarithm of Sim(3): the xi with |omega| <= pi whose exponential is S; S.s > 0.
Vector7d sim3_log(const Similarity& S);

}  // namespace dynslam::factors
