// Weighted reprojection residuals and their analytic Jacobians, as plain functions.
//
// No solver appears here: the same functions feed Ceres (factors/ceres.hpp), g2o or GTSAM
// (docs/components/factors.md shows both) and dynslam's own optimizers are tested against them.
#pragma once

#include <algorithm>
#include <cmath>
#include <type_traits>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/errors.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/so3.hpp"

namespace dynslam::factors {

/// Lens without distortion.
struct NoDistortion {
  /// Identity on normalized image coordinates (x/z, y/z).
  Eigen::Vector2d distort(const Eigen::Vector2d& xy, Eigen::Matrix2d* J = nullptr) const {
    if (J) J->setIdentity();
    return xy;
  }
};

/// Radial-tangential (Brown-Conrady) lens in OpenCV's order k1 k2 p1 p2 k3, on normalized image
/// coordinates: x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), y alike.
struct RadialTangentialDistortion {
  double k1 = 0.0, k2 = 0.0, p1 = 0.0, p2 = 0.0, k3 = 0.0;

  /// Distorted normalized coordinates and, where asked for, their derivative. O(1).
  Eigen::Vector2d distort(const Eigen::Vector2d& xy, Eigen::Matrix2d* J = nullptr) const {
    const double x = xy.x(), y = xy.y(), r2 = x * x + y * y;
    const double radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    if (J) {
      const double slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3));  // d radial / d(r^2) * 2
      const double mixed = slope * x * y + 2.0 * (p1 * x + p2 * y);
      *J << radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x, mixed,  //
          mixed, radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x;
    }
    return {x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y};
  }
};

/// Standard deviation of a keypoint found at a level of an image pyramid, pixels:
/// sigma0 * scale_factor^octave. Source: engineering (the field's habit: 1.2, sigma0 = 1).
inline double pyramid_sigma(int octave, double scale_factor = 1.2, double sigma0 = 1.0) {
  return sigma0 * std::pow(scale_factor, octave);
}

/// Standard deviation of a Kinect-style depth z (metres): 0.0012 + 0.0019 (z - 0.4)^2.
/// Source: Nguyen, Izadi, Lovell, 3DIMPVT 2012; theory.md section 4.
constexpr double kinect_depth_sigma(double z) { return 0.0012 + 0.0019 * (z - 0.4) * (z - 0.4); }

/// S^-1/2 of (u, v): 1/sigma on the diagonal.
inline Eigen::Matrix2d mono_sqrt_information(double sigma) {
  return Eigen::Matrix2d::Identity() / sigma;
}

/// S^-1/2 of (u, v, u_R) from two rectified images: three independent columns and rows.
inline Eigen::Matrix3d stereo_sqrt_information(double sigma) {
  return Eigen::Matrix3d::Identity() / sigma;
}

/// S^-1/2 of (u, v, u_R = u - bf/z) with a measured depth: u_R repeats the error of u and adds
/// that of the depth, sigma_d = bf / z^2 sigma_z; so the third row whitens u_R - u.
///
/// sigma in pixels, z and sigma_z in metres, all > 0.
inline Eigen::Matrix3d depth_sqrt_information(double sigma, double bf, double z, double sigma_z) {
  const double sigma_d = bf / (z * z) * sigma_z;
  Eigen::Matrix3d L = Eigen::Matrix3d::Identity() / sigma;
  L(2, 0) = -1.0 / sigma_d;
  L(2, 2) = 1.0 / sigma_d;
  return L;
}

/// Derivatives of `weighted_reprojection`, each filled when its pointer is set.
template <int Rows>
struct ReprojectionJacobians {
  static_assert(Rows == 2 || Rows == 3, "mono has 2 rows, stereo and RGB-D have 3");
  static constexpr int kIntrinsics = Rows == 2 ? 4 : 5;
  /// by the left perturbation [rho; omega] of T_cam_world
  Eigen::Matrix<double, Rows, 6>* pose = nullptr;
  /// by the point in world coordinates
  Eigen::Matrix<double, Rows, 3>* point = nullptr;
  /// by the static weight phi: the whitened residual itself
  Eigen::Matrix<double, Rows, 1>* weight = nullptr;
  /// by fx, fy, cx, cy (and bf for 3 rows)
  Eigen::Matrix<double, Rows, kIntrinsics>* intrinsics = nullptr;
};

