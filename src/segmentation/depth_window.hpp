// The scratch of DepthRefiner: one instance and the depth around it, at half resolution.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include <opencv2/core/types.hpp>

#include "dynslam/segmentation/depth_refinement.hpp"

namespace dynslam::segmentation {

/// Whether a depth is a measurement (metres).
inline bool measured(float z) { return z > 0.0F && z < 1e4F; }

/// A depth image at half resolution: a cell is the first measured pixel of 2 x 2, 0 = none.
struct HalfDepth {
  int width = 0;
  int height = 0;
  std::vector<float> z;
  std::vector<std::uint8_t> facing;  ///< 1 where the surface is not too steep to grow over

  void build(DepthView depth, const DepthRefinementOptions& options);
  /// At the cell that a point is nearest to, at the border if it is outside.
  float nearest(cv::Point2f point) const;
  float at(int x, int y) const {
    return z[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
             static_cast<std::size_t>(x)];
  }
};

/// The depths of a window of cells with a wall of unknown depth around it, so that every cell has
/// four neighbours. A cell is a place in `z`.
struct WalledDepth {
  int width = 0;
  int height = 0;
  int stride = 0;  ///< between rows
  std::vector<float> z;

  /// Makes room for a window of the size, all unknown.
  void clear(cv::Size size);
  /// The part of `half` in `window`, which is inside of it.
  void cut(const HalfDepth& half, const cv::Rect& window);
  int cell_of(int x, int y) const { return (y + 1) * stride + x + 1; }
  int begin() const { return stride; }  ///< of the rows of the window, walls between them
  int end() const { return (height + 1) * stride; }
  std::array<int, 4> neighbours(int cell) const {
    return {cell - 1, cell + 1, cell - stride, cell + stride};
  }
  float at(int cell) const { return z[static_cast<std::size_t>(cell)]; }
};

/// How far apart two neighbours of one smooth surface may be in depth; of its own, since the loops
/// that ask write bytes, before which a compiler reads all else anew.
struct SurfaceStep {
  float share;  ///< of the depth
  float least;  ///< metres

  explicit SurfaceStep(const DepthRefinementOptions& options)
      : share(static_cast<float>(options.step_share)), least(static_cast<float>(options.step_m)) {}
  bool joins(float a, float b) const { return std::abs(a - b) <= share * std::min(a, b) + least; }
};

/// Depths from `low` to `high` (metres).
struct DepthBand {
  float low = 0.0F;
  float high = 0.0F;
  bool contains(float z) const { return z >= low && z <= high; }
};

/// Works on the cells around one instance. `open` first, then the steps, then `write`.
class DepthWindow {
 public:
  /// False if the mask has too little depth under it to say anything.
  bool open(const HalfDepth& half, const DepthRefinementOptions& options, const Instance& instance);
  /// Starts from the nearest surface of the box's middle instead of a mask.
  bool open_box(const HalfDepth& half, const DepthRefinementOptions& options,
                const Instance& instance);
  void remove_what_does_not_belong();
  void grow_beside_the_mask();
  /// The same over the whole height of the window, for regions up to `max_growth` of the mask in
  /// the cells of the half image that are not 0 in `where`.
  void grow_up_and_down(double max_growth, const std::vector<std::uint8_t>& where);
  void add_parts_behind();
  void fill_holes();
  /// Decides the border at full resolution and replaces the instance's box and mask.
  void write(DepthView depth, Instance& instance) const;

 private:
  enum : std::uint8_t {
    kMask = 1,     // the network's mask
    kIn = 2,       // belongs to the instance
    kVisited = 4,  // by the search that is going on
    kSeen = 8,     // by any search for parts behind
    kGrows = 16,   // the instance may grow here
    kSide = 32,    // at a side of the window that is inside the image, not at its border
    kWall = 64,    // no cell: around the window, so that every cell has four neighbours
  };

  void place(const HalfDepth& half, const DepthRefinementOptions& options,
             const Instance& instance);
  void build_walls(bool open_left, bool open_right);
  void paint(const Instance& instance);
  bool find_band(const std::vector<int>& cells);
  int flood_foreign_surface(int start);
  void mark_growable(const std::vector<std::uint8_t>& facing);
  bool continues(int cell, int from) const;
  int flood_beside(int start, std::vector<int>& rim);
  void grow(const std::vector<std::uint8_t>& where);
  void find_rim(std::vector<int>& rim) const;
  bool hidden_from_the_mask(const std::vector<int>& component) const;
  bool flood_apart(int start);
  void fill_hole(int start);
  cv::Rect extent() const;
  void choose_brushes(int left, int y, std::vector<std::uint8_t>& full,
                      std::vector<std::uint8_t>& by_depth) const;
  void clear_visited();

  bool is_near(int cell) const { return cell >= near_begin_ && cell < near_end_; }
  std::uint8_t& state(int cell) { return state_[static_cast<std::size_t>(cell)]; }
  std::uint8_t state(int cell) const { return state_[static_cast<std::size_t>(cell)]; }
  bool continuous(int a, int b) const { return step_.joins(depth_.at(a), depth_.at(b)); }

  const HalfDepth* half_ = nullptr;
  DepthRefinementOptions options_;
  SurfaceStep step_{options_};
  int x0_ = 0, y0_ = 0;                // of the window, in cells of the half image
  int near_begin_ = 0, near_end_ = 0;  // cells of the rows for growing beside the mask
  WalledDepth depth_;
  DepthBand band_;
  int mask_cells_ = 0;
  std::vector<std::uint8_t> state_;
  std::vector<int> queue_;
};

}  // namespace dynslam::segmentation
