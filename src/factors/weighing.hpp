// What one observation contributes, whatever the mode of its weight: shared by the Schur solver and
// its tests. The pose optimizer has the same in vector form (pose_kernels.hpp).
#pragma once

#include <algorithm>
#include <cmath>

#include "dynslam/factors/pose_optimizer.hpp"
#include "dynslam/factors/robust_loss.hpp"
#include "dynslam/factors/static_weight.hpp"

namespace dynslam::factors {

// A residual of 1000 sigma, for points behind the camera.
inline constexpr double kBehindCamera = 1e6;

struct Weighing {
  double cost = 0.0;
  double w = 0.0;      // Gauss-Newton weight: H += w J' J
  double c = 0.0;      // curvature: H += c q q', q = J' r
  double gw = 0.0;     // gradient weight: g += gw q
  double cross = 0.0;  // joint: d2 cost / dphi dx = -cross phi q
};

struct WeighingRule {
  WeightMode mode = WeightMode::kFixed;
  RobustLoss loss;
  double lambda = 1.0;
  // Share of the loss's curvature that is used: 1 near the optimum, 1/4 (Gauss-Newton of the
  // joint problem) on the way. Never so much that an observation's own Hessian turns indefinite.
  double share = 1.0;
};

inline constexpr double kConvex = 0.95;

inline Weighing weigh(const WeighingRule& rule, double s, double phi0, double phi) {
  Weighing out;
  const double trust = phi0 * phi0;
  if (rule.mode == WeightMode::kJoint) {
    const double A = rule.lambda + s;
    const double slope = phi * s + rule.lambda * (phi - phi0);
    const double bound = s > 0.0 ? std::sqrt(kConvex * A / s) : 2.0;
    out.cross = std::min(2.0 * std::sqrt(rule.share), bound);
    out.cost = weighted_cost(phi, phi0, s, rule.lambda);
    out.w = phi * phi;
    out.c = -out.cross * out.cross * out.w / A;
    out.gw = out.w - out.cross * phi * slope / A;
    return out;
  }
  double curvature = 0.0;
  if (rule.mode == WeightMode::kEliminated) {
    const double ratio = rule.lambda / (rule.lambda + s);
    out.cost = eliminated_cost(phi0, s, rule.lambda);
    out.w = trust * ratio * ratio;
    curvature = -4.0 * out.w / (rule.lambda + s);
  } else {
    const LossValue value = rule.loss(s);
    out.cost = 0.5 * trust * value.rho;
    out.w = trust * value.rho1;
    curvature = 2.0 * trust * value.rho2;
  }
  out.gw = out.w;
  out.c = rule.share * curvature;
  if (s > 0.0) out.c = std::max(out.c, -kConvex * out.w / s);
  return out;
}

}  // namespace dynslam::factors
