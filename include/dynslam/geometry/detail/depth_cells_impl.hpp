// Implementation of depth_cells.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

#include "dynslam/core/errors.hpp"
#include "dynslam/geometry/depth_cells.hpp"
#include "dynslam/geometry/verdict.hpp"

namespace dynslam::geometry {

inline void DepthCellsOptions::validate() const {
  require(cell >= 1 && cell <= 64, "DepthCellsOptions", "cell", cell, "1..64 pixels");
  require(min_valid > 0.0 && min_valid <= 1.0, "DepthCellsOptions", "min_valid", min_valid,
          "a number in (0, 1]");
}

namespace detail {

/// Summary of each of `kSize` columns of pixels: a constant number without branches between them,
/// so that adding a row is vectorized.
struct ColumnSummaries {
  static constexpr int kSize = 64;  // the largest cell fits

  float nearest[kSize], farthest[kSize];
  std::uint8_t count[kSize] = {}, movers[kSize] = {};  // at most kSize rows are added

  ColumnSummaries() {
    std::fill(nearest, nearest + kSize, DepthBlock().nearest);
    std::fill(farthest, farthest + kSize, DepthBlock().farthest);
  }
  /// `hidden`: not 0 where masked.
  void add_row(const float* depths, const std::uint8_t* hidden) {
    for (int x = 0; x < kSize; ++x) {
      const float z = depths[x];
      const bool known = (z > 0.0F) & (z <= std::numeric_limits<float>::max());
      nearest[x] = std::min(nearest[x], known ? z : std::numeric_limits<float>::infinity());
      farthest[x] = std::max(farthest[x], known ? z : 0.0F);
      count[x] += known ? 1 : 0;
      movers[x] += (known & (hidden[x] != 0)) ? 1 : 0;
    }
  }
  DepthBlock join(int first, int columns) const {
    DepthBlock block;
    for (int x = first; x < first + columns; ++x) {
      block.add({nearest[x], farthest[x], count[x], movers[x]});
    }
    return block;
  }
};

/// Columns from x0 on of the rows of pixels y0 <= y < y1. Columns outside of the image have no
/// depth; without a mask nothing is hidden.
inline ColumnSummaries summarize_columns(ImageView<const float> depth, MaskView mask, int x0,
                                         int y0, int y1) {
  constexpr int kSize = ColumnSummaries::kSize;
  const int columns = std::min(kSize, depth.width - x0);
  float depths[kSize] = {};
  std::uint8_t hidden[kSize] = {};
  ColumnSummaries sums;
  for (int y = y0; y < y1; ++y) {
    const float* z = depth.row(y) + x0;
    const std::uint8_t* m = mask.data != nullptr ? mask.row(y) + x0 : hidden;
    if (columns == kSize) {
      sums.add_row(z, m);
    } else {
      std::copy(z, z + columns, depths);
      if (mask.data != nullptr) std::copy(m, m + columns, hidden);
      sums.add_row(depths, hidden);
    }
  }
  return sums;
}

/// A row of blocks of `side` x `side` pixels, from row y0 of the image on.
inline void summarize_blocks(ImageView<const float> depth, MaskView mask, int y0, int side,
                             DepthBlock* blocks) {
  const int y1 = std::min(y0 + side, depth.height);
  const int step = ColumnSummaries::kSize / side * side;  // whole blocks
  for (int x0 = 0; x0 < depth.width; x0 += step) {
    const ColumnSummaries sums = summarize_columns(depth, mask, x0, y0, y1);
    for (int x = 0; x < step && x0 + x < depth.width; x += side) *blocks++ = sums.join(x, side);
  }
}

/// Blocks of three rows joined with their left and right neighbours.
inline void write_cell_row(const DepthBlock* const rows[3], int needed, int width, std::size_t at,
                           DepthCells& out) {
  const auto join_rows = [&](int x) {
    DepthBlock sum;
    for (int r = 0; r < 3; ++r) {
      if (rows[r] != nullptr && x < width) sum.add(rows[r][x]);
    }
    return sum;
  };
  DepthBlock left, here = join_rows(0);
  for (int x = 0; x < width; ++x) {
    const DepthBlock right = join_rows(x + 1);
    DepthBlock sum = here;
    sum.add(left);
    sum.add(right);
    left = here;
    here = right;
    const bool known = sum.count >= needed;
    const std::size_t i = at + static_cast<std::size_t>(x);
    out.near_depth[i] = known ? sum.nearest : 0.0F;
    out.far_depth[i] = known ? sum.farthest : 0.0F;
    out.mover[i] = sum.count - sum.movers < needed ? 1 : 0;
  }
}

inline void require_same_size(ImageView<const float> depth, const PinholeCamera& camera,
                              const char* function) {
  camera.validate();
  require(depth.data != nullptr, function, "depth", "null", "an image");
  require(depth.width == camera.width, function, "depth.width", depth.width,
          std::to_string(camera.width) + ", the camera's");
  require(depth.height == camera.height, function, "depth.height", depth.height,
          std::to_string(camera.height) + ", the camera's");
}

}  // namespace detail

inline void build_depth_cells(ImageView<const float> depth, const PinholeCamera& camera,
                              MaskView mask, const DepthCellsOptions& options, DepthCells& out) {
  options.validate();
  detail::require_same_size(depth, camera, "build_depth_cells");
  require(mask.data == nullptr || mask.same_size(depth), "build_depth_cells", "mask.width x height",
          std::to_string(mask.width) + " x " + std::to_string(mask.height),
          std::to_string(depth.width) + " x " + std::to_string(depth.height) + ", or no mask");
  const int side = options.cell;
  const int width = (depth.width + side - 1) / side, height = (depth.height + side - 1) / side;
  const int needed =
      std::max(1, static_cast<int>(std::ceil(options.min_valid * 9.0 * side * side)));
  // Three rows of blocks in turn; they live in the outputs' own vector of blocks.
  out.blocks.resize(static_cast<std::size_t>(width) * 3);
  out.near_depth.resize(static_cast<std::size_t>(width) * height);
  out.far_depth.resize(out.near_depth.size());
  out.mover.resize(out.near_depth.size());
  const auto block_row = [&](int y) { return out.blocks.data() + (y % 3) * width; };
  const auto fill = [&](int y) {
    detail::summarize_blocks(depth, mask, y * side, side, block_row(y));
  };
  fill(0);
  for (int y = 0; y < height; ++y) {
    if (y + 1 < height) fill(y + 1);
    const detail::DepthBlock* rows[3] = {y > 0 ? block_row(y - 1) : nullptr, block_row(y),
                                         y + 1 < height ? block_row(y + 1) : nullptr};
    const std::size_t at = static_cast<std::size_t>(y) * width;
    detail::write_cell_row(rows, needed, width, at, out);
  }
  out.camera = camera;
  out.cell = side;
  out.width = width;
  out.height = height;
}

inline void build_depth_cells(ImageView<const float> depth, const PinholeCamera& camera,
                              const DepthCellsOptions& options, DepthCells& out) {
  build_depth_cells(depth, camera, MaskView(), options, out);
}

}  // namespace dynslam::geometry