namespace detail {

inline double right_baseline(const PinholeCamera&) { return 0.0; }
inline double right_baseline(const DepthCamera& camera) { return camera.bf; }

}  // namespace detail

/// Weighted reprojection residual e = phi S^-1/2 (p - pi(T_cam_world X)).
///
/// Rows = 2: p = (u, v), any camera. Rows = 3: p = (u, v, u_R) with a DepthCamera,
/// u_R = u - bf / z; with a distorted lens u is the distorted column, as measured.
/// `sqrt_information` is S^-1/2 (the functions above make it from pyramid level and depth noise).
/// Returns false and leaves outputs untouched when the point cannot be projected
/// (z <= kMinDepth or not finite). NaN in the measurement or weight goes into the residual.
/// O(1), no allocation. Source: theory.md section 5; P-Static section 4.
template <int Rows, typename Camera, typename Distortion = NoDistortion>
bool weighted_reprojection(const Camera& camera, const RigidTransform& T_cam_world,
                           const Eigen::Vector3d& point_world,
                           const Eigen::Matrix<double, Rows, 1>& measured,
                           const Eigen::Matrix<double, Rows, Rows>& sqrt_information, double phi,
                           Eigen::Matrix<double, Rows, 1>& residual,
                           const ReprojectionJacobians<Rows>& jacobians = {},
                           const Distortion& lens = {}) {
  static_assert(Rows == 2 || std::is_base_of_v<DepthCamera, Camera>,
                "three rows need a DepthCamera");
  const Eigen::Vector3d X = T_cam_world * point_world;
  if (!PinholeCamera::in_domain(X)) return false;
  const double inv_z = 1.0 / X.z();
  const Eigen::Vector2d xy = X.head<2>() * inv_z;
  Eigen::Matrix2d D;
  const bool derive = jacobians.pose || jacobians.point;
  const Eigen::Vector2d d = lens.distort(xy, derive ? &D : nullptr);

  Eigen::Matrix<double, Rows, 1> r;
  r[0] = measured[0] - (camera.fx * d.x() + camera.cx);
  r[1] = measured[1] - (camera.fy * d.y() + camera.cy);
  const double bf = detail::right_baseline(camera);
  if constexpr (Rows == 3) r[2] = measured[2] - (camera.fx * d.x() + camera.cx - bf * inv_z);
  const Eigen::Matrix<double, Rows, 1> whitened = sqrt_information * r;
  residual = phi * whitened;

  if (derive) {
    Eigen::Matrix<double, 2, 3> N;  // d(x/z, y/z) / dX
    N << inv_z, 0.0, -xy.x() * inv_z, 0.0, inv_z, -xy.y() * inv_z;
    Eigen::Matrix<double, Rows, 3> P;  // -phi S^-1/2 d pi / dX
    P.row(0) = camera.fx * (D.row(0) * N);
    P.row(1) = camera.fy * (D.row(1) * N);
    if constexpr (Rows == 3) {
      P.row(2) = P.row(0);
      P(2, 2) += bf * inv_z * inv_z;
    }
    P = (-phi * (sqrt_information * P)).eval();
    if (jacobians.pose) {
      jacobians.pose->template leftCols<3>() = P;
      jacobians.pose->template rightCols<3>() = -P * skew(X);
    }
    if (jacobians.point) *jacobians.point = P * T_cam_world.R;
  }
  if (jacobians.weight) *jacobians.weight = whitened;
  if (jacobians.intrinsics) {
    Eigen::Matrix<double, Rows, ReprojectionJacobians<Rows>::kIntrinsics> K;
    K.setZero();
    K(0, 0) = -d.x();
    K(0, 2) = -1.0;
    K(1, 1) = -d.y();
    K(1, 3) = -1.0;
    if constexpr (Rows == 3) {
      K.row(2) = K.row(0);
      K(2, 4) = inv_z;
    }
    *jacobians.intrinsics = phi * (sqrt_information * K);
  }
  return true;
}

/// Prior on a static weight as a residual: sqrt(lambda) (phi - phi0); its derivative is
/// sqrt(lambda).
inline double weight_prior_residual(double phi, double phi0, double lambda) {
  return std::sqrt(lambda) * (phi - phi0);
}

}  // namespace dynslam::factors
