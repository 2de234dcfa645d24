#include "dynslam/slam/triangulation.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include "dynslam/core/errors.hpp"

namespace dynslam::slam {
namespace {

constexpr double kDegreesPerRadian = 180.0 / 3.14159265358979323846;
constexpr int kRefinements = 3;  // Gauss-Newton steps; the third changes the tenth digit

// Least squares of x_k z - X = 0 in both cameras, in the frame of the first.
Eigen::Vector3d linear_point(const Eigen::Vector3d& ray_first, const Eigen::Vector3d& ray_second,
                             const RigidTransform& T_second_first) {
  Eigen::Matrix<double, 4, 3> A;
  Eigen::Vector4d b;
  for (int i = 0; i < 2; ++i) {
    A.row(i) = Eigen::Vector3d::Unit(i).transpose();
    A(i, 2) -= ray_first[i];
    b[i] = 0.0;
    A.row(2 + i) = T_second_first.R.row(i) - ray_second[i] * T_second_first.R.row(2);
    b[2 + i] = ray_second[i] * T_second_first.t.z() - T_second_first.t[i];
  }
  return (A.transpose() * A).ldlt().solve(A.transpose() * b);
}

struct Reprojection {
  Eigen::Vector2d error;
  Eigen::Matrix<double, 2, 3> jacobian;
};

Reprojection reproject(const PinholeCamera& camera, const RigidTransform& T,
                       const PointSighting& seen, const Eigen::Vector3d& X) {
  const Eigen::Vector3d in_camera = T * X;
  return {(seen.pixel - camera.project(in_camera)) / seen.scale,
          camera.project_jacobian(in_camera) * T.R / seen.scale};
}

}  // namespace

void TriangulationOptions::validate() const {
  constexpr const char* kName = "TriangulationOptions";
  require(min_parallax_deg > 0.0 && min_parallax_deg < 90.0, kName, "min_parallax_deg",
          min_parallax_deg, "an angle in (0, 90) degrees");
  require(max_chi2 > 0.0, kName, "max_chi2", max_chi2, "a positive number");
  require(max_scale_factor == 0.0 || max_scale_factor >= 1.0, kName, "max_scale_factor",
          max_scale_factor, "at least 1, or 0");
}

const char* to_string(TriangulationStatus status) {
  switch (status) {
    case TriangulationStatus::kOk:
      return "Ok";
    case TriangulationStatus::kTooLittleParallax:
      return "TooLittleParallax";
    case TriangulationStatus::kBehindCamera:
      return "BehindCamera";
    case TriangulationStatus::kLargeError:
      return "LargeError";
    case TriangulationStatus::kScalesDisagree:
      return "ScalesDisagree";
    case TriangulationStatus::kNotFinite:
      return "NotFinite";
  }
  return "";
}

TriangulatedPoint triangulate(const PinholeCamera& camera, const PointSighting& first,
                              const PointSighting& second, const TriangulationOptions& options) {
  TriangulatedPoint point;
  const RigidTransform T_world_first = first.T_cam_world.inverse();
  const RigidTransform T_second_first = second.T_cam_world * T_world_first;
  if (!T_second_first.all_finite() || !first.pixel.allFinite() || !second.pixel.allFinite()) {
    return point;
  }
  const Eigen::Vector3d ray_first = camera.bearing(first.pixel);
  const Eigen::Vector3d ray_second = camera.bearing(second.pixel);
  const Eigen::Vector3d turned = T_second_first.R * ray_first;
  point.parallax_deg =
      std::atan2(turned.cross(ray_second).norm(), turned.dot(ray_second)) * kDegreesPerRadian;
  point.status = TriangulationStatus::kTooLittleParallax;
  if (!(point.parallax_deg >= options.min_parallax_deg)) return point;

  point.status = TriangulationStatus::kBehindCamera;
  Eigen::Vector3d X = linear_point(ray_first, ray_second, T_second_first);
  for (int i = 0; i <= kRefinements; ++i) {
    if (!PinholeCamera::in_domain(X) || !PinholeCamera::in_domain(T_second_first * X)) return point;
    const Reprojection a = reproject(camera, RigidTransform(), first, X);
    const Reprojection b = reproject(camera, T_second_first, second, X);
    if (i == kRefinements) {
      point.status = TriangulationStatus::kLargeError;
      if (!(std::max(a.error.squaredNorm(), b.error.squaredNorm()) <= options.max_chi2)) {
        return point;
      }
      break;
    }
    const Eigen::Matrix3d H =
        a.jacobian.transpose() * a.jacobian + b.jacobian.transpose() * b.jacobian;
    X += H.ldlt().solve(a.jacobian.transpose() * a.error + b.jacobian.transpose() * b.error);
  }
  point.position = T_world_first * X;
  point.status = TriangulationStatus::kScalesDisagree;
  if (options.max_scale_factor > 0.0) {
    // What looks the same has the same size: scale times distance is constant.
    const double ratio = (second.scale * (T_second_first * X).norm()) / (first.scale * X.norm());
    if (ratio > options.max_scale_factor || ratio * options.max_scale_factor < 1.0) return point;
  }
  point.status = TriangulationStatus::kOk;
  return point;
}

}  // namespace dynslam::slam
