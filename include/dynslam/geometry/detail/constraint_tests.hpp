// Tests of one feature in one reference; a part of weighted_constraint.hpp.
#pragma once

#include <algorithm>
#include <cmath>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "dynslam/geometry/depth_consistency.hpp"
#include "dynslam/geometry/verdict.hpp"
#include "dynslam/geometry/weighted_constraint.hpp"

namespace dynslam::geometry::detail {

/// One feature in one reference and now.
struct Sighting {
  Eigen::Vector3d f1, f2;             ///< bearings with z = 1
  double z1 = 0.0, z2 = 0.0;          ///< metres, 0 = none
  double angle1 = 0.0, angle2 = 0.0;  ///< angular noise, radians
  double spread = 0.0;                ///< metres, larger of both
};

/// Outcome of one reference's tests of one feature.
struct ConstraintVote {
  Reason reason = Reason::kNoBaseline;  ///< group of `kConsistent` or after: a vote was cast
  double residual = 0.0;                ///< largest normalized residual (standard deviations)
  double delta = 0.0;                   ///< alpha |c| + beta |dz|

  bool votes() const { return reason >= Reason::kConsistent; }
  bool dynamic() const { return reason > Reason::kConsistent; }
};

/// |c| and its standard deviation; `valid` is false without enough baseline or parallax.
struct EpipolarTest {
  bool valid = false;
  double c = 0.0, sigma = 1.0;
};

inline EpipolarTest test_epipolar(const Sighting& s, const Eigen::Vector3d& Rf1,
                                  const Eigen::Vector3d& t, const WeightedConstraintOptions& o) {
  EpipolarTest result;
  const double baseline = t.norm();
  if (baseline < o.min_baseline || baseline <= 0.0) return result;
  const Eigen::Vector3d a = Rf1.normalized(), b = s.f2.normalized();
  const Eigen::Vector3d n = t.cross(a);
  const double norm = n.norm();
  // The angle under which the point sees the baseline; with no depth assume a typical 3 m.
  const double distance = s.z1 > 0.0 ? s.z1 * s.f1.norm() : 3.0;
  if (norm < o.min_parallax * distance) return result;
  result.c = std::abs(n.dot(b)) / norm;
  // Noise of f2 counts fully; that of f1, and of R, turns the plane about t; that of t turns it
  // about f1 and counts in proportion to the angle between the rays.
  const double turn = t.cross(b).norm() / norm;
  const double swing = a.cross(b).norm() / norm;
  const double rotation = o.pose_noise.rotation, translation = o.pose_noise.translation;
  result.sigma =
      std::sqrt(s.angle2 * s.angle2 + turn * turn * (s.angle1 * s.angle1 + rotation * rotation) +
                swing * swing * translation * translation);
  result.valid = true;
  return result;
}

/// Normalized distance of f2 from where the point can be: at depth z1, or without z1 anywhere
/// between infinity and `min_scene_depth`.
inline double test_transfer(const Sighting& s, const Eigen::Vector3d& Rf1, const Eigen::Vector3d& t,
                            const WeightedConstraintOptions& o) {
  const Eigen::Vector3d b = s.f2.normalized();
  const double rotation = o.pose_noise.rotation;
  double noise2 = s.angle1 * s.angle1 + s.angle2 * s.angle2 + rotation * rotation;
  if (s.z1 > 0.0) {
    const Eigen::Vector3d X = s.z1 * Rf1 + t;
    const double range = X.norm();
    if (X.z() <= kMinDepth) return 0.0;
    const double parallax = t.norm() / range;
    const double depth_share =
        (o.depth_noise.sigma(s.z1) + 0.25 * o.depth_floor + 0.5 * s.spread) / s.z1;
    const double translation = o.pose_noise.translation / range;
    noise2 += parallax * parallax * depth_share * depth_share + translation * translation;
    return (X / range).cross(b).norm() / std::sqrt(noise2);
  }
  const double away = Rf1.normalized().cross(b).norm();
  const double slack = (t.norm() + o.threshold * o.pose_noise.translation) / o.min_scene_depth;
  return std::max(0.0, away - slack) / std::sqrt(noise2);
}

/// Standard deviation of dz: depth noise of both measurements, pose, and slope or edge around.
inline double depth_sigma(const Sighting& s, double expected, const WeightedConstraintOptions& o) {
  const double a = o.depth_noise.sigma(s.z1), b = o.depth_noise.sigma(s.z2);
  const double lateral = o.pose_noise.rotation * expected;
  return std::sqrt(a * a + b * b + o.pose_noise.translation * o.pose_noise.translation +
                   lateral * lateral + 0.25 * s.spread * s.spread);
}

/// What the reference's depth image says to a violated depth test: the vote stands only if the
/// reference saw free space where the point is now.
inline Reason arbitrate_depth(const Sighting& s, const ReferenceView& reference,
                              const MarginModel& model) {
  if (reference.cells == nullptr || reference.cells->empty()) return Reason::kDepthViolated;
  const Eigen::Vector3d X = s.z2 * s.f2;
  const Eigen::Vector3d P = reference.T_cur_ref.R.transpose() * (X - reference.T_cur_ref.t);
  switch (look(P.cast<float>(), static_cast<float>(s.z2), Outlook(*reference.cells), model).sight) {
    case Sight::kThrough:
      return Reason::kFreeSpaceViolated;
    case Sight::kHidden:
      return Reason::kOccluded;
    case Sight::kSeen:
    case Sight::kMover:
      return Reason::kOccluded;
    case Sight::kEdge:
      return Reason::kDepthEdge;
    case Sight::kHole:
    case Sight::kOutside:
      break;
  }
  return Reason::kDepthViolated;
}

inline ConstraintVote test_sighting(const Sighting& s, const ReferenceView& reference,
                                    const WeightedConstraintOptions& o, const MarginModel& model) {
  ConstraintVote vote;
  const Eigen::Vector3d Rf1 = reference.T_cur_ref.R * s.f1;
  const Eigen::Vector3d& t = reference.T_cur_ref.t;
  bool tested = false;
  if (o.use_epipolar) {
    const EpipolarTest epipolar = test_epipolar(s, Rf1, t, o);
    if (epipolar.valid) {
      tested = true;
      vote.residual = epipolar.c / epipolar.sigma;
      vote.delta = epipolar.c;
      if (vote.residual > o.threshold) {
        vote.reason = Reason::kEpipolarViolated;
        return vote;
      }
    }
  }
  if (o.use_depth && s.z1 > 0.0 && s.z2 > 0.0) {
    if (!std::isfinite(s.spread)) {
      if (!tested) vote.reason = Reason::kDepthEdge;
    } else {
      tested = true;
      const double expected = s.z1 * Rf1.z() + t.z();
      const double dz = std::abs(s.z2 - expected);
      const double beyond = std::max(0.0, dz - o.depth_floor) / depth_sigma(s, expected, o);
      vote.residual = std::max(vote.residual, beyond);
      vote.delta = dz;
      if (beyond > o.threshold) {
        vote.reason = arbitrate_depth(s, reference, model);
        return vote;
      }
    }
  } else if (!tested && o.use_depth) {
    vote.reason = t.norm() < o.min_baseline ? Reason::kNoBaseline : Reason::kNoDepth;
  }
  if (o.use_transfer && std::isfinite(s.spread)) {
    const double transfer = test_transfer(s, Rf1, t, o);
    if (s.z1 > 0.0) tested = true;
    vote.residual = std::max(vote.residual, transfer);
    if (transfer > o.threshold) {
      vote.reason = Reason::kTransferViolated;
      return vote;
    }
  }
  if (tested) vote.reason = Reason::kConsistent;
  return vote;
}

/// Half the chi-square excess over the threshold, squashed into the evidence one reference may
/// give.
inline double vote_evidence(const ConstraintVote& vote, const WeightedConstraintOptions& o) {
  if (!vote.votes()) return 0.0;
  const double x = vote.residual / o.threshold;
  if (vote.dynamic()) return o.dynamic_evidence * std::min(1.0, 0.5 + 0.5 * std::max(0.0, x - 1.0));
  return -o.static_evidence * (1.0 - x * x);
}

}  // namespace dynslam::geometry::detail
