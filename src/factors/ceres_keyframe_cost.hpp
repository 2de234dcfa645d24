// The weighted reprojection factor over a keyframe, in the form that Ceres evaluates fastest.
//
// A keyframe is a plain block of 6 here. Its chart is moved to the pose at which derivatives are
// taken, T = exp(xi - origin) T_origin with origin = xi, so the derivative by the block is the one
// by the left perturbation: no manifold for Ceres to multiply by, no derivative of an exponential.
// The exponential itself is computed once a keyframe, not once an observation.
#pragma once

#include <cmath>
#include <type_traits>
#include <vector>

#include <Eigen/Core>
#include <ceres/evaluation_callback.h>
#include <ceres/sized_cost_function.h>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/factors/ceres.hpp"

namespace dynslam::factors {

// The blocks of all keyframes; Ceres tells it before it evaluates. A trust region method takes
// derivatives only at points that it has accepted, so the charts never move under a trial step.
class CeresKeyframes final : public ceres::EvaluationCallback {
 public:
  struct State {
    Vector6d xi = Vector6d::Zero();      // the parameter block
    Vector6d origin = Vector6d::Zero();  // xi at which the chart is centred
    RigidTransform T_origin, T;
  };

  explicit CeresKeyframes(Span<const RigidTransform> poses) {
    states.reserve(poses.size());
    for (const RigidTransform& T : poses) {
      states.emplace_back();
      states.back().T_origin = states.back().T = T;
    }
  }

  void PrepareForEvaluation(bool jacobians, bool new_point) override {
    for (State& state : states) {
      if (new_point) state.T = pose_of(state);
      if (jacobians) {
        state.origin = state.xi;
        state.T_origin = state.T;
      }
    }
  }

  static RigidTransform pose_of(const State& state) {
    if (state.xi == state.origin) return state.T_origin;
    return (se3_exp(state.xi - state.origin) * state.T_origin).normalized();
  }

  std::vector<State> states;
};

template <int Rows, bool kWeight>
using KeyframeCostBase = std::conditional_t<kWeight, ceres::SizedCostFunction<Rows, 6, 3, 1>,
                                            ceres::SizedCostFunction<Rows, 6, 3>>;

// phi S^-1/2 (p - pi(T X)) with S^-1/2 = inverse_sigma, right_inverse_sigma in the third row;
// blocks: keyframe 6, point 3, and phi 1 where kWeight, else phi = 1. The derivatives of
// weighted_reprojection(), with its zeros left out.
template <int Rows, bool kWeight>
class KeyframeCost final : public KeyframeCostBase<Rows, kWeight> {
 public:
  using Measured = Eigen::Matrix<double, Rows, 1>;
  KeyframeCost(const DepthCamera& camera, const CeresKeyframes::State& keyframe,
               const Measured& measured, double inverse_sigma, double right_inverse_sigma)
      : camera_(camera),
        keyframe_(keyframe),
        measured_(measured),
        inverse_sigma_(inverse_sigma),
        right_inverse_sigma_(right_inverse_sigma) {}

  bool Evaluate(double const* const* x, double* residuals, double** J) const override {
    const RigidTransform& T = keyframe_.T;
    const Eigen::Vector3d X = T.R * Eigen::Map<const Eigen::Vector3d>(x[1]) + T.t;
    double phi = 1.0;
    if constexpr (kWeight) phi = *x[2];
    if (!PinholeCamera::in_domain(X)) {
      pull_at_nothing(phi, residuals, J);
      return true;
    }
    const double inv_z = 1.0 / X.z(), u = X.x() * inv_z, v = X.y() * inv_z;
    const double column = camera_.fx * u + camera_.cx;
    Measured whitened;
    whitened[0] = inverse_sigma_ * (measured_[0] - column);
    whitened[1] = inverse_sigma_ * (measured_[1] - (camera_.fy * v + camera_.cy));
    if constexpr (Rows == 3)
      whitened[2] = right_inverse_sigma_ * (measured_[2] - (column - camera_.bf * inv_z));
    for (int r = 0; r < Rows; ++r) residuals[r] = phi * whitened[r];
    if (!J) return true;
    const double scale = -phi * inverse_sigma_ * inv_z;
    const double right_scale = -phi * right_inverse_sigma_ * inv_z;
    const double a = scale * camera_.fx, b = scale * camera_.fy;
    const double c = right_scale * camera_.fx, d = right_scale * camera_.bf * inv_z;
    if (J[0]) by_keyframe(X, u, v, {a, b, c, d}, J[0]);
    if (J[1]) by_point(T.R, u, v, {a, b, c, d}, J[1]);
    if constexpr (kWeight) {
      if (J[2]) detail::map<Rows, 1>(J[2]) = whitened;
    }
    return true;
  }

 private:
  // Rows of -phi S^-1/2 d pi / dX are (a, 0, -a u), (0, b, -b v), (c, 0, -c u + d).
  struct Slopes {
    double a, b, c, d;
  };
  static void by_keyframe(const Eigen::Vector3d& X, double u, double v, const Slopes& of,
                          double* J) {
    const double along_u[] = {1.0, 0.0, -u, -u * X.y(), X.z() + u * X.x(), -X.y()};
    const double along_v[] = {0.0, 1.0, -v, -(v * X.y() + X.z()), v * X.x(), X.x()};
    for (int i = 0; i < 6; ++i) J[i] = of.a * along_u[i], J[6 + i] = of.b * along_v[i];
    if constexpr (Rows == 3) {
      const double along_z[] = {0.0, 0.0, 1.0, X.y(), -X.x(), 0.0};
      for (int i = 0; i < 6; ++i) J[12 + i] = of.c * along_u[i] + of.d * along_z[i];
    }
  }
  static void by_point(const Eigen::Matrix3d& R, double u, double v, const Slopes& of, double* J) {
    for (int i = 0; i < 3; ++i) {
      const double along_u = R(0, i) - u * R(2, i);
      J[i] = of.a * along_u;
      J[3 + i] = of.b * (R(1, i) - v * R(2, i));
      if constexpr (Rows == 3) J[6 + i] = of.c * along_u + of.d * R(2, i);
    }
  }
  static void pull_at_nothing(double phi, double* residuals, double** J) {
    const double each = detail::kBehindResidual / std::sqrt(double{Rows});
    for (int r = 0; r < Rows; ++r) residuals[r] = phi * each;
    if (J && J[0]) detail::map<Rows, 6>(J[0]).setZero();
    if (J && J[1]) detail::map<Rows, 3>(J[1]).setZero();
    if constexpr (kWeight) {
      if (J && J[2]) detail::map<Rows, 1>(J[2]).setConstant(each);
    }
  }

  const DepthCamera& camera_;
  const CeresKeyframes::State& keyframe_;
  Measured measured_;
  double inverse_sigma_, right_inverse_sigma_;
};

}  // namespace dynslam::factors
