// The weighted reprojection factor as Ceres cost functions: fixed or free weight, lens, intrinsics.
// Included by factors/ceres.hpp. Works with Ceres 2.0 to 2.2.
#pragma once

#include <cmath>

#include <Eigen/Core>
#include <ceres/sized_cost_function.h>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/factors/ceres_manifolds.hpp"
#include "dynslam/factors/weighted_reprojection.hpp"

namespace dynslam::factors {

/// Doubles of the intrinsics as a parameter block: fx, fy, cx, cy for 2 rows, and bf for 3.
template <int Rows>
inline constexpr int kIntrinsicsBlock = ReprojectionJacobians<Rows>::kIntrinsics;

/// The intrinsics of a camera as a parameter block (`.data()`).
template <int Rows>
Eigen::Matrix<double, kIntrinsicsBlock<Rows>, 1> intrinsics_block(const DepthCamera& camera) {
  Eigen::Matrix<double, kIntrinsicsBlock<Rows>, 1> block;
  block.template head<4>() << camera.fx, camera.fy, camera.cx, camera.cy;
  if constexpr (Rows == 3) block[4] = camera.bf;
  return block;
}

/// Writes an optimized block of intrinsics back; size, and bf for 2 rows, stay as they are.
template <int Rows>
void set_intrinsics(const Eigen::Matrix<double, kIntrinsicsBlock<Rows>, 1>& block,
                    DepthCamera& camera) {
  camera.fx = block[0], camera.fy = block[1], camera.cx = block[2], camera.cy = block[3];
  if constexpr (Rows == 3) camera.bf = block[4];
}

namespace detail {

// What a point behind the camera counts: constant, so that it pulls at nothing.
inline constexpr double kBehindResidual = 1000.0;

// Derivative of r(R X + t) by the 12 doubles of (R, t), from P = dr / d(R X + t).
template <int Rows, typename P>
void fill_pose_block(const P& by_point_in_camera, const Eigen::Vector3d& X, double* jacobian) {
  auto J = map<Rows, kPoseBlock>(jacobian);
  for (int c = 0; c < 3; ++c) J.template middleCols<3>(3 * c) = X[c] * by_point_in_camera;
  J.template rightCols<3>() = by_point_in_camera;
}

// Residual and Jacobians by whatever blocks are asked for; shared by the cost functions below.
template <int Rows, typename Distortion>
struct ReprojectionData {
  DepthCamera camera;
  Eigen::Matrix<double, Rows, 1> measured;
  Eigen::Matrix<double, Rows, Rows> sqrt_information;
  Distortion lens;

  struct Outputs {
    double* pose = nullptr;
    double* point = nullptr;
    double* weight = nullptr;
    double* intrinsics = nullptr;
  };

  bool evaluate(const DepthCamera& seen_by, const double* pose, const double* point, double phi,
                double* residuals, const Outputs& by) const {
    const RigidTransform T = pose_from_block(pose);
    const Eigen::Vector3d X = Eigen::Map<const Eigen::Vector3d>(point);
    Eigen::Matrix<double, Rows, 1> e, whitened;
    Eigen::Matrix<double, Rows, 3> J_point;
    Eigen::Matrix<double, Rows, kIntrinsicsBlock<Rows>> J_intrinsics;
    ReprojectionJacobians<Rows> wanted;
    if (by.pose || by.point) wanted.point = &J_point;
    if (by.weight) wanted.weight = &whitened;
    if (by.intrinsics) wanted.intrinsics = &J_intrinsics;
    if (!weighted_reprojection<Rows>(seen_by, T, X, measured, sqrt_information, phi, e, wanted,
                                     lens)) {
      whitened.setConstant(kBehindResidual / std::sqrt(double{Rows}));
      e = phi * whitened;
      J_point.setZero();
      J_intrinsics.setZero();
    }
    map<Rows, 1>(residuals) = e;
    if (by.point) map<Rows, 3>(by.point) = J_point;
    if (by.pose) fill_pose_block<Rows>((J_point * T.R.transpose()).eval(), X, by.pose);
    if (by.weight) map<Rows, 1>(by.weight) = whitened;
    if (by.intrinsics) map<Rows, kIntrinsicsBlock<Rows>>(by.intrinsics) = J_intrinsics;
    return true;
  }
};

}  // namespace detail

/// phi S^-1/2 (p - pi(T X)) with a given weight; blocks: pose 12, point 3.
///
/// Rows, `measured` and `sqrt_information` as in `weighted_reprojection`; with a `Distortion` the
/// measured pixels are the distorted ones. A point behind the camera is a constant residual of
/// 1000 sigma. All costs of this header: O(1), no allocation in Evaluate, thread-safe.
template <int Rows, typename Distortion = NoDistortion>
class ReprojectionCost final : public ceres::SizedCostFunction<Rows, kPoseBlock, 3> {
 public:
  ReprojectionCost(const DepthCamera& camera, const Eigen::Matrix<double, Rows, 1>& measured,
                   const Eigen::Matrix<double, Rows, Rows>& sqrt_information, double phi = 1.0,
                   const Distortion& lens = {})
      : data_{camera, measured, sqrt_information, lens}, phi_(phi) {}
  bool Evaluate(double const* const* x, double* residuals, double** J) const override {
    typename detail::ReprojectionData<Rows, Distortion>::Outputs by;
    if (J) by.pose = J[0], by.point = J[1];
    return data_.evaluate(data_.camera, x[0], x[1], phi_, residuals, by);
  }

