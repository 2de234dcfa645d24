// Which of the corners that FAST found become key points: off the mask, strong for their
// neighbourhood, and spread over the image.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "dynslam/core/image_view.hpp"
#include "dynslam/features/orb.hpp"

#include "features/orb_kernels.hpp"

namespace dynslam::features::detail {

/// Answers for a pixel of level 0 whether the mask is set within a margin of it.
class MaskProbe {
 public:
  /// Prepares for `mask`, which must stay alive while the probe is used. O(1) without margin, else
  /// O(pixels).
  void reset(MaskView mask, int margin);
  bool empty() const { return mask_.empty(); }
  bool is_set(int x, int y) const;

 private:
  MaskView mask_;
  int margin_ = 0;
  std::vector<std::int32_t> sums_;  // set pixels above and left of each pixel; with a margin only
};

/// Level-0 coordinate of what lies `offset` kSubpixel behind the centre of pixel `i` of a level.
inline float level0_coordinate(int i, int offset, float scale) {
  return from_level(static_cast<float>(i) + kSubpixel * static_cast<float>(offset), scale);
}

/// Pixel of a level that a level-0 coordinate falls into.
inline int level_pixel(float level0, float scale) {
  return static_cast<int>(std::lround(to_level(level0, scale)));
}

/// Chooses among corners; keeps its scratch between calls.
class CornerChooser {
 public:
  /// Whether a mask covers a corner of a level.
  static bool is_covered(const MaskProbe& mask, float scale, const Corner& corner) {
    // Positive: half up is as good as lround, and no call.
    const auto nearest = [](float at) { return static_cast<int>(at + 0.5F); };
    return mask.is_set(nearest(level0_coordinate(corner.x, corner.dx, scale)),
                       nearest(level0_coordinate(corner.y, corner.dy, scale)));
  }

  /// Drops the corners of a level that the mask covers. Returns the number left, in order.
  static int drop_masked(const MaskProbe& mask, float scale, Corner* corners, int count);

  /// Drops corners weaker than `threshold` from the cells that hold one which is not. Returns the
  /// number left, in order.
  int drop_weak(int cell_size, int threshold, const PixelBlock& level, Corner* corners, int count);

  /// Adds `target` of the corners (all, if there are no more) to `chosen`, in the order of the
  /// quadtree. Returns how many it added.
  ///
  /// `even_share` of them, 0..1, are spread evenly: the square around the level is quartered, its
  /// quarters are quartered, and so on, all of a size before any smaller and the fullest first,
  /// until there are as many squares with corners as are asked for; the strongest of each square is
  /// taken. The others are the strongest of the rest, wherever they are.
  int spread(const std::vector<Corner>& corners, int target, float even_share,
             std::vector<Corner>& chosen);

 private:
  struct Node {
    std::int32_t first, last;  // range of `sorted_`
  };
  void sort_by_place(const std::vector<Corner>& corners);
  int split(const Node& node, int shift);
  void grow_tree(int target);
  int score_at(const std::vector<Corner>& corners, std::int32_t i) const;
  std::int32_t strongest(const Node& node, const std::vector<Corner>& corners) const;
  void pick_evenly(const std::vector<Corner>& corners, int count);
  void pick_strongest(const std::vector<Corner>& corners, int count);

  std::vector<std::int32_t> columns_;
  std::vector<std::uint8_t> cell_has_strong_;
  std::vector<std::uint64_t> sorted_, scratch_;  // place in the quadtree (high half), corner
  std::vector<Node> open_, next_, leaves_;
  std::vector<std::int32_t> picks_;   // indices into `sorted_`
  std::vector<std::uint8_t> picked_;  // one for each of `sorted_`
};

/// How many key points each level gives: its share, as far as it has corners, and what the others
/// cannot fill in proportion to the shares.
void divide_budget(const std::vector<int>& shares, const std::vector<int>& available,
                   int max_features, std::vector<int>& take);

}  // namespace dynslam::features::detail
