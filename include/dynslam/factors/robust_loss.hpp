// Robust losses on the squared, whitened residual.
#pragma once

#include <cmath>
#include <limits>

#include "dynslam/core/errors.hpp"

namespace dynslam::factors {

/// Shape of a robust loss. All are scaled so that rho(s) ~ s near zero.
enum class LossKind {
  kNone,          ///< rho = s: plain least squares
  kHuber,         ///< s inside, 2 c sqrt(s) - c^2 outside
  kCauchy,        ///< c^2 log(1 + s / c^2)
  kGemanMcClure,  ///< c^2 s / (c^2 + s): the static weight, eliminated, with lambda = c^2
  kBarron,        ///< Barron's general loss (CVPR 2019), shape `alpha`
};

/// Value and derivatives of a loss with respect to s.
struct LossValue {
  double rho = 0.0;   ///< rho(s)
  double rho1 = 1.0;  ///< rho'(s), the weight of the iteratively reweighted normal equations
  double rho2 = 0.0;  ///< rho''(s), the curvature term of a full Newton step
};

/// A robust loss rho(s) of a squared whitened residual s = r' S^-1 r >= 0; the cost of an
/// observation is 1/2 rho(s).
///
/// Source: Huber 1964; Geman & McClure 1987; Barron, "A General and Adaptive Robust Loss
/// Function", CVPR 2019, eq. 8 (there rho = 2 f(sqrt(s), alpha, c) c^2 here, so that every kind is
/// s near 0).
struct RobustLoss {
  LossKind kind = LossKind::kNone;
  double scale = 1.0;  ///< c, in standard deviations, > 0; Huber's habit: sqrt(5.991) = 2.447 mono,
                       ///< sqrt(7.815) = 2.796 with depth
  double alpha = 1.0;  ///< Barron only, in [-100, 2]: 2 is least squares, 1 pseudo-Huber, 0 Cauchy,
                       ///< -2 Geman-McClure

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const {
    require(std::isfinite(scale) && scale > 0.0, "RobustLoss", "scale", scale,
            "a positive number of standard deviations");
    require(kind != LossKind::kBarron || (alpha >= -100.0 && alpha <= 2.0), "RobustLoss", "alpha",
            alpha, "a number in [-100, 2]");
  }

  /// rho, rho', rho'' at s >= 0. O(1), no allocation; NaN in gives NaN out.
  LossValue operator()(double s) const;
};

inline LossValue RobustLoss::operator()(double s) const {
  const double c2 = scale * scale;
  switch (kind) {
    case LossKind::kNone:
      break;
    case LossKind::kHuber: {
      if (s > c2) {
        const double root = std::sqrt(s);
        return {2.0 * scale * root - c2, scale / root, -0.5 * scale / (root * s)};
      }
      break;
    }
    case LossKind::kCauchy: {
      const double inv = c2 / (c2 + s);
      return {c2 * std::log1p(s / c2), inv, -inv * inv / c2};
    }
    case LossKind::kGemanMcClure: {
      const double inv = c2 / (c2 + s);
      return {s * inv, inv * inv, -2.0 * inv * inv * inv / c2};
    }
    case LossKind::kBarron: {
      const double x = s / c2;
      if (alpha == 2.0) break;
      if (alpha == 0.0) {  // limit: Cauchy of scale sqrt(2) c
        const double inv = 1.0 / (1.0 + 0.5 * x);
        return {2.0 * c2 * std::log1p(0.5 * x), inv, -0.5 * inv * inv / c2};
      }
      const double b = std::abs(alpha - 2.0);
      const double base = x / b + 1.0;
      const double power = std::pow(base, 0.5 * alpha - 1.0);
      return {2.0 * c2 * b / alpha * (power * base - 1.0), power,
              (0.5 * alpha - 1.0) * power / base / (b * c2)};
    }
  }
  return {s, 1.0, 0.0};
}

}  // namespace dynslam::factors
