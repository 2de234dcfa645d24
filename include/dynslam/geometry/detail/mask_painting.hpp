// Labels of cells to labels of pixels; a part of region_grow.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "dynslam/geometry/detail/region_completion.hpp"

namespace dynslam::geometry::detail {

/// Label of the cell around (cx, cy) that is nearest in depth to z.
inline std::uint8_t nearest_label(const DepthEvidence& e, const RegionGrowWorkspace& w, int cx,
                                  int cy, float z) {
  float best = 1e9F;
  std::uint8_t label = w.label[static_cast<std::size_t>(cy) * e.width + cx];
  for (int y = std::max(0, cy - 1); y <= std::min(e.height - 1, cy + 1); ++y) {
    for (int x = std::max(0, cx - 1); x <= std::min(e.width - 1, cx + 1); ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * e.width + x;
      if (e.depth[i] <= 0.0F) continue;
      const float away = std::abs(e.depth[i] - z) + (x == cx && y == cy ? 0.0F : 0.01F);
      if (away < best) {
        best = away;
        label = w.label[i];
      }
    }
  }
  return label;
}

/// Whether a cell and its neighbours agree, so that its pixels need no second look.
inline bool uniform(const DepthEvidence& e, const RegionGrowWorkspace& w, int cx, int cy) {
  const std::uint8_t label = w.label[static_cast<std::size_t>(cy) * e.width + cx];
  for (int y = std::max(0, cy - 1); y <= std::min(e.height - 1, cy + 1); ++y) {
    for (int x = std::max(0, cx - 1); x <= std::min(e.width - 1, cx + 1); ++x) {
      if (w.label[static_cast<std::size_t>(y) * e.width + x] != label) return false;
    }
  }
  return true;
}

/// Pixels with depth around one without, on one side of a contour.
struct Surroundings {
  int pixels = 0, adjacent = 0;
  int grey = 0;  ///< sum

