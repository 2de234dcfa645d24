// Static weights: how far an observation is trusted to show the static world.
//
// 1 = said static, 0 = said dynamic. A weight phi enters the cost as
//   1/2 [ phi^2 s + lambda (phi - phi0)^2 ],   s = r' S^-1 r,  0 <= phi <= 1,
// where phi0 is the weight the detectors gave. The prior term is what keeps phi = 0 from being
// the trivial optimum (switchable constraints, Suenderhauf & Protzel, IROS 2012); the paper
// (P-Static, LOP 2024) prints the cost without it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam::factors {

/// What one detector says of one feature.
struct DetectorVote {
  double staticness = 1.0;    ///< 1 static .. 0 dynamic; NaN: this detector has no opinion
  double contribution = 0.5;  ///< eta of segmentation, omega of geometry (paper: 0.5 each), >= 0
};

/// Rules for the initial weight.
struct StaticWeightOptions {
  double momentum = 0.0;  ///< share of last frame's optimized weight in phi0, [0, 1); engineering
                          ///< (the idea is DynaVINS's)
  double unknown = 0.5;   ///< phi0 of a feature no detector has an opinion on, [0, 1]; engineering

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const {
    require(momentum >= 0.0 && momentum < 1.0, "StaticWeightOptions", "momentum", momentum,
            "a number in [0, 1)");
    require(unknown >= 0.0 && unknown <= 1.0, "StaticWeightOptions", "unknown", unknown,
            "a number in [0, 1]");
  }
};

/// Initial weight from any number of detectors: the mean of their votes by contribution,
/// phi0 = sum_k c_k m_k / sum_k c_k over the detectors that have an opinion (for two with
/// eta + omega = 1: eta m_seg + omega m_geo), then momentum:
/// phi0 <- (1 - momentum) phi0 + momentum previous.
///
/// `previous` is the optimized weight of the same map point in the last frame; NaN = none. No
/// opinion at all (or contributions that sum to 0): `previous` if there is one, else
/// `options.unknown`. Throws InvalidArgument for a vote outside [0, 1], a negative or non-finite
/// contribution, a `previous` outside [0, 1]. O(votes), no allocation.
/// Source: P-Static section 4 (which prints m_seg twice); momentum is a departure.
inline double initial_weight(Span<const DetectorVote> votes, double previous = std::nan(""),
                             const StaticWeightOptions& options = {}) {
  options.validate();
  require(!(previous < 0.0) && !(previous > 1.0), "initial_weight", "previous", previous,
          "a weight in [0, 1], or NaN for none");
  double sum = 0.0, total = 0.0;
  for (const DetectorVote& vote : votes) {
    require(std::isfinite(vote.contribution) && vote.contribution >= 0.0, "initial_weight",
            "votes.contribution", vote.contribution, "a finite number >= 0");
    if (std::isnan(vote.staticness)) continue;
    require(vote.staticness >= 0.0 && vote.staticness <= 1.0, "initial_weight", "votes.staticness",
            vote.staticness, "a number in [0, 1], or NaN for no opinion");
    sum += vote.contribution * vote.staticness;
    total += vote.contribution;
  }
  const bool remembered = !std::isnan(previous);
  if (!(total > 0.0)) return remembered ? previous : options.unknown;
  const double phi0 = std::min(1.0, sum / total);
  return remembered ? (1.0 - options.momentum) * phi0 + options.momentum * previous : phi0;
}

/// Weight that minimizes 1/2 [phi^2 s + lambda (phi - phi0)^2] for a fixed residual:
/// phi* = lambda phi0 / (lambda + s). Always in [0, phi0], so the bounds never bind.
///
/// s >= 0 (squared whitened residual), lambda > 0, phi0 in [0, 1]; s = infinity gives 0.
constexpr double optimal_weight(double phi0, double s, double lambda) {
  return lambda * phi0 / (lambda + s);
}

/// Cost of one observation with its weight: 1/2 [phi^2 s + lambda (phi - phi0)^2].
constexpr double weighted_cost(double phi, double phi0, double s, double lambda) {
  return 0.5 * (phi * phi * s + lambda * (phi - phi0) * (phi - phi0));
}

/// The same with phi = phi*: lambda phi0^2 s / (2 (lambda + s)), a Geman-McClure kernel of scale
/// sqrt(lambda) weighted by phi0^2.
constexpr double eliminated_cost(double phi0, double s, double lambda) {
  return 0.5 * lambda * phi0 * phi0 * s / (lambda + s);
}

/// Applies `optimal_weight` to every observation: out[i] from phi0[i] and s[i].
///
/// Throws InvalidArgument when sizes differ or lambda is not a positive finite number. `out` may be
/// `phi0` itself. NaN in s[i] gives weight 0: what cannot be measured supports nothing. O(N).
inline void update_weights(Span<const float> phi0, Span<const float> squared_residuals,
                           double lambda, Span<float> out) {
  require(squared_residuals.size() == phi0.size(), "update_weights", "squared_residuals",
          squared_residuals.size(), "as many as phi0");
  require(out.size() == phi0.size(), "update_weights", "out", out.size(), "as many as phi0");
  require(std::isfinite(lambda) && lambda > 0.0, "update_weights", "lambda", lambda,
          "a positive number");
  for (std::size_t i = 0; i < phi0.size(); ++i) {
    const double s = squared_residuals[i];
    out[i] = std::isnan(s) ? 0.0F : static_cast<float>(optimal_weight(phi0[i], s, lambda));
  }
}

}  // namespace dynslam::factors