 private:
  detail::ReprojectionData<Rows, Distortion> data_;
  double phi_;
};

/// The same with the weight as a parameter; blocks: pose 12, point 3, weight 1. Belongs together
/// with a WeightPriorCost on the same weight.
template <int Rows, typename Distortion = NoDistortion>
class WeightedReprojectionCost final : public ceres::SizedCostFunction<Rows, kPoseBlock, 3, 1> {
 public:
  WeightedReprojectionCost(const DepthCamera& camera,
                           const Eigen::Matrix<double, Rows, 1>& measured,
                           const Eigen::Matrix<double, Rows, Rows>& sqrt_information,
                           const Distortion& lens = {})
      : data_{camera, measured, sqrt_information, lens} {}
  bool Evaluate(double const* const* x, double* residuals, double** J) const override {
    typename detail::ReprojectionData<Rows, Distortion>::Outputs by;
    if (J) by.pose = J[0], by.point = J[1], by.weight = J[2];
    return data_.evaluate(data_.camera, x[0], x[1], *x[2], residuals, by);
  }

 private:
  detail::ReprojectionData<Rows, Distortion> data_;
};

/// ReprojectionCost with the intrinsics as a parameter, shared by all keyframes of a camera;
/// blocks: pose 12, point 3, intrinsics 4 (2 rows) or 5 (3 rows), see `intrinsics_block`.
///
/// Evaluation fails, and Ceres shortens its step, where fx, fy or bf is not positive. A static
/// weight goes over it in closed form, EliminatedWeightLoss.
template <int Rows, typename Distortion = NoDistortion>
class IntrinsicsReprojectionCost final
    : public ceres::SizedCostFunction<Rows, kPoseBlock, 3, kIntrinsicsBlock<Rows>> {
 public:
  IntrinsicsReprojectionCost(const Eigen::Matrix<double, Rows, 1>& measured,
                             const Eigen::Matrix<double, Rows, Rows>& sqrt_information,
                             double phi = 1.0, const Distortion& lens = {})
      : data_{{}, measured, sqrt_information, lens}, phi_(phi) {}
  bool Evaluate(double const* const* x, double* residuals, double** J) const override {
    DepthCamera camera;
    set_intrinsics<Rows>(Eigen::Map<const Eigen::Matrix<double, kIntrinsicsBlock<Rows>, 1>>(x[2]),
                         camera);
    if (!(camera.fx > 0.0) || !(camera.fy > 0.0) || !(camera.bf > 0.0)) return false;
    typename detail::ReprojectionData<Rows, Distortion>::Outputs by;
    if (J) by.pose = J[0], by.point = J[1], by.intrinsics = J[2];
    return data_.evaluate(camera, x[0], x[1], phi_, residuals, by);
  }

 private:
  detail::ReprojectionData<Rows, Distortion> data_;
  double phi_;
};

}  // namespace dynslam::factors
