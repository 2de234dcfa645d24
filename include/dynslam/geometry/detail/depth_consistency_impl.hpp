// Implementation of depth_consistency.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "dynslam/core/errors.hpp"
#include "dynslam/geometry/depth_consistency.hpp"

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

/// Margins in single precision, prepared once per call.
struct MarginModel {
  float a, b, c, pose2, k, floor, relative, spread, min_range;

  explicit MarginModel(const DepthConsistencyOptions& o)
      : a(static_cast<float>(o.depth_noise.a)),
        b(static_cast<float>(o.depth_noise.b)),
        c(static_cast<float>(o.depth_noise.c)),
        pose2(static_cast<float>(o.pose_noise.translation * o.pose_noise.translation)),
        k(static_cast<float>(o.threshold)),
        floor(static_cast<float>(o.depth_floor)),
        relative(static_cast<float>(o.relative_floor)),
        spread(static_cast<float>(o.max_spread)),
        min_range(static_cast<float>(o.min_range)) {}

  float sigma2(float z) const {
    const float s = a + b * (z - c) * (z - c);
    return s * s;
  }
  /// What no margin at this depth is less than.
  float least_margin(float z_now) const { return floor + relative * z_now; }
  float margin(float z_now, float z_seen) const {
    return k * std::sqrt(sigma2(z_now) + sigma2(z_seen) + pose2) + floor + relative * z_now;
  }
};

/// Cells of a reference with what a look-up needs of its camera, prepared once per call.
struct Outlook {
  float fx, fy, cx, cy, width, height;  ///< pixels; a pixel's corner, not its centre, is whole
  std::uint32_t per_cell;               ///< 2^22 / cell, rounded up
  int pitch;                            ///< cells a row
  const float* near_depth;
  const float* far_depth;
  const std::uint8_t* mover;

  explicit Outlook(const DepthCells& cells)
      : fx(static_cast<float>(cells.camera.fx)),
        fy(static_cast<float>(cells.camera.fy)),
        cx(static_cast<float>(cells.camera.cx)),
        cy(static_cast<float>(cells.camera.cy)),
        width(static_cast<float>(cells.camera.width)),
        height(static_cast<float>(cells.camera.height)),
        per_cell(((1U << 22) + static_cast<std::uint32_t>(cells.cell) - 1) /
                 static_cast<std::uint32_t>(cells.cell)),
        pitch(cells.width),
        near_depth(cells.near_depth.data()),
        far_depth(cells.far_depth.data()),
        mover(cells.mover.data()) {}

  /// Cell of a pixel coordinate: its whole part divided by the cell's size. Exact for cells of up
  /// to 64 and images of up to 65536 pixels a side.
  std::size_t cell_of(float pixel) const {
    return static_cast<std::uint64_t>(static_cast<std::uint32_t>(pixel)) * per_cell >> 22;
  }
};

/// Looks up a point given in the reference's camera coordinates; `z_now` is its depth in the
/// current camera, of which the noise is a function.
inline SightResult look(const Eigen::Vector3f& P, float z_now, const Outlook& cells,
                        const MarginModel& model) {
  if (!(P.z() > static_cast<float>(kMinDepth))) return {};
  const float inv = 1.0F / P.z();
  const float u = cells.fx * P.x() * inv + cells.cx + 0.5F;
  const float v = cells.fy * P.y() * inv + cells.cy + 0.5F;
  if (!(u >= 0.0F && v >= 0.0F && u < cells.width && v < cells.height)) return {};
  const std::size_t at = cells.cell_of(v) * cells.pitch + cells.cell_of(u);
  const float nearest = cells.near_depth[at], farthest = cells.far_depth[at];
  if (nearest <= 0.0F) return {Sight::kHole};
  const bool mover = cells.mover[at] != 0;
  const float before = nearest - P.z(), behind = P.z() - farthest;
  const Sight seen = farthest - nearest > model.spread * nearest ? Sight::kEdge
                     : mover                                     ? Sight::kMover
                                                                 : Sight::kSeen;
  const float away = std::max(before, behind);
  if (away <= model.least_margin(z_now)) return {seen, 0.0F, std::max(0.0F, away)};
  const float margin = model.margin(z_now, before > 0.0F ? nearest : farthest);
  if (before > margin && (mover || P.z() < model.min_range)) return {Sight::kHidden};
  if (before > margin) return {Sight::kThrough, before / margin - 1.0F, before};
  if (behind > margin) return {Sight::kHidden, 0.0F, behind};
  return {seen, 0.0F, away};
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

/// One row of cells against one reference; the ray turned into the reference is linear in x.
inline void tally_row(const DepthEvidence& out, int y, const PinholeCamera& camera,
                      const RigidTransform& T_ref_cur, const Outlook& cells,
                      const MarginModel& model, float dynamic_evidence, float static_evidence,
                      SightTally* row) {
  const double half = out.stride / 2;
  const Eigen::Vector3d first = T_ref_cur.R * camera.bearing({half, y * out.stride + half});
  const Eigen::Vector3f origin = first.cast<float>();
  const Eigen::Vector3f step = (T_ref_cur.R.col(0) * (out.stride / camera.fx)).cast<float>();
  const Eigen::Vector3f t = T_ref_cur.t.cast<float>();
  const float* z = out.depth.data() + static_cast<std::size_t>(y) * out.width;
  for (int x = 0; x < out.width; ++x) {
    if (z[x] <= 0.0F) continue;
    const Eigen::Vector3f P = z[x] * (origin + static_cast<float>(x) * step) + t;
    row[x].add(look(P, z[x], cells, model), dynamic_evidence, static_evidence);
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
  out.row.resize(static_cast<std::size_t>(out.width));
  detail::gather_depth(depth, out);
  const detail::MarginModel model(options);
  for (int y = 0; y < out.height; ++y) {
    std::fill(out.row.begin(), out.row.end(), detail::SightTally());
    for (const DepthReference& reference : references) {
      if (!detail::usable(reference)) continue;
      detail::tally_row(out, y, camera, reference.T_cur_ref.inverse(),
                        detail::Outlook(*reference.cells), model,
                        static_cast<float>(options.dynamic_evidence),
                        detail::static_vote(reference, options), out.row.data());
    }
    for (int x = 0; x < out.width; ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * out.width + x;
      out.log_odds[i] = out.row[static_cast<std::size_t>(x)].log_odds;
      out.verdict[i] =
          out.row[static_cast<std::size_t>(x)].verdict(static_cast<float>(options.decision));
    }
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
