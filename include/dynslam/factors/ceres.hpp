// The factors as Ceres cost functions, losses and manifolds. Works with Ceres 2.0 to 2.2.
//
// Parameter blocks are the host's own objects: a RigidTransform is a block of 12 doubles (R column
// by column, then t), a Similarity one of 13 (R, t, s), a point 3, a static weight 1. Jacobians
// are true derivatives by these doubles, so ceres::GradientChecker agrees with them.
#pragma once

#include <cmath>

#include <Eigen/Core>
#include <ceres/cost_function.h>
#include <ceres/loss_function.h>
#include <ceres/problem.h>
#include <ceres/sized_cost_function.h>
#include <ceres/version.h>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/factors/lie_jacobians.hpp"
#include "dynslam/factors/robust_loss.hpp"
#include "dynslam/factors/similarity.hpp"
#include "dynslam/factors/weighted_reprojection.hpp"

#define DYNSLAM_CERES_HAS_MANIFOLD \
  (CERES_VERSION_MAJOR > 2 || (CERES_VERSION_MAJOR == 2 && CERES_VERSION_MINOR >= 1))
#if DYNSLAM_CERES_HAS_MANIFOLD
#include <ceres/manifold.h>
#else
#include <ceres/local_parameterization.h>
#endif

namespace dynslam::factors {

inline constexpr int kPoseBlock = 12;
inline constexpr int kSimilarityBlock = 13;

static_assert(sizeof(Similarity) == kSimilarityBlock * sizeof(double),
              "a Similarity must be 13 doubles in a row");

/// The doubles of a pose, a similarity, a point as a parameter block; no copy.
inline double* parameter_block(RigidTransform& T) { return T.R.data(); }
inline double* parameter_block(Similarity& S) { return S.R.data(); }
inline double* parameter_block(Eigen::Vector3d& x) { return x.data(); }

/// The pose or similarity in a parameter block.
inline RigidTransform pose_from_block(const double* block) {
  return {Eigen::Map<const Eigen::Matrix3d>(block), Eigen::Map<const Eigen::Vector3d>(block + 9)};
}
inline Similarity similarity_from_block(const double* block) {
  return {block[12], Eigen::Map<const Eigen::Matrix3d>(block),
          Eigen::Map<const Eigen::Vector3d>(block + 9)};
}

namespace detail {

template <int Rows, int Cols>
using RowMajor = Eigen::Matrix<double, Rows, Cols, (Cols == 1 ? Eigen::ColMajor : Eigen::RowMajor)>;

template <int Rows, int Cols>
Eigen::Map<RowMajor<Rows, Cols>> map(double* data) {
  return Eigen::Map<RowMajor<Rows, Cols>>(data);
}

// Derivative of the block by the left perturbation, and of the left perturbation by the block, for
// a rotation (columns first) and translation; scale as the 13th.
template <int Block, int Tangent>
void plus_jacobian(const double* x, double* jacobian) {
  auto J = map<Block, Tangent>(jacobian);
  J.setZero();
  for (int c = 0; c < 4; ++c)
    J.template block<3, 3>(3 * c, 3) = -skew(Eigen::Map<const Eigen::Vector3d>(x + 3 * c));
  J.template block<3, 3>(9, 0).setIdentity();
  if constexpr (Tangent == 7) {
    J.template block<3, 1>(9, 6) = Eigen::Map<const Eigen::Vector3d>(x + 9);
    J(12, 6) = x[12];
  }
}

template <int Block, int Tangent>
Eigen::Matrix<double, Tangent, Block> minus_jacobian(const double* x) {
  Eigen::Matrix<double, Tangent, Block> J;
  J.setZero();
  // omega = 1/2 sum over columns of r x dr, as sum r x (omega x r) = 2 omega.
  for (int c = 0; c < 3; ++c)
    J.template block<3, 3>(3, 3 * c) = 0.5 * skew(Eigen::Map<const Eigen::Vector3d>(x + 3 * c));
  const Eigen::Vector3d t = Eigen::Map<const Eigen::Vector3d>(x + 9);
  J.template block<3, 3>(0, 9).setIdentity();
  J.template topRows<3>() += skew(t) * J.template middleRows<3>(3);
  if constexpr (Tangent == 7) {
    J(6, 12) = 1.0 / x[12];
    J.template topRows<3>() -= t * J.row(6);
  }
  return J;
}

inline void apply(const double* x, const double* delta, double* out, const RigidTransform*) {
  const RigidTransform T = se3_exp(Eigen::Map<const Vector6d>(delta)) * pose_from_block(x);
  Eigen::Map<Eigen::Matrix3d>(out, 3, 3) = T.R;
  Eigen::Map<Eigen::Vector3d>(out + 9, 3) = T.t;
}
inline void apply(const double* x, const double* delta, double* out, const Similarity*) {
  const Similarity S = sim3_exp(Eigen::Map<const Vector7d>(delta)) * similarity_from_block(x);
  Eigen::Map<Eigen::Matrix3d>(out, 3, 3) = S.R;
  Eigen::Map<Eigen::Vector3d>(out + 9, 3) = S.t;
  out[12] = S.s;
}
inline Vector6d difference(const double* y, const double* x, const RigidTransform*) {
  return se3_log(pose_from_block(y) * pose_from_block(x).inverse());
}
inline Vector7d difference(const double* y, const double* x, const Similarity*) {
  return sim3_log(similarity_from_block(y) * similarity_from_block(x).inverse());
}

#if DYNSLAM_CERES_HAS_MANIFOLD
using ManifoldBase = ceres::Manifold;
#else
using ManifoldBase = ceres::LocalParameterization;
#endif

template <typename Group, int Block, int Tangent>
class GroupManifold final : public ManifoldBase {
 public:
  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override {
    apply(x, delta, x_plus_delta, static_cast<const Group*>(nullptr));
    return true;
  }
#if DYNSLAM_CERES_HAS_MANIFOLD
  int AmbientSize() const override { return Block; }
  int TangentSize() const override { return Tangent; }
  bool PlusJacobian(const double* x, double* jacobian) const override {
    plus_jacobian<Block, Tangent>(x, jacobian);
    return true;
  }
  bool Minus(const double* y, const double* x, double* y_minus_x) const override {
    Eigen::Map<Eigen::Matrix<double, Tangent, 1>>(y_minus_x, Tangent) =
        difference(y, x, static_cast<const Group*>(nullptr));
    return true;
  }
  bool MinusJacobian(const double* x, double* jacobian) const override {
    map<Tangent, Block>(jacobian) = minus_jacobian<Block, Tangent>(x);
    return true;
  }
#else
  int GlobalSize() const override { return Block; }
  int LocalSize() const override { return Tangent; }
  bool ComputeJacobian(const double* x, double* jacobian) const override {
    plus_jacobian<Block, Tangent>(x, jacobian);
    return true;
  }
#endif
};

// Derivative of r(R X + t) by the 12 doubles of (R, t), from P = dr / d(R X + t).
template <int Rows, typename P>
void fill_pose_block(const P& by_point_in_camera, const Eigen::Vector3d& X, double* jacobian) {
  auto J = map<Rows, kPoseBlock>(jacobian);
  for (int c = 0; c < 3; ++c) J.template middleCols<3>(3 * c) = X[c] * by_point_in_camera;
  J.template rightCols<3>() = by_point_in_camera;
}

// What a point behind the camera counts: constant, so that it pulls at nothing.
inline constexpr double kBehindResidual = 1000.0;

}  // namespace detail

/// SE(3) with left perturbation exp(xi) T on blocks of 12, Sim(3) on blocks of 13.
using PoseManifold = detail::GroupManifold<RigidTransform, kPoseBlock, 6>;
using SimilarityManifold = detail::GroupManifold<Similarity, kSimilarityBlock, 7>;

/// Adds a pose to a problem with its manifold, whichever Ceres this is. The problem owns it unless
/// told otherwise in its options.
inline void add_pose_block(ceres::Problem& problem, RigidTransform& T) {
  problem.AddParameterBlock(parameter_block(T), kPoseBlock, new PoseManifold);
}
inline void add_similarity_block(ceres::Problem& problem, Similarity& S) {
  problem.AddParameterBlock(parameter_block(S), kSimilarityBlock, new SimilarityManifold);
}
/// Adds a static weight with its bounds [0, 1].
inline void add_weight_block(ceres::Problem& problem, double& phi) {
  problem.AddParameterBlock(&phi, 1);
  problem.SetParameterLowerBound(&phi, 0, 0.0);
  problem.SetParameterUpperBound(&phi, 0, 1.0);
}

namespace detail {

// Residual and Jacobians for blocks (pose, point, weight?); shared by the two cost functions.
template <int Rows>
struct ReprojectionData {
  DepthCamera camera;
  Eigen::Matrix<double, Rows, 1> measured;
  Eigen::Matrix<double, Rows, Rows> sqrt_information;

