// Labels of cells to labels of pixels; a part of region_grow.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "dynslam/geometry/detail/region_completion.hpp"

namespace dynslam::geometry::detail {

/// A cell and those around it that have depth.
struct CellNeighbours {
  float depth[9], farther[9];  ///< `farther`: metres by which a neighbour counts as farther away
  std::uint8_t label[9];
  int count = 0;

  CellNeighbours(const DepthEvidence& e, const RegionGrowWorkspace& w, int cx, int cy) {
    for (int y = std::max(0, cy - 1); y <= std::min(e.height - 1, cy + 1); ++y) {
      for (int x = std::max(0, cx - 1); x <= std::min(e.width - 1, cx + 1); ++x) {
        const std::size_t i = static_cast<std::size_t>(y) * e.width + x;
        if (e.depth[i] <= 0.0F) continue;
        depth[count] = e.depth[i];
        farther[count] = x == cx && y == cy ? 0.0F : 0.01F;
        label[count++] = w.label[i];
      }
    }
  }

  /// Label of the one nearest in depth to z.
  std::uint8_t nearest_label(float z, std::uint8_t fallback) const {
    float best = 1e9F;
    for (int i = 0; i < count; ++i) {
      const float away = std::abs(depth[i] - z) + farther[i];
      if (away < best) {
        best = away;
        fallback = label[i];
      }
    }
    return fallback;
  }
};

/// Lists the cells that do not agree with all their neighbours: only their pixels need a second
/// look.
inline void find_borders(const DepthEvidence& e, RegionGrowWorkspace& w) {
  w.borders.clear();
  w.line.resize(static_cast<std::size_t>(e.width));
  for (int y = 0; y < e.height; ++y) {
    const std::uint8_t* own = &w.label[static_cast<std::size_t>(y) * e.width];
    const std::uint8_t* above = y > 0 ? own - e.width : own;
    const std::uint8_t* below = y + 1 < e.height ? own + e.width : own;
    for (int x = 0; x < e.width; ++x) {
      w.line[static_cast<std::size_t>(x)] = (own[x] ^ above[x]) | (own[x] ^ below[x]);
    }
    for (int x = 0; x < e.width; ++x) {
      const int left = std::max(0, x - 1), right = std::min(e.width - 1, x + 1);
      const std::uint8_t* turns = w.line.data();  // above or below
      if (turns[left] | turns[x] | turns[right] | (own[x] ^ own[left]) | (own[x] ^ own[right])) {
        w.borders.push_back(y * e.width + x);
      }
    }
  }
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

/// Label of a pixel without depth, more readily dynamic than by vote: does it look like the mover's
/// pixels around it more than like the others, and how many of them touch it? Contours are where
/// images change, so that looks tell the sides apart where depth is missing.
inline std::uint8_t alike_label(ImageView<const float> depth, ImageView<const std::uint8_t> guide,
                                ImageView<std::uint8_t> mask, int x, int y, std::uint8_t fallback) {
  constexpr int kReach = 3;  // pixels
  // Of likeness (0..1) and of what each touching pixel adds: a logistic fit, readily dynamic.
  constexpr float kDecision = 0.6F, kTouch = 0.13F;
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

/// Gives the pixels of a cell that have no depth the label of those that they look like.
inline void settle_by_likeness(ImageView<const float> depth, int stride, int cx, int cy,
                               ImageView<const std::uint8_t> guide, ImageView<std::uint8_t> mask) {
  for (int y = cy * stride; y < std::min((cy + 1) * stride, mask.height); ++y) {
    for (int x = cx * stride; x < std::min((cx + 1) * stride, mask.width); ++x) {
      if (!has_depth(depth(x, y))) mask(x, y) = alike_label(depth, guide, mask, x, y, mask(x, y));
    }
  }
}

/// Gives the pixels without depth along the mask's border, and around strays, their labels, by
/// `settle(cx, cy)` for each cell.
template <typename Settle>
void settle_holes(const DepthEvidence& e, const RegionGrowWorkspace& w, const Settle& settle) {
  for (const int i : w.borders) settle(i % e.width, i / e.width);
  for (const int i : w.strays) {
    const int cx = i % e.width, cy = i / e.width;
    for (int y = std::max(0, cy - 1); y <= std::min(e.height - 1, cy + 1); ++y) {
      for (int x = std::max(0, cx - 1); x <= std::min(e.width - 1, cx + 1); ++x) settle(x, y);
    }
  }
}

/// Gives all pixels the labels of their cells.
inline void paint_cells(const DepthEvidence& e, const RegionGrowWorkspace& w,
                        ImageView<std::uint8_t> mask) {
  for (int cy = 0; cy < e.height; ++cy) {
    const std::uint8_t* labels = &w.label[static_cast<std::size_t>(cy) * e.width];
    std::uint8_t* first = mask.row(cy * e.stride);
    for (int cx = 0; cx < e.width;) {  // runs of one label
      const std::uint8_t label = labels[cx];
      const int x0 = cx * e.stride;
      while (cx < e.width && labels[cx] == label) ++cx;
      std::fill(first + x0, first + std::min(cx * e.stride, mask.width), label);
    }
    for (int y = cy * e.stride + 1; y < std::min((cy + 1) * e.stride, mask.height); ++y) {
      std::copy(first, first + mask.width, mask.row(y));
    }
  }
}

/// Brings the labels to the pixels: along the mask's border, those with depth take that of the cell
/// nearest in depth.
inline void paint(ImageView<const float> depth, const DepthEvidence& e,
                  const RegionGrowWorkspace& w, ImageView<std::uint8_t> mask) {
  paint_cells(e, w, mask);
  for (const int i : w.borders) {
    const int cx = i % e.width, cy = i / e.width;
    const CellNeighbours around(e, w, cx, cy);
    const std::uint8_t label = w.label[static_cast<std::size_t>(i)];
    for (int y = cy * e.stride; y < std::min((cy + 1) * e.stride, mask.height); ++y) {
      for (int x = cx * e.stride; x < std::min((cx + 1) * e.stride, mask.width); ++x) {
        const float z = depth(x, y);
        if (has_depth(z)) mask(x, y) = around.nearest_label(z, label);
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
