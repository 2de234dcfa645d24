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

inline DepthBlock summarize_block(ImageView<const float> depth, MaskView mask, int x0, int y0,
                                  int side) {
  DepthBlock block;
  const int x1 = std::min(x0 + side, depth.width), y1 = std::min(y0 + side, depth.height);
  for (int y = y0; y < y1; ++y) {
    const float* row = depth.row(y);
    const std::uint8_t* hidden = mask.data != nullptr ? mask.row(y) : nullptr;
    for (int x = x0; x < x1; ++x) {
      const float z = row[x];
      if (!has_depth(z)) continue;
      block.movers += hidden != nullptr && hidden[x] != 0;
      block.nearest = std::min(block.nearest, z);
      block.farthest = std::max(block.farthest, z);
      ++block.count;
    }
  }
  return block;
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
    for (int x = 0; x < width; ++x) {
      block_row(y)[x] = detail::summarize_block(depth, mask, x * side, y * side, side);
    }
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
