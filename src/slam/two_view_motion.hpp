// How well a motion between two images explains their matches, and how well they determine it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/slam/triangulation.hpp"
#include "dynslam/slam/two_view.hpp"

namespace dynslam::slam {

inline constexpr double kChi2Line = 3.841;   // 95 % of chi^2, 1 degree of freedom
inline constexpr double kChi2Pixel = 5.991;  // 2 degrees of freedom

struct PixelMatch {
  Eigen::Vector2d first, second;
  double first_scale = 1.0, second_scale = 1.0;
  std::size_t column = 0;
};

/// A motion between two views and the points that speak for it.
struct TwoViewMotion {
  RigidTransform T_second_first;          ///< |t| = 1
  std::vector<TriangulatedPoint> points;  ///< by match
  std::size_t good = 0;                   ///< with enough parallax, in front, small errors
  std::size_t explained = 0;              ///< on their lines, with parallax or without
  std::size_t contrary = 0;               ///< with enough parallax, but behind a camera
  std::size_t wide = 0;                   ///< good ones with min_parallax_deg
  double likelihood = 0.0;                ///< sum of truncated squared errors that it avoids
};

/// Squared distance of the second pixel from the first one's line under F, pixels^2.
double squared_line_distance(const Eigen::Matrix3d& F, const Eigen::Vector2d& first,
                             const Eigen::Vector2d& second);

/// K^-T [t]x R K^-1.
Eigen::Matrix3d fundamental_matrix(const PinholeCamera& camera,
                                   const RigidTransform& T_second_first);

/// Triangulates the matches under a motion and counts what they say of it.
TwoViewMotion judge_motion(const PinholeCamera& camera, const std::vector<PixelMatch>& matches,
                           const RigidTransform& T_second_first, const TwoViewOptions& options);

/// Bundle adjustment of both views over the good points, the first view held; judged anew. Returns
/// the motion as it was when that fails.
TwoViewMotion refine_motion(const PinholeCamera& camera, const std::vector<PixelMatch>& matches,
                            const TwoViewMotion& motion, const TwoViewOptions& options);

/// Standard deviation of the direction of translation, degrees, by the curvature of the bundle at
/// its optimum (points marginalized, length of the translation fixed).
double direction_uncertainty_deg(const PinholeCamera& camera,
                                 const std::vector<PixelMatch>& matches,
                                 const TwoViewMotion& motion);

}  // namespace dynslam::slam
