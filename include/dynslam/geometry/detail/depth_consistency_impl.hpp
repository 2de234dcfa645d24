// Implementation of depth_consistency.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "dynslam/core/errors.hpp"
#include "dynslam/geometry/depth_consistency.hpp"
#include "dynslam/geometry/detail/depth_look.hpp"

namespace dynslam::geometry {

inline void DepthConsistencyOptions::validate() const {
  const char* me = "DepthConsistencyOptions";
  require(stride >= 1 && stride <= 64, me, "stride", stride, "1..64 pixels");
  depth_noise.validate();
  pose_noise.validate();
  require(std::isfinite(threshold) && threshold > 0.0, me, "threshold", threshold,
          "a positive number");
  require(std::isfinite(depth_floor) && depth_floor >= 0.0, me, "depth_floor", depth_floor,
          "a finite number >= 0");
  require(std::isfinite(relative_floor) && relative_floor >= 0.0, me, "relative_floor",
          relative_floor, "a finite number >= 0");
  require(std::isfinite(min_range) && min_range >= 0.0, me, "min_range", min_range,
          "a finite number >= 0");
  require(std::isfinite(max_spread) && max_spread > 0.0, me, "max_spread", max_spread,
          "a positive number");
  require(std::isfinite(dynamic_evidence) && dynamic_evidence > 0.0, me, "dynamic_evidence",
          dynamic_evidence, "a positive number");
  require(std::isfinite(static_evidence) && static_evidence > 0.0, me, "static_evidence",
          static_evidence, "a positive number");
  require(std::isfinite(settle_time) && settle_time > 0.0, me, "settle_time", settle_time,
          "a positive number");
  require(std::isfinite(decision) && decision >= 0.0, me, "decision", decision,
          "a finite number >= 0");
}

namespace detail {

/// Log-odds that a reference's static vote takes away.
inline float static_vote(const DepthReference& reference, const DepthConsistencyOptions& o) {
  const double settled = std::min(1.0, std::max(0.0, reference.age / o.settle_time));
  return static_cast<float>(o.static_evidence * settled);
}

/// Whether a reference can be asked at all.
inline bool usable(const DepthReference& reference) {
  return reference.cells != nullptr && !reference.cells->empty() &&
         reference.T_cur_ref.all_finite();
}

/// Depth of a pixel if its neighbours support it, else 0 (a flying pixel, or none).
inline float supported_depth(ImageView<const float> depth, int x, int y, int reach) {
  const float z = depth(x, y);
  if (!has_depth(z)) return 0.0F;
  const float tolerance = 0.02F + 0.02F * z;
  const int dx[4] = {-reach, reach, 0, 0}, dy[4] = {0, 0, -reach, reach};
  int support = 0, asked = 0;
  for (int i = 0; i < 4; ++i) {
    if (!depth.contains(x + dx[i], y + dy[i])) continue;
    ++asked;
    if (std::abs(depth(x + dx[i], y + dy[i]) - z) < tolerance) ++support;
  }
  return 2 * support >= asked ? z : 0.0F;
}

inline void gather_depth(ImageView<const float> depth, DepthEvidence& out) {
  const int reach = std::max(1, out.stride / 2);
  for (int y = 0; y < out.height; ++y) {
    const int v = std::min(y * out.stride + out.stride / 2, depth.height - 1);
    for (int x = 0; x < out.width; ++x) {
      const int u = std::min(x * out.stride + out.stride / 2, depth.width - 1);
      out.depth[static_cast<std::size_t>(y) * out.width + x] = supported_depth(depth, u, v, reach);
    }
  }
}

/// Adds what one reference says of all cells to their log-odds.
inline void add_votes(const PinholeCamera& camera, const DepthReference& reference,
                      const DepthConsistencyOptions& options, const MarginModel& model,
                      DepthEvidence& out) {
  const RigidTransform T_ref_cur = reference.T_cur_ref.inverse();
  const Outlook cells(*reference.cells);
  const Eigen::Vector3f step = (T_ref_cur.R.col(0) * (out.stride / camera.fx)).cast<float>();
  const Eigen::Vector3f t = T_ref_cur.t.cast<float>();
  const float dynamic_evidence = static_cast<float>(options.dynamic_evidence);
  const float static_evidence = static_vote(reference, options);
  const double half = out.stride / 2;
  LookBatch batch;
  for (int y = 0; y < out.height; ++y) {
    const Eigen::Vector3d first = T_ref_cur.R * camera.bearing({half, y * out.stride + half});
    const Eigen::Vector3f origin = first.cast<float>();
    const std::size_t row = static_cast<std::size_t>(y) * out.width;
    for (int x = 0; x < out.width; x += LookBatch::kSize) {
      const std::size_t i = row + static_cast<std::size_t>(x);
      const int count = std::min(LookBatch::kSize, out.width - x);
      batch.project(&out.depth[i], count, x, origin, step, t, cells);
      batch.look_up(cells);
      batch.vote(model, dynamic_evidence, static_evidence, count, &out.log_odds[i]);
    }
  }
}

inline void count_verdicts(DepthEvidence& evidence) {
  int still = 0, dynamic = 0, all = 0;
  for (std::size_t i = 0; i < evidence.depth.size(); ++i) {
    const bool known = evidence.depth[i] > 0.0F;
    all += known;
    still += known & (evidence.verdict[i] == Verdict::kStatic);
    dynamic += known & (evidence.verdict[i] == Verdict::kDynamic);
  }
  evidence.static_cells = still;
  evidence.dynamic_cells = dynamic;
  evidence.unknown_cells = all - still - dynamic;
}

inline FeatureVerdict judge_one(const Eigen::Vector3d& X, Span<const DepthReference> references,
                                const DepthConsistencyOptions& options, const MarginModel& model) {
  FeatureVerdict result;
  if (!X.allFinite()) {
    result.reason = Reason::kNotFinite;
    return result;
  }
  SightTally tally;
  for (const DepthReference& reference : references) {
    if (!usable(reference)) continue;
    const Eigen::Vector3f P =
        (reference.T_cur_ref.R.transpose() * (X - reference.T_cur_ref.t)).cast<float>();
    tally.add(look(P, static_cast<float>(X.z()), Outlook(*reference.cells), model),
              static_cast<float>(options.dynamic_evidence), static_vote(reference, options));
  }
  result.verdict = tally.verdict(static_cast<float>(options.decision));
  result.reason = tally.reason(result.verdict);
  result.dynamic_votes = static_cast<std::uint8_t>(std::min(tally.through, 255));
  result.static_votes = static_cast<std::uint8_t>(std::min(tally.seen, 255));
  const int votes = tally.through + tally.seen;
  result.delta = votes > 0 ? tally.gap / static_cast<float>(votes) : 0.0F;
  result.log_odds = tally.log_odds;
  return result;
}

}  // namespace detail

inline FeatureVerdict judge_point(const Eigen::Vector3d& X_cur,
                                  Span<const DepthReference> references,
                                  const DepthConsistencyOptions& options) {
  options.validate();
  return detail::judge_one(X_cur, references, options, detail::MarginModel(options));
}

inline void judge_depth(ImageView<const float> depth, const PinholeCamera& camera,
                        Span<const DepthReference> references,
                        const DepthConsistencyOptions& options, DepthEvidence& out) {
  options.validate();
  detail::require_same_size(depth, camera, "judge_depth");
  out.stride = options.stride;
  out.focal = camera.fx;
  out.width = (depth.width + options.stride - 1) / options.stride;
  out.height = (depth.height + options.stride - 1) / options.stride;
  const std::size_t cells = static_cast<std::size_t>(out.width) * out.height;
  out.depth.resize(cells);
  out.log_odds.resize(cells);
  out.verdict.resize(cells);
  detail::gather_depth(depth, out);
  std::fill(out.log_odds.begin(), out.log_odds.end(), 0.0F);
  const detail::MarginModel model(options);
  for (const DepthReference& reference : references) {
    if (detail::usable(reference)) detail::add_votes(camera, reference, options, model, out);
  }
  const float decision = static_cast<float>(options.decision);
  for (std::size_t i = 0; i < cells; ++i) {
    out.verdict[i] = detail::verdict_of(out.log_odds[i], decision);
  }
  detail::count_verdicts(out);
}

inline void judge_features(const PinholeCamera& camera, const FeaturesView& current,
                           Span<const DepthReference> references,
                           const DepthConsistencyOptions& options, Span<FeatureVerdict> out) {
  const char* me = "judge_features";
  options.validate();
  camera.validate();
  require(out.size() == current.size(), me, "out.size", out.size(),
          std::to_string(current.size()) + ", the number of features");
  require(current.depths.empty() || current.depths.size() == current.size(), me,
          "current.depths.size", current.depths.size(), "0 or the number of features");
  const detail::MarginModel model(options);
  for (std::size_t i = 0; i < current.size(); ++i) {
    const Eigen::Vector2d p = current.pixels[i].cast<double>();
    const float z = current.depths.empty() ? 0.0F : current.depths[i];
    out[i] = FeatureVerdict();
    if (!p.allFinite()) {
      out[i].reason = Reason::kNotFinite;
    } else if (!has_depth(z)) {
      out[i].reason = Reason::kNoDepth;
    } else {
      out[i] = detail::judge_one(camera.unproject(p, z), references, options, model);
    }
  }
}

}  // namespace dynslam::geometry
