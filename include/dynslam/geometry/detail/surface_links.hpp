// Which cells are one surface, and what flows along it; a part of region_grow.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "dynslam/geometry/depth_consistency.hpp"
#include "dynslam/geometry/region_grow.hpp"

namespace dynslam::geometry::detail {

/// Whether the surface goes on from cell b to its neighbour c, given the cells before (a) and after
/// (d) in the same direction, 0 = none: the step must not exceed what the slope on either side
/// explains.
inline bool surface_continues(float a, float b, float c, float d, float jump) {
  if (b <= 0.0F || c <= 0.0F) return false;
  const float step = std::abs(c - b);
  const float tolerance = jump * std::min(b, c);
  if (step <= tolerance) return true;
  if (step > 4.0F * tolerance) return false;
  const float before = a > 0.0F ? std::abs((c - b) - (b - a)) : step;
  const float after = d > 0.0F ? std::abs((d - c) - (c - b)) : step;
  return std::max(before, after) <= 0.5F * tolerance;
}

/// Distance in metres between each cell and its right (lower) neighbour, negative where the surface
/// breaks off.
inline void link_cells(const DepthEvidence& e, float jump, std::vector<float>& right,
                       std::vector<float>& down) {
  const float pitch = static_cast<float>(e.stride / e.focal);
  const auto z = [&](int x, int y) {
    return x >= 0 && y >= 0 && x < e.width && y < e.height
               ? e.depth[static_cast<std::size_t>(y) * e.width + x]
               : 0.0F;
  };
  const auto link = [&](float a, float b, float c, float d) {
    if (!surface_continues(a, b, c, d, jump)) return -1.0F;
    return pitch * 0.5F * (b + c) + std::abs(c - b);
  };
  for (int y = 0; y < e.height; ++y) {
    for (int x = 0; x < e.width; ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * e.width + x;
      right[i] = link(z(x - 1, y), z(x, y), z(x + 1, y), z(x + 2, y));
      down[i] = link(z(x, y - 1), z(x, y), z(x, y + 1), z(x, y + 2));
    }
  }
}

/// One recursive pass there and back over `kRows` rows of `n` cells, in step: the next cell of a
/// row waits for the one before, the rows do not wait for each other.
template <int kRows>
void smooth_rows(float* sum, float* weight, const float* gain, int n) {
  const auto pull = [&](int to, int from, float a) {
    sum[to] += a * (sum[from] - sum[to]);
    weight[to] += a * (weight[from] - weight[to]);
  };
  for (int x = 1; x < n; ++x) {
    for (int i = x; i < kRows * n; i += n) pull(i, i - 1, gain[i - 1]);
  }
  for (int x = n - 2; x >= 0; --x) {
    for (int i = x; i < kRows * n; i += n) pull(i, i + 1, gain[i]);
  }
}

/// The same over all columns, whole rows at a time.
inline void smooth_columns(std::vector<float>& values, const std::vector<float>& gain, int width,
                           int height) {
  using Row = Eigen::Map<Eigen::ArrayXf>;
  const auto pull = [&](int to, int from, int gains) {
    Row row(&values[static_cast<std::size_t>(to) * width], width);
    const Row other(&values[static_cast<std::size_t>(from) * width], width);
    const Eigen::Map<const Eigen::ArrayXf> a(&gain[static_cast<std::size_t>(gains) * width], width);
    row += a * (other - row);
  };
  for (int y = 1; y < height; ++y) pull(y, y - 1, y - 1);
  for (int y = height - 2; y >= 0; --y) pull(y, y + 1, y);
}

/// Domain transform filter of evidence and its weight along the surface.
inline void share_evidence(const DepthEvidence& e, double reach, RegionGrowWorkspace& w) {
  constexpr int kPasses = 2;
  for (int pass = 0; pass < kPasses; ++pass) {
    const double sigma = reach * std::sqrt(3.0) * std::pow(2.0, kPasses - 1 - pass) /
                         std::sqrt(std::pow(4.0, kPasses) - 1.0);
    const float rate = static_cast<float>(-std::sqrt(2.0) / sigma);
    const auto gains = [&](const std::vector<float>& link) {
      for (std::size_t i = 0; i < link.size(); ++i) {
        w.gain[i] = link[i] < 0.0F ? 0.0F : std::exp(rate * link[i]);
      }
    };
    gains(w.right);
    constexpr int kTogether = 4;
    for (int y = 0; y < e.height;) {
      const std::size_t at = static_cast<std::size_t>(y) * e.width;
      const bool together = y + kTogether <= e.height;
      const auto smooth = together ? smooth_rows<kTogether> : smooth_rows<1>;
      smooth(&w.sum[at], &w.weight[at], &w.gain[at], e.width);
      y += together ? kTogether : 1;
    }
    gains(w.down);
    smooth_columns(w.sum, w.gain, e.width, e.height);
    smooth_columns(w.weight, w.gain, e.width, e.height);
  }
}

/// Cells reached from `seed` through cells for which `enter(from, to, linked)` holds, in `w.queue`.
template <typename Enter>
void flood(const DepthEvidence& e, int seed, int id, RegionGrowWorkspace& w, const Enter& enter) {
  w.queue.clear();
  w.queue.push_back(seed);
  w.region[static_cast<std::size_t>(seed)] = id;
  const auto visit = [&](int to, bool linked) {
    if (w.region[static_cast<std::size_t>(to)] >= 0 || !enter(to, linked)) return;
    w.region[static_cast<std::size_t>(to)] = id;
    w.queue.push_back(to);
  };
  for (std::size_t head = 0; head < w.queue.size(); ++head) {
    const int i = w.queue[head], x = i % e.width, y = i / e.width;
    if (x + 1 < e.width) visit(i + 1, w.right[static_cast<std::size_t>(i)] >= 0.0F);
    if (x > 0) visit(i - 1, w.right[static_cast<std::size_t>(i - 1)] >= 0.0F);
    if (y + 1 < e.height) visit(i + e.width, w.down[static_cast<std::size_t>(i)] >= 0.0F);
    if (y > 0) visit(i - e.width, w.down[static_cast<std::size_t>(i - e.width)] >= 0.0F);
  }
}

}  // namespace dynslam::geometry::detail
