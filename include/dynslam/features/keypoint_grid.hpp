// Key points sorted into square cells, to find those near a place.
#pragma once

#include <cstdint>
#include <vector>

#include <opencv2/core/types.hpp>

#include "dynslam/core/span.hpp"

namespace dynslam::features {

/// Bucket grid over key point positions.
///
/// Positions are copied into the cells' order, so nothing refers to the
/// caller's array after `build`. Rebuilding for as many points on as large an
/// image allocates nothing. Const members may be called from several threads at
/// once.
class KeypointGrid {
 public:
  /// Replaces the content by `positions`, pixels of an image of `width` x
  /// `height`, in square cells of `cell_size` pixels. Key point i of every
  /// other function is positions[i].
  ///
  /// Bind key points with `field(keypoints, &cv::KeyPoint::pt)`. Positions
  /// outside the image are kept and found (in the border's cells); positions
  /// with a NaN are never found. Throws InvalidArgument if width, height or
  /// cell_size is below 1. O(N + cells).
  void build(StridedSpan<const cv::Point2f> positions, int width, int height, int cell_size = 24);

  /// Number of positions given to `build`, NaN included.
  std::size_t size() const { return size_; }

  /// Replaces `indices` by the key points with |x - centre.x| <= radius and |y
  /// - centre.y| <= radius, in ascending order. None if radius < 0 or anything
  /// is NaN. O(points in the cells touched); allocates only if `indices` must
  /// grow.
  void find(cv::Point2f centre, float radius, std::vector<std::int32_t>& indices) const;

  /// Calls `visit(index)` for the same key points, by cells (row by row),
  /// without a list.
  template <typename Visitor>
  void visit(cv::Point2f centre, float radius, Visitor&& visit) const {
    const Cells cells = cells_of(centre, radius);
    for (int row = cells.first_row; row <= cells.last_row; ++row) {
      const std::int32_t* starts = starts_.data() + static_cast<std::ptrdiff_t>(row) * columns_;
      // The cells of a row lie one after the other: a single run of entries.
      for (std::int32_t i = starts[cells.first_column]; i < starts[cells.last_column + 1]; ++i) {
        const Entry& entry = entries_[static_cast<std::size_t>(i)];
        const float dx = entry.x - centre.x;
        const float dy = entry.y - centre.y;
        if (dx <= radius && -dx <= radius && dy <= radius && -dy <= radius) visit(entry.index);
      }
    }
  }

 private:
  struct Entry {
    float x, y;
    std::int32_t index;
  };
  /// Inclusive ranges; empty if last_row < first_row.
  struct Cells {
    int first_column, last_column, first_row, last_row;
  };
  Cells cells_of(cv::Point2f centre, float radius) const;
  int column_of(float x) const;
  int row_of(float y) const;

  std::size_t size_ = 0;
  int columns_ = 0;
  int rows_ = 0;
  float cells_per_pixel_ = 1.0F;
  std::vector<std::int32_t> starts_;  // first entry of each cell, row by row, and one past the end
  std::vector<Entry> entries_;        // by cell, ascending index within a cell
};

}  // namespace dynslam::features