  bool evaluate(const double* pose, const double* point, double phi, double* residuals,
                double* by_pose, double* by_point, double* by_weight) const {
    const RigidTransform T = pose_from_block(pose);
    const Eigen::Vector3d X = Eigen::Map<const Eigen::Vector3d>(point);
    Eigen::Matrix<double, Rows, 1> e, whitened;
    Eigen::Matrix<double, Rows, 3> J_point;
    ReprojectionJacobians<Rows> wanted;
    if (by_pose || by_point) wanted.point = &J_point;
    if (by_weight) wanted.weight = &whitened;
    if (!weighted_reprojection<Rows>(camera, T, X, measured, sqrt_information, phi, e, wanted)) {
      e.setConstant(phi * kBehindResidual / std::sqrt(double{Rows}));
      J_point.setZero();
      whitened.setConstant(kBehindResidual / std::sqrt(double{Rows}));
    }
    map<Rows, 1>(residuals) = e;
    if (by_point) map<Rows, 3>(by_point) = J_point;
    if (by_pose) fill_pose_block<Rows>((J_point * T.R.transpose()).eval(), X, by_pose);
    if (by_weight) map<Rows, 1>(by_weight) = whitened;
    return true;
  }
};

}  // namespace detail

/// phi S^-1/2 (p - pi(T X)) with a given weight; blocks: pose 12, point 3. Rows as in
/// `weighted_reprojection`. A point behind the camera is a constant residual of 1000 sigma.
template <int Rows>
class ReprojectionCost final : public ceres::SizedCostFunction<Rows, kPoseBlock, 3> {
 public:
  ReprojectionCost(const DepthCamera& camera, const Eigen::Matrix<double, Rows, 1>& measured,
                   const Eigen::Matrix<double, Rows, Rows>& sqrt_information, double phi = 1.0)
      : data_{camera, measured, sqrt_information}, phi_(phi) {}
  bool Evaluate(double const* const* x, double* residuals, double** J) const override {
    return data_.evaluate(x[0], x[1], phi_, residuals, J ? J[0] : nullptr, J ? J[1] : nullptr,
                          nullptr);
  }

 private:
  detail::ReprojectionData<Rows> data_;
  double phi_;
};

/// The same with the weight as a parameter; blocks: pose 12, point 3, weight 1. Belongs together
/// with a WeightPriorCost on the same weight.
template <int Rows>
class WeightedReprojectionCost final : public ceres::SizedCostFunction<Rows, kPoseBlock, 3, 1> {
 public:
  WeightedReprojectionCost(const DepthCamera& camera,
                           const Eigen::Matrix<double, Rows, 1>& measured,
                           const Eigen::Matrix<double, Rows, Rows>& sqrt_information)
      : data_{camera, measured, sqrt_information} {}
  bool Evaluate(double const* const* x, double* residuals, double** J) const override {
    return data_.evaluate(x[0], x[1], *x[2], residuals, J ? J[0] : nullptr, J ? J[1] : nullptr,
                          J ? J[2] : nullptr);
  }

 private:
  detail::ReprojectionData<Rows> data_;
};

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
