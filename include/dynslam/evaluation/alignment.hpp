// The transform that lays an estimated trajectory over the true one.
#pragma once

#include <cstddef>
#include <string_view>

#include "dynslam/core/points.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/trajectory.hpp"

namespace dynslam::evaluation {

/// What may be changed about the estimate before it is compared.
enum class Alignment {
  kNone,  ///< nothing
  kSE3,   ///< rotation and translation (RGB-D, stereo)
  kSim3,  ///< and scale (monocular)
};

/// "none", "se3", "sim3".
std::string_view to_string(Alignment alignment);

/// How well the points determine the transform.
enum class AlignmentStatus {
  kOk,         ///< unique
  kNotAsked,   ///< Alignment::kNone, identity
  kNoPoints,   ///< identity
  kNoExtent,   ///< one point, or all points equal on one side: translation of the centroids only
  kCollinear,  ///< two points or a straight line: the smallest rotation that lays line on line
};

std::string_view to_string(AlignmentStatus status);

/// x -> scale * (T.R x) + T.t
struct Similarity {
  double scale = 1.0;
  RigidTransform T;

  Eigen::Vector3d operator*(const Eigen::Vector3d& x) const { return scale * (T.R * x) + T.t; }
  /// Of a pose: the position moves as a point, the orientation turns with R.
  RigidTransform operator*(const RigidTransform& pose) const {
    return {T.R * pose.R, (*this) * pose.t};
  }
};

/// Result of `align_points`.
struct AlignmentResult {
  Similarity truth_from_estimate;  ///< takes estimated points to true ones
  AlignmentStatus status = AlignmentStatus::kNotAsked;
  std::size_t points = 0;  ///< how many were used
};

/// Finds the transform S that minimizes sum_i |truth_i - S estimate_i|^2.
///
/// With the covariance C = 1/n sum (truth_i - mean)(estimate_i - mean)^T = U D V^T and
/// F = diag(1, 1, det(U) det(V)): R = U F V^T, scale = tr(D F) / var(estimate) (1 for kSE3),
/// t = mean(truth) - scale R mean(estimate).
///
/// Where points do not determine S the result is still defined and `status` says so, see
/// AlignmentStatus; a second singular value under 1e-10 of the first counts as a straight line. In
/// kNoExtent the scale is 1. Throws InvalidArgument for different counts and for points that are
/// not finite. O(n), no allocation. Thread-safe.
///
/// Source: Umeyama, "Least-squares estimation of transformation parameters between two point
/// patterns", PAMI 1991. Departure: the smallest rotation in the collinear case, where the paper's
/// solution is arbitrary.
AlignmentResult align_points(const Points3d& truth, const Points3d& estimate,
                             Alignment alignment = Alignment::kSE3);

/// The estimate as seen from the truth's frame: every pose multiplied by S. Timestamps stay.
Trajectory transform(Span<const StampedPose> estimate, const Similarity& truth_from_estimate);

}  // namespace dynslam::evaluation