  /// Squared difference from the mean grey level; from an unseen side: a moderate one.
  float unlikeness(int level) const {
    constexpr float kUnseen = 30.0F;  // grey levels
    const float away = pixels > 0 ? static_cast<float>(level) -
                                        static_cast<float>(grey) / static_cast<float>(pixels)
                                  : kUnseen;
    return away * away;
  }
};

/// Label of a pixel without depth: the pixels with depth around it vote by likeness and nearness.
inline std::uint8_t voted_label(ImageView<const float> depth, ImageView<const std::uint8_t> guide,
                                ImageView<std::uint8_t> mask, int x, int y, std::uint8_t fallback) {
  constexpr int kReach = 10;          // pixels
  constexpr float kLikeness = 12.0F;  // grey levels
  constexpr int kSteps[8][2] = {{1, 0}, {-1, 0},  {0, 1},  {0, -1},
                                {1, 1}, {-1, -1}, {1, -1}, {-1, 1}};
  float dynamic = 0.0F, total = 0.0F;
  for (const auto& step : kSteps) {
    for (int i = 1; i <= kReach; ++i) {
      const int u = x + i * step[0], v = y + i * step[1];
      if (!depth.contains(u, v)) break;
      if (!has_depth(depth(u, v))) continue;
      const float unlike = static_cast<float>(std::abs(guide(u, v) - guide(x, y))) / kLikeness;
      const float vote = 1.0F / ((1.0F + unlike * unlike) * static_cast<float>(1 + i));
      total += vote;
      dynamic += mask(u, v) != 0 ? vote : 0.0F;
      break;
    }
  }
  if (total == 0.0F) return fallback;
  return 2.0F * dynamic > total ? 255 : 0;
}

/// Label of a pixel without depth, more readily dynamic: does it look like the mover's pixels
/// around it more than like the others, and how many of them touch it? Contours are where images
/// change, so that looks tell the sides apart where depth is missing.
inline std::uint8_t alike_label(ImageView<const float> depth, ImageView<const std::uint8_t> guide,
                                ImageView<std::uint8_t> mask, int x, int y, std::uint8_t fallback) {
  constexpr int kReach = 3;  // pixels
  // Of likeness (0..1) and of what each touching pixel adds: a logistic fit, engineering.
  constexpr float kDecision = 0.7F, kTouch = 0.13F;
  Surroundings sides[2];  // static, dynamic
  for (int v = std::max(0, y - kReach); v <= std::min(mask.height - 1, y + kReach); ++v) {
    for (int u = std::max(0, x - kReach); u <= std::min(mask.width - 1, x + kReach); ++u) {
      if (!has_depth(depth(u, v))) continue;
      Surroundings& side = sides[mask(u, v) >> 7];
      ++side.pixels;
      side.grey += guide(u, v);
      side.adjacent += std::abs(u - x) <= 1 && std::abs(v - y) <= 1;
    }
  }
  if (sides[1].pixels == 0) return sides[0].pixels == 0 ? fallback : 0;
  const float from_static = sides[0].unlikeness(guide(x, y)) + 1.0F;
  const float from_dynamic = sides[1].unlikeness(guide(x, y)) + 1.0F;
  const float likeness = from_static / (from_static + from_dynamic);
  return likeness + kTouch * static_cast<float>(sides[1].adjacent) > kDecision ? 255 : 0;
}

/// Gives the pixels of a cell that have no depth their labels.
template <typename Label>
void settle_cell(ImageView<const float> depth, int stride, int cx, int cy,
                 ImageView<const std::uint8_t> guide, const Label& label,
                 ImageView<std::uint8_t> mask) {
  for (int y = cy * stride; y < std::min((cy + 1) * stride, mask.height); ++y) {
    for (int x = cx * stride; x < std::min((cx + 1) * stride, mask.width); ++x) {
      if (!has_depth(depth(x, y))) mask(x, y) = label(depth, guide, mask, x, y, mask(x, y));
    }
  }
}

/// Gives the pixels without depth along the mask's border, and around strays, their labels.
template <typename Label>
void settle_holes(ImageView<const float> depth, const DepthEvidence& e,
                  const RegionGrowWorkspace& w, ImageView<const std::uint8_t> guide,
                  const Label& label, ImageView<std::uint8_t> mask) {
  for (int cy = 0; cy < e.height; ++cy) {
    for (int cx = 0; cx < e.width; ++cx) {
      if (!uniform(e, w, cx, cy)) settle_cell(depth, e.stride, cx, cy, guide, label, mask);
    }
  }
  for (const int i : w.strays) {
    const int cx = i % e.width, cy = i / e.width;
    for (int y = std::max(0, cy - 1); y <= std::min(e.height - 1, cy + 1); ++y) {
      for (int x = std::max(0, cx - 1); x <= std::min(e.width - 1, cx + 1); ++x) {
        settle_cell(depth, e.stride, x, y, guide, label, mask);
      }
    }
  }
}

/// Brings the labels to the pixels: along the mask's border, those with depth take that of the cell
/// nearest in depth.
inline void paint(ImageView<const float> depth, const DepthEvidence& e,
                  const RegionGrowWorkspace& w, ImageView<std::uint8_t> mask) {
  for (int cy = 0; cy < e.height; ++cy) {
    const int y0 = cy * e.stride, y1 = std::min(y0 + e.stride, mask.height);
    for (int cx = 0; cx < e.width; ++cx) {
      const int x0 = cx * e.stride, x1 = std::min(x0 + e.stride, mask.width);
      const std::uint8_t label = w.label[static_cast<std::size_t>(cy) * e.width + cx];
      if (uniform(e, w, cx, cy)) {
        for (int y = y0; y < y1; ++y) std::fill(mask.row(y) + x0, mask.row(y) + x1, label);
        continue;
      }
      for (int y = y0; y < y1; ++y) {
        for (int x = x0; x < x1; ++x) {
          const float z = depth(x, y);
          mask(x, y) = has_depth(z) ? nearest_label(e, w, cx, cy, z) : label;
        }
      }
    }
  }
}

/// Gives the pixels of a static cell that lie far behind it, seen through a gap, the label of what
/// they continue. Whether there were any.
inline bool settle_gaps(ImageView<const float> depth, const DepthEvidence& e,
                        const RegionGrowWorkspace& w, int cx, int cy,
                        ImageView<std::uint8_t> mask) {
  const float around = e.depth[static_cast<std::size_t>(cy) * e.width + cx];
  bool any = false;
  for (int y = cy * e.stride; y < std::min((cy + 1) * e.stride, mask.height); ++y) {
    for (int x = cx * e.stride; x < std::min((cx + 1) * e.stride, mask.width); ++x) {
      const float z = depth(x, y);
      if (!has_depth(z) || z < around + behind_tolerance(around) || mask(x, y) != 0) continue;
      Continuation votes;
      look_behind(
          e, w, cx, cy, z, [](std::size_t) { return false; }, votes);
      if (votes.dynamic <= votes.still) continue;
      mask(x, y) = 255;
      any = true;
    }
  }
  return any;
}

/// Settles what is smaller than cells and seen through gaps in something static; adds those cells
/// to the strays.
inline void settle_strays(ImageView<const float> depth, const DepthEvidence& e,
                          RegionGrowWorkspace& w, ImageView<std::uint8_t> mask) {
  for (int i = 0; i < e.width * e.height; ++i) {
    if (w.label[static_cast<std::size_t>(i)] != 0) continue;
    if (settle_gaps(depth, e, w, i % e.width, i / e.width, mask)) w.strays.push_back(i);
  }
}

}  // namespace dynslam::geometry::detail
