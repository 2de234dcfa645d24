// Cameras: pinhole, and pinhole with metric depth (RGB-D or rectified stereo).
#pragma once

#include <cmath>
#include <optional>

#include <Eigen/Core>

#include "dynslam/core/errors.hpp"

namespace dynslam {

/// Points nearer than this to the camera plane are outside the domain of
/// projection (metres).
inline constexpr double kMinDepth = 1e-3;

/// Pinhole without distortion. Pixels; the centre of the upper left pixel is
/// (0, 0); the camera looks along +z, x to the right, y down.
struct PinholeCamera {
  double fx = 0.0;  ///< pixels, > 0
  double fy = 0.0;  ///< pixels, > 0
  double cx = 0.0;  ///< pixels
  double cy = 0.0;  ///< pixels
  int width = 0;    ///< pixels, > 0
  int height = 0;   ///< pixels, > 0

  /// Throws InvalidArgument naming the parameter that breaks its rule.
  void validate() const {
    require(std::isfinite(fx) && fx > 0.0, "PinholeCamera", "fx", fx, "a positive number");
    require(std::isfinite(fy) && fy > 0.0, "PinholeCamera", "fy", fy, "a positive number");
    require(std::isfinite(cx), "PinholeCamera", "cx", cx, "a finite number");
    require(std::isfinite(cy), "PinholeCamera", "cy", cy, "a finite number");
    require(width > 0, "PinholeCamera", "width", width, "a positive number of pixels");
    require(height > 0, "PinholeCamera", "height", height, "a positive number of pixels");
  }

  /// Whether a point in camera coordinates can be projected at all (z > 1 mm,
  /// finite).
  static bool in_domain(const Eigen::Vector3d& X) { return X.z() > kMinDepth && X.allFinite(); }

  /// Image of a point in camera coordinates; the caller ensures `in_domain(X)`.
  Eigen::Vector2d project(const Eigen::Vector3d& X) const {
    const double inv_z = 1.0 / X.z();
    return {fx * X.x() * inv_z + cx, fy * X.y() * inv_z + cy};
  }

  /// Derivative of `project` with respect to X, 2 x 3.
  Eigen::Matrix<double, 2, 3> project_jacobian(const Eigen::Vector3d& X) const {
    const double inv_z = 1.0 / X.z();
    Eigen::Matrix<double, 2, 3> J;
    J << fx * inv_z, 0.0, -fx * X.x() * inv_z * inv_z,  //
        0.0, fy * inv_z, -fy * X.y() * inv_z * inv_z;
    return J;
  }

  /// Image of X if it is in front of the camera and inside the image by
  /// `border` pixels.
  std::optional<Eigen::Vector2d> project_into_image(const Eigen::Vector3d& X,
                                                    double border = 0.0) const {
    if (!in_domain(X)) return std::nullopt;
    const Eigen::Vector2d p = project(X);
    if (!contains(p, border)) return std::nullopt;
    return p;
  }

  /// Whether pixel coordinates lie in the image, `border` pixels from its edge.
  /// NaN does not.
  bool contains(const Eigen::Vector2d& p, double border = 0.0) const {
    return p.x() >= border && p.y() >= border && p.x() <= width - 1 - border &&
           p.y() <= height - 1 - border;
  }

  /// Ray through a pixel with z = 1 (not a unit vector).
  Eigen::Vector3d bearing(const Eigen::Vector2d& p) const {
    return {(p.x() - cx) / fx, (p.y() - cy) / fy, 1.0};
  }

  /// Point at depth z (metres along the optical axis) seen at pixel p, in
  /// camera coordinates.
  Eigen::Vector3d unproject(const Eigen::Vector2d& p, double z) const { return z * bearing(p); }
};

/// Pinhole that measures depth as well. Depth enters residuals as the column at
/// which a right camera `baseline` metres to the right would see the point: u_R
/// = u - bf / z, bf = fx * baseline. For RGB-D the baseline is virtual (0.076 m
/// for bf = 40 at fx = 525).
struct DepthCamera : PinholeCamera {
  double bf = 40.0;  ///< pixel metres, > 0

  void validate() const {
    PinholeCamera::validate();
    require(std::isfinite(bf) && bf > 0.0, "DepthCamera", "bf", bf, "a positive number");
  }

  double baseline() const { return bf / fx; }

  /// u_R of a point seen at column u at depth z > 0.
  double right_column(double u, double z) const { return u - bf / z; }

  /// (u, v, u_R) of a point in camera coordinates; the caller ensures
  /// `in_domain(X)`.
  Eigen::Vector3d project3(const Eigen::Vector3d& X) const {
    const Eigen::Vector2d p = project(X);
    return {p.x(), p.y(), p.x() - bf / X.z()};
  }

  /// Derivative of `project3` with respect to X, 3 x 3.
  Eigen::Matrix3d project3_jacobian(const Eigen::Vector3d& X) const {
    Eigen::Matrix3d J;
    J.topRows<2>() = project_jacobian(X);
    J.row(2) = J.row(0);
    J(2, 2) += bf / (X.z() * X.z());
    return J;
  }
};

}  // namespace dynslam
