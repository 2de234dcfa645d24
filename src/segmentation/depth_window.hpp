// The scratch of DepthRefiner: one instance and the depth around it, at half resolution.
#pragma once

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
  /// The same over the whole height of the window, for regions up to `max_growth` of the mask.
  void grow_up_and_down(double max_growth);
  void add_parts_behind();
  void fill_holes();
  /// Decides the border at full resolution and replaces the instance's box and mask.
  void write(DepthView depth, Instance& instance) const;

 private:
  enum : std::uint8_t {
    kMask = 1,     // the network's mask
    kIn = 2,       // belongs to the instance
    kVisited = 4,  // by the search that is going on
  };
  struct Extent {
    int left, top, right, bottom;
  };

  void place(const HalfDepth& half, const DepthRefinementOptions& options,
             const Instance& instance);
  void paint(const Instance& instance);
  bool find_band(const std::vector<int>& cells);
  bool one_surface(float a, float b) const;
  bool growable(int cell) const;
  int neighbours(int cell, int out[4]) const;
  bool on_side(int cell) const;
  int flood_foreign_surface(int start);
  bool continues(int cell, int from) const;
  int flood_beside(int start, std::vector<int>& rim);
  bool hidden_from_the_mask(const std::vector<int>& component) const;
  void clear_visited();

  const HalfDepth* half_ = nullptr;
  DepthRefinementOptions options_;
  int x0_ = 0, y0_ = 0, width_ = 0, height_ = 0;  // window, in cells of the half image
  int near_top_ = 0, near_bottom_ = 0;            // rows of the window for growing beside the mask
  bool open_left_ = false, open_right_ = false;   // window side inside the image, not at its border
  DepthBand band_;
  int mask_cells_ = 0;
  std::vector<std::uint8_t> state_;
  std::vector<float> z_;
  std::vector<int> queue_;
};

}  // namespace dynslam::segmentation
