// What a reference saw where a point would be, one by one and many at a time; a part of
// depth_consistency.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/geometry/depth_cells.hpp"
#include "dynslam/geometry/depth_consistency.hpp"
#include "dynslam/geometry/detail/sight.hpp"

namespace dynslam::geometry::detail {

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

  /// Cell of a whole pixel coordinate, >= 0: divided by the cell's size. Exact for cells of up
  /// to 64 and images of up to 65536 pixels a side.
  std::size_t cell_of(int pixel) const {
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
  const std::size_t at =
      cells.cell_of(static_cast<int>(v)) * cells.pitch + cells.cell_of(static_cast<int>(u));
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

/// Cells of a row that are looked up together: a constant number without branches between them, so
/// that all but the look-up itself is vectorized. Gives to the bit what `look` gives one by one.
struct LookBatch {
  static constexpr int kSize = 32;

  float z[kSize];             ///< metres, now; 0: nothing to look up
  float z_there[kSize];       ///< metres, in the reference
  int u[kSize], v[kSize];     ///< whole pixels in the reference
  float nearest[kSize];       ///< metres, what the reference saw there; 0 = hole
  float farthest[kSize];      ///< metres
  std::int32_t mover[kSize];  ///< 1: it saw a mover there

  /// Takes `count` depths of cells from column x on; the ray turned into the reference, `origin` at
  /// column 0, is linear in x.
  void project(const float* depths, int count, int x, const Eigen::Vector3f& origin,
               const Eigen::Vector3f& step, const Eigen::Vector3f& t, const Outlook& cells) {
    std::copy(depths, depths + count, z);
    std::fill(z + count, z + kSize, 0.0F);
    for (int i = 0; i < kSize; ++i) {
      const float column = static_cast<float>(x + i);
      const float X = z[i] * (origin.x() + column * step.x()) + t.x();
      const float Y = z[i] * (origin.y() + column * step.y()) + t.y();
      const float Z = z[i] * (origin.z() + column * step.z()) + t.z();
      const float inv = 1.0F / Z;
      const float right = cells.fx * X * inv + cells.cx + 0.5F;
      const float below = cells.fy * Y * inv + cells.cy + 0.5F;
      const bool inside = (Z > static_cast<float>(kMinDepth)) & (right >= 0.0F) & (below >= 0.0F) &
                          (right < cells.width) & (below < cells.height);
      z[i] = inside ? z[i] : 0.0F;
      z_there[i] = Z;
      // The bounds change only what is outside: those who look up need not ask.
      u[i] = static_cast<int>(std::min(std::max(0.0F, right), cells.width - 1.0F));
      v[i] = static_cast<int>(std::min(std::max(0.0F, below), cells.height - 1.0F));
    }
  }

  void look_up(const Outlook& cells) {
    for (int i = 0; i < kSize; ++i) {
      const std::size_t at = cells.cell_of(v[i]) * cells.pitch + cells.cell_of(u[i]);
      nearest[i] = cells.near_depth[at];
      farthest[i] = cells.far_depth[at];
      mover[i] = cells.mover[at];
    }
  }

  /// Adds the votes to the log-odds of the first `count` cells.
  void vote(const MarginModel& model, float dynamic_evidence, float static_evidence, int count,
            float* log_odds) const {
    float votes[kSize];
    for (int i = 0; i < kSize; ++i) {
      const float before = nearest[i] - z_there[i], behind = z_there[i] - farthest[i];
      const bool told = (z[i] > 0.0F) & (nearest[i] > 0.0F);
      const bool edge = farthest[i] - nearest[i] > model.spread * nearest[i];
      const float agrees = edge            ? 0.0F
                           : mover[i] != 0 ? -kMoverShare * static_evidence
                                           : -static_evidence;
      const float margin = model.margin(z[i], before > 0.0F ? nearest[i] : farthest[i]);
      const float excess = before / margin - 1.0F;
      const float arrived = dynamic_evidence * std::min(1.0F, 0.5F + 0.5F * excess);
      const bool hides = (mover[i] != 0) | (z_there[i] < model.min_range);
      const float away = std::max(before, behind);
      const float far_off = before > margin   ? (hides ? 0.0F : arrived)
                            : behind > margin ? 0.0F
                                              : agrees;
      const float vote = away <= model.least_margin(z[i]) ? agrees : far_off;
      votes[i] = told ? vote : 0.0F;
    }
    for (int i = 0; i < count; ++i) log_odds[i] += votes[i];
  }
};

}  // namespace dynslam::geometry::detail
