// Coarse copy of a depth image that a keyframe keeps to say later what it saw, and what it saw
// through.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/image_view.hpp"

namespace dynslam::geometry {

namespace detail {

/// Nearest and farthest depth and number of pixels with depth in a block of pixels.
struct DepthBlock {
  float nearest = std::numeric_limits<float>::infinity();
  float farthest = 0.0F;
  int count = 0;   ///< with depth
  int movers = 0;  ///< of these, masked

  void add(const DepthBlock& other) {
    nearest = std::min(nearest, other.nearest);
    farthest = std::max(farthest, other.farthest);
    count += other.count;
    movers += other.movers;
  }
};

}  // namespace detail

/// Nearest and farthest depth around each cell of `cell` x `cell` pixels.
///
/// `near_depth[i]`, `far_depth[i]`: over the cell and its eight neighbours, metres; both 0 where
/// less than `DepthCellsOptions::min_valid` of these pixels have depth (hole, image border, out of
/// range): then nothing is known. 173 KB for 640x480 and cell = 4.
struct DepthCells {
  PinholeCamera camera;  ///< of the full image
  int cell = 0;          ///< pixels
  int width = 0;         ///< cells
  int height = 0;        ///< cells
  std::vector<float> near_depth;
  std::vector<float> far_depth;
  std::vector<std::uint8_t> mover;         ///< 1: most of what was seen there was masked as a mover
  std::vector<detail::DepthBlock> blocks;  ///< scratch of `build_depth_cells`

  bool empty() const { return near_depth.empty(); }
};

struct DepthCellsOptions {
  int cell = 4;            ///< pixels, 1..64; engineering: 160 x 120 cells for VGA
  double min_valid = 0.6;  ///< share of pixels with depth in 3x3 cells that makes a cell known,
                           ///< (0, 1]; engineering

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Builds the cells of a depth image (metres; <= 0, NaN and infinity = none).
///
/// `mask`: what was found to move in this image (any value but 0), or empty. Cells that show a
/// mover accuse nothing later: what is nearer than a mover may always have been there (a surface
/// too near for the sensor, a hole), and their agreement counts less.
///
/// Throws InvalidArgument if image or mask has not the camera's size, or options or camera are
/// invalid; `out` is then untouched. O(pixels), about 0.3 ms for VGA; allocates only while `out`
/// grows.
void build_depth_cells(ImageView<const float> depth, const PinholeCamera& camera, MaskView mask,
                       const DepthCellsOptions& options, DepthCells& out);

/// The same without a mask.
void build_depth_cells(ImageView<const float> depth, const PinholeCamera& camera,
                       const DepthCellsOptions& options, DepthCells& out);

}  // namespace dynslam::geometry

#include "dynslam/geometry/detail/depth_cells_impl.hpp"
