// Which observations take part, in every solver: finite, trusted, and nowhere near overflow.
#pragma once

#include <cmath>

#include <Eigen/Core>

#include "dynslam/factors/bundle_adjustment.hpp"

namespace dynslam::factors {

// Nothing measured lies farther away; beyond, products overflow.
inline constexpr double kLargest = 1e9;

inline bool in_reach(double value) { return std::abs(value) < kLargest; }  // false for NaN

inline float right_inverse_sigma(const BundleObservation& o) {
  return std::isnan(o.right_inverse_sigma) ? o.inverse_sigma : o.right_inverse_sigma;
}

inline bool has_depth(const BundleObservation& o) {
  return o.right_column >= 0.0F && in_reach(o.right_column) && right_inverse_sigma(o) > 0.0F &&
         right_inverse_sigma(o) < 1e6F;
}

inline bool usable(const BundleObservation& o, const Eigen::Vector3d& X) {
  return o.weight > 0.0F && o.inverse_sigma > 0.0F && o.inverse_sigma < 1e6F && in_reach(o.u) &&
         in_reach(o.v) && X.allFinite() && X.cwiseAbs().maxCoeff() < kLargest;
}

}  // namespace dynslam::factors
