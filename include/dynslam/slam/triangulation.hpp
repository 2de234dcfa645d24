// A point of the world from two sightings of it.
#pragma once

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"

namespace dynslam::slam {

/// One camera's sight of a point.
struct PointSighting {
  RigidTransform T_cam_world;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double scale = 1.0;  ///< side of the feature's pyramid level in pixels: its standard deviation
};

/// What a triangulated point must pass.
struct TriangulationOptions {
  /// Least angle between the two rays, degrees, > 0. With noise sigma the depth is uncertain by
  /// about sigma / (f sin(angle)). Engineering: 1.15 (cosine 0.9998), the field's habit.
  double min_parallax_deg = 1.15;
  /// Bound on the squared reprojection error in each image over the squared scale, > 0: 95 % of
  /// chi^2 with 2 degrees of freedom.
  double max_chi2 = 5.991;
  /// Most that the ratio of the two distances and the ratio of the two scales may differ by, as a
  /// factor, >= 1: a thing looks smaller from farther away. 0 switches the test off. Engineering:
  /// 1.5 for a slanted surface, times a level of 1.2.
  double max_scale_factor = 1.8;

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// What became of a pair of sightings.
enum class TriangulationStatus {
  kOk,
  kTooLittleParallax,  ///< the rays are as good as parallel: the depth is anybody's guess
  kBehindCamera,       ///< the rays meet behind one of the cameras
  kLargeError,         ///< the point does not project to where it was seen: no match
  kScalesDisagree,     ///< it looks larger where it is farther away: no match
  kNotFinite,          ///< a pixel or a pose is not finite
};

/// "Ok" etc.
const char* to_string(TriangulationStatus status);

/// Result of `triangulate`.
struct TriangulatedPoint {
  TriangulationStatus status = TriangulationStatus::kNotFinite;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< world; of meaning when ok()
  double parallax_deg = 0.0;                           ///< between the rays

  bool ok() const { return status == TriangulationStatus::kOk; }
};

/// The point nearest to two sightings: linear start, then Gauss-Newton on both reprojection errors,
///   min_X  sum_k |pixel_k - pi(T_k X)|^2 / scale_k^2,
/// and the tests of TriangulationOptions in the order of TriangulationStatus.
///
/// The options are taken as valid (see `validate`). O(1), no allocation, thread-safe.
/// Source: Hartley, Zisserman, *Multiple View Geometry*, chapter 12.
TriangulatedPoint triangulate(const PinholeCamera& camera, const PointSighting& first,
                              const PointSighting& second,
                              const TriangulationOptions& options = {});

}  // namespace dynslam::slam
