// Implementation of weighted_constraint.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>

#include "dynslam/core/errors.hpp"
#include "dynslam/geometry/depth_consistency.hpp"
#include "dynslam/geometry/detail/constraint_tests.hpp"

namespace dynslam::geometry {

inline void WeightedConstraintOptions::validate() const {
  const char* me = "WeightedConstraintOptions";
  const auto positive = [me](double value, const char* name) {
    require(std::isfinite(value) && value > 0.0, me, name, value, "a positive number");
  };
  const auto not_negative = [me](double value, const char* name) {
    require(std::isfinite(value) && value >= 0.0, me, name, value, "a finite number >= 0");
  };
  require(combination >= Combination::kNull && combination <= Combination::kLogOdds, me,
          "combination", static_cast<int>(combination), "one of the enumerators");
  positive(threshold, "threshold");
  positive(pixel_sigma, "pixel_sigma");
  depth_noise.validate();
  pose_noise.validate();
  not_negative(min_baseline, "min_baseline");
  not_negative(min_parallax, "min_parallax");
  positive(min_scene_depth, "min_scene_depth");
  not_negative(depth_floor, "depth_floor");
  positive(dynamic_evidence, "dynamic_evidence");
  positive(static_evidence, "static_evidence");
  not_negative(decision, "decision");
}

namespace detail {

inline float value_or(StridedSpan<const float> values, std::size_t i, float fallback) {
  return values.empty() ? fallback : values[i];
}

inline Sighting make_sighting(const PinholeCamera& camera, const FeaturesView& current,
                              const FeaturesView& reference, const Match& match,
                              const WeightedConstraintOptions& o) {
  const auto i = static_cast<std::size_t>(match.query), j = static_cast<std::size_t>(match.train);
  Sighting s;
  s.f1 = camera.bearing(reference.pixels[j].cast<double>());
  s.f2 = camera.bearing(current.pixels[i].cast<double>());
  const float z1 = value_or(reference.depths, j, 0.0F), z2 = value_or(current.depths, i, 0.0F);
  s.z1 = has_depth(z1) ? z1 : 0.0;
  s.z2 = has_depth(z2) ? z2 : 0.0;
  const double angle = o.pixel_sigma / camera.fx;
  s.angle1 = angle * value_or(reference.scales, j, 1.0F);
  s.angle2 = angle * value_or(current.scales, i, 1.0F);
  s.spread = std::max(value_or(reference.spreads, j, 0.0F), value_or(current.spreads, i, 0.0F));
  return s;
}

/// Adds one reference's vote to a verdict under construction. The reason kept is that of the
/// strongest kind of answer so far, a later enumerator winning within unknowns.
inline void add_vote(const ConstraintVote& vote, double evidence, FeatureVerdict& out,
                     double& delta_sum, double& residual_sum) {
  if (vote.votes()) {
    auto& votes = vote.dynamic() ? out.dynamic_votes : out.static_votes;
    if (votes < 255) ++votes;
    delta_sum += vote.delta;
    residual_sum += vote.residual;
    out.log_odds += static_cast<float>(evidence);
  }
  out.reason = std::max(out.reason, vote.reason);
}

inline Verdict combine(const FeatureVerdict& v, double mean_residual,
                       const WeightedConstraintOptions& o) {
  const int voters = v.dynamic_votes + v.static_votes;
  if (voters == 0) return Verdict::kUnknown;
  switch (o.combination) {
    case Combination::kNull:
      break;
    case Combination::kAny:
      return v.dynamic_votes > 0 ? Verdict::kDynamic : Verdict::kStatic;
    case Combination::kMajority:
      if (v.dynamic_votes == v.static_votes) return Verdict::kUnknown;
      return v.dynamic_votes > v.static_votes ? Verdict::kDynamic : Verdict::kStatic;
    case Combination::kMean:
      return mean_residual > o.threshold ? Verdict::kDynamic : Verdict::kStatic;
    case Combination::kLogOdds:
      if (v.log_odds > o.decision) return Verdict::kDynamic;
      return v.log_odds < -o.decision || (v.dynamic_votes == 0 && v.log_odds < 0.0F)
                 ? Verdict::kStatic
                 : Verdict::kUnknown;
  }
  return Verdict::kUnknown;
}

/// Turns votes into the verdict; `reason` holds the greatest reason met.
inline void finish_verdict(FeatureVerdict& v, double delta_sum, double residual_sum,
                           const WeightedConstraintOptions& o) {
  const int voters = v.dynamic_votes + v.static_votes;
  if (voters > 0) v.delta = static_cast<float>(delta_sum / voters);
  v.verdict = combine(v, voters > 0 ? residual_sum / voters : 0.0, o);
  if (v.verdict == Verdict::kStatic) v.reason = Reason::kConsistent;
  if (v.verdict == Verdict::kUnknown && voters > 0) v.reason = Reason::kUndecided;
  if (v.verdict == Verdict::kDynamic && v.reason <= Reason::kConsistent) {
    v.reason = Reason::kDepthViolated;  // kMean: no single reference was over the threshold
  }
}

inline void require_features(const FeaturesView& features, const char* name) {
  const char* me = "judge_features";
  const std::size_t n = features.size();
  const auto check = [&](std::size_t size, const char* member) {
    require(size == 0 || size == n, me, std::string(name) + "." + member + ".size", size,
            "0 or " + std::to_string(n) + ", the number of pixels");
  };
  check(features.depths.size(), "depths");
  check(features.scales.size(), "scales");
  check(features.spreads.size(), "spreads");
}

inline void require_matches(const ReferenceView& reference, std::size_t current_size) {
  for (const Match& match : reference.matches) {
    require(match.query >= 0 && static_cast<std::size_t>(match.query) < current_size,
            "judge_features", "references.matches.query", match.query,
            "an index below " + std::to_string(current_size));
    require(match.train >= 0 && static_cast<std::size_t>(match.train) < reference.features.size(),
            "judge_features", "references.matches.train", match.train,
            "an index below " + std::to_string(reference.features.size()));
  }
}

}  // namespace detail

inline void judge_features(const PinholeCamera& camera, const FeaturesView& current,
                           Span<const ReferenceView> references,
                           const WeightedConstraintOptions& options,
                           WeightedConstraintWorkspace& workspace, Span<FeatureVerdict> out) {
  options.validate();
  camera.validate();
  detail::require_features(current, "current");
  require(out.size() == current.size(), "judge_features", "out.size", out.size(),
          std::to_string(current.size()) + ", the number of features");
  for (const ReferenceView& reference : references) {
    detail::require_features(reference.features, "references.features");
    detail::require_matches(reference, current.size());
  }

  workspace.delta_sum.assign(current.size(), 0.0);
  workspace.residual_sum.assign(current.size(), 0.0);
  for (std::size_t i = 0; i < current.size(); ++i) {
    out[i] = FeatureVerdict();
    if (!current.pixels[i].allFinite()) out[i].reason = Reason::kNotFinite;
  }
  if (options.combination == Combination::kNull) return;

  DepthConsistencyOptions margins;
  margins.depth_noise = options.depth_noise;
  margins.pose_noise = options.pose_noise;
  margins.threshold = options.threshold;
  margins.depth_floor = options.depth_floor;
  const detail::MarginModel model(margins);
  for (const ReferenceView& reference : references) {
    const bool finite_pose = reference.T_cur_ref.all_finite();
    for (const Match& match : reference.matches) {
      const auto i = static_cast<std::size_t>(match.query);
      const detail::Sighting s =
          detail::make_sighting(camera, current, reference.features, match, options);
      if (!finite_pose || !s.f1.allFinite() || !s.f2.allFinite()) {
        out[i].reason = std::max(out[i].reason, Reason::kNotFinite);
        continue;
      }
      const detail::ConstraintVote vote = detail::test_sighting(s, reference, options, model);
      detail::add_vote(vote, detail::vote_evidence(vote, options), out[i], workspace.delta_sum[i],
                       workspace.residual_sum[i]);
    }
  }
  for (std::size_t i = 0; i < current.size(); ++i) {
    detail::finish_verdict(out[i], workspace.delta_sum[i], workspace.residual_sum[i], options);
  }
}

inline void measure_depths(ImageView<const float> depth, Pixels pixels, int radius,
                           Span<float> depths, Span<float> spreads) {
  const char* me = "measure_depths";
  require(!depth.empty(), me, "depth", "an empty image", "an image with pixels");
  require(radius >= 0, me, "radius", radius, "a number of pixels >= 0");
  require(depths.size() == pixels.size(), me, "depths.size", depths.size(),
          std::to_string(pixels.size()) + ", the number of pixels");
  require(spreads.empty() || spreads.size() == pixels.size(), me, "spreads.size", spreads.size(),
          "0 or " + std::to_string(pixels.size()) + ", the number of pixels");
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const Eigen::Vector2f p = pixels[i];
    depths[i] = 0.0F;
    if (!spreads.empty()) spreads[i] = std::numeric_limits<float>::infinity();
    // Written so that NaN is outside.
    const bool inside = p.x() > -0.5F && p.y() > -0.5F &&
                        p.x() < static_cast<float>(depth.width) - 0.5F &&
                        p.y() < static_cast<float>(depth.height) - 0.5F;
    if (!inside) continue;
    const int x = static_cast<int>(p.x() + 0.5F), y = static_cast<int>(p.y() + 0.5F);
    depths[i] = has_depth(depth(x, y)) ? depth(x, y) : 0.0F;
    if (spreads.empty()) continue;
    const int x0 = std::max(0, x - radius), y0 = std::max(0, y - radius);
    const int x1 = std::min(depth.width, x + radius + 1),
              y1 = std::min(depth.height, y + radius + 1);
    detail::DepthBlock block;
    for (int v = y0; v < y1; ++v) {
      for (int u = x0; u < x1; ++u) {
        const float z = depth(u, v);
        if (!has_depth(z)) continue;
        block.nearest = std::min(block.nearest, z);
        block.farthest = std::max(block.farthest, z);
        ++block.count;
      }
    }
    if (4 * block.count > 3 * (x1 - x0) * (y1 - y0)) spreads[i] = block.farthest - block.nearest;
  }
}

}  // namespace dynslam::geometry
