// What the solvers of one pose and of many have in common on their way to the optimum.
#pragma once

namespace dynslam::factors {

inline constexpr double kMinDamping = 1e-12;
inline constexpr double kMaxDamping = 1e12;

// Graduation: the weight prior starts soft enough for a residual of this many times the mean to
// keep half of its weight, and stiffens at least by the factor below each step.
inline constexpr double kSoftness = 1.5;
inline constexpr double kStiffening = 8.0;

}  // namespace dynslam::factors
