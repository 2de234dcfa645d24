// Poses and similarities as Ceres parameter blocks with their manifolds. Ceres 2.0 to 2.2.
//
// Parameter blocks are the host's own objects: a RigidTransform is a block of 12 doubles (R column
// by column, then t), a Similarity one of 13 (R, t, s), a point 3, a static weight 1. Jacobians
// are true derivatives by these doubles, so ceres::GradientChecker agrees with them.
#pragma once

#include <Eigen/Core>
#include <ceres/problem.h>
#include <ceres/version.h>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/factors/similarity.hpp"

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

}  // namespace dynslam::factors
