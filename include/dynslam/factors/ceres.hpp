// The factors as Ceres cost functions and losses. Works with Ceres 2.0 to 2.2.
//
// Parameter blocks are the host's own objects (ceres_manifolds.hpp): a RigidTransform is a block of
// 12 doubles, a Similarity one of 13, a point 3, a static weight 1, intrinsics 4 or 5. Jacobians
// are true derivatives by these doubles, so ceres::GradientChecker agrees with them.
//
// Here: weights, losses, priors and relative poses; the reprojection costs, with lens and
// intrinsics, come from ceres_reprojection.hpp.
#pragma once

#include <cmath>

#include <Eigen/Core>
#include <ceres/loss_function.h>
#include <ceres/problem.h>
#include <ceres/sized_cost_function.h>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/factors/ceres_manifolds.hpp"
#include "dynslam/factors/ceres_reprojection.hpp"
#include "dynslam/factors/lie_jacobians.hpp"
#include "dynslam/factors/robust_loss.hpp"
#include "dynslam/factors/similarity.hpp"

namespace dynslam::factors {

/// Adds a static weight with its bounds [0, 1].
inline void add_weight_block(ceres::Problem& problem, double& phi) {
  problem.AddParameterBlock(&phi, 1);
  problem.SetParameterLowerBound(&phi, 0, 0.0);
  problem.SetParameterUpperBound(&phi, 0, 1.0);
}

/// sqrt(lambda) (phi - phi0); block: weight 1.
class WeightPriorCost final : public ceres::SizedCostFunction<1, 1> {
 public:
  WeightPriorCost(double phi0, double lambda) : phi0_(phi0), root_(std::sqrt(lambda)) {}
  bool Evaluate(double const* const* x, double* residuals, double** J) const override {
    residuals[0] = root_ * (*x[0] - phi0_);
    if (J && J[0]) J[0][0] = root_;
    return true;
  }

 private:
  double phi0_, root_;
};

/// scale * rho(s) for any of dynslam's losses; scale = phi0^2 trusts an observation by its weight.
class RobustLossFunction final : public ceres::LossFunction {
 public:
  explicit RobustLossFunction(const RobustLoss& loss, double scale = 1.0)
      : loss_(loss), scale_(scale) {}
  void Evaluate(double s, double rho[3]) const override {
    const LossValue value = loss_(s);
    rho[0] = scale_ * value.rho, rho[1] = scale_ * value.rho1, rho[2] = scale_ * value.rho2;
  }

 private:
  RobustLoss loss_;
  double scale_;
};

/// A static weight in its closed form: phi0^2 lambda s / (lambda + s) over a ReprojectionCost of
/// weight 1. The same optimum as WeightedReprojectionCost with WeightPriorCost.
class EliminatedWeightLoss final : public ceres::LossFunction {
 public:
  EliminatedWeightLoss(double phi0, double lambda)
      : loss_({LossKind::kGemanMcClure, std::sqrt(lambda), 0.0}, phi0 * phi0) {}
  void Evaluate(double s, double rho[3]) const override { loss_.Evaluate(s, rho); }

 private:
  RobustLossFunction loss_;
};

/// Relative motion of two poses T_cam_world: L log(T_to_from^-1 T_to T_from^-1), information = L'L;
/// blocks: pose `from` 12, pose `to` 12.
class RelativePoseCost final : public ceres::SizedCostFunction<6, kPoseBlock, kPoseBlock> {
 public:
  RelativePoseCost(const RigidTransform& T_to_from, const Matrix6d& sqrt_information)
      : inverse_(T_to_from.inverse()), L_(sqrt_information) {}
  bool Evaluate(double const* const* x, double* residuals, double** J) const override {
    const Vector6d e = se3_log(inverse_ * pose_from_block(x[1]) * pose_from_block(x[0]).inverse());
    detail::map<6, 1>(residuals) = L_ * e;
    if (!J) return true;
    if (J[0]) {
      detail::map<6, kPoseBlock>(J[0]) = -L_ * left_jacobian_inverse<6>(se3_bracket(-e)) *
                                         detail::minus_jacobian<kPoseBlock, 6>(x[0]);
    }
    if (J[1]) {
      detail::map<6, kPoseBlock>(J[1]) = L_ * left_jacobian_inverse<6>(se3_bracket(e)) *
                                         se3_adjoint(inverse_) *
                                         detail::minus_jacobian<kPoseBlock, 6>(x[1]);
    }
    return true;
  }

 private:
  RigidTransform inverse_;
  Matrix6d L_;
};

/// The same for similarities S_cam_world; blocks: `from` 13, `to` 13.
class RelativeSimilarityCost final
    : public ceres::SizedCostFunction<7, kSimilarityBlock, kSimilarityBlock> {
 public:
  RelativeSimilarityCost(const Similarity& S_to_from, const Matrix7d& sqrt_information)
      : inverse_(S_to_from.inverse()), L_(sqrt_information) {}
  bool Evaluate(double const* const* x, double* residuals, double** J) const override {
    if (!(x[0][12] > 0.0) || !(x[1][12] > 0.0)) return false;
    const Vector7d e =
        sim3_log(inverse_ * similarity_from_block(x[1]) * similarity_from_block(x[0]).inverse());
    detail::map<7, 1>(residuals) = L_ * e;
    if (!J) return true;
    if (J[0]) {
      detail::map<7, kSimilarityBlock>(J[0]) = -L_ * left_jacobian_inverse<7>(sim3_bracket(-e)) *
                                               detail::minus_jacobian<kSimilarityBlock, 7>(x[0]);
    }
    if (J[1]) {
      detail::map<7, kSimilarityBlock>(J[1]) = L_ * left_jacobian_inverse<7>(sim3_bracket(e)) *
                                               sim3_adjoint(inverse_) *
                                               detail::minus_jacobian<kSimilarityBlock, 7>(x[1]);
    }
    return true;
  }

 private:
  Similarity inverse_;
  Matrix7d L_;
};

/// Prior on a pose: L log(T mean^-1); block: pose 12.
class PosePriorCost final : public ceres::SizedCostFunction<6, kPoseBlock> {
 public:
  PosePriorCost(const RigidTransform& mean, const Matrix6d& sqrt_information)
      : inverse_(mean.inverse()), L_(sqrt_information) {}
  bool Evaluate(double const* const* x, double* residuals, double** J) const override {
    const Vector6d e = se3_log(pose_from_block(x[0]) * inverse_);
    detail::map<6, 1>(residuals) = L_ * e;
    if (J && J[0]) {
      detail::map<6, kPoseBlock>(J[0]) = L_ * left_jacobian_inverse<6>(se3_bracket(e)) *
                                         detail::minus_jacobian<kPoseBlock, 6>(x[0]);
    }
    return true;
  }

 private:
  RigidTransform inverse_;
  Matrix6d L_;
};

}  // namespace dynslam::factors
