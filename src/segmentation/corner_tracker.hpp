// Corners of the whole image, followed from frame to frame.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <vector>

#include <opencv2/core.hpp>

#include "segmentation/depth_window.hpp"
#include "segmentation/mask_carrier.hpp"

namespace dynslam::segmentation {

/// A corner in a frame, half resolution.
struct Corner {
  cv::Point2f at;
  cv::Point2f step;   ///< its last motion, to predict the next
  int previous = -1;  ///< its place among the corners of the frame before, -1 = new
};

/// Where a corner was and where it is now, half resolution.
struct CornerPair {
  cv::Point2f from;
  cv::Point2f to;
};

/// Square cells over an image, in pixels of it, in fields of one cell where the net of corners is
/// to be close and of two by two cells elsewhere.
struct CornerGrid {
  CornerGrid(cv::Size image, const std::vector<cv::Rect>& close);
  /// The place of the field that a cell is in: its own, or that of its first cell.
  std::size_t field_of(int column, int row) const;
  /// The same of a corner.
  std::size_t field_of(const Corner& corner) const;
  int cell;
  int columns;
  int rows;
  std::vector<std::uint8_t> is_close;  ///< of the cells
};

/// Follows a net of corners, about one in every field of a grid, through the last frames, whether
/// masks come or not. The net is close around the masks that are known, so that a new one finds a
/// wide net in its first frames.
///
/// A corner whose way back does not end where it began, or whose depth jumps by more than
/// `kMaxDepthJump` (it slipped from a thing to what is behind), ends.
class CornerTracker {
 public:
  CornerTracker(std::size_t history, double max_error_px)
      : history_(history), max_error_px_(max_error_px) {}

  /// The next frame; all of one size. `depth` has no cells if there is none. `close`: windows in
  /// which the net is to be close. O(pixels + corners).
  void add(FlowImage image, const HalfDepth& depth, const std::vector<cv::Rect>& close);

  std::size_t frames() const { return corners_.size(); }

  /// All corners of frame `place`.
  const std::vector<Corner>& of_frame(std::size_t place) const { return corners_[place]; }

  /// The corners that were seen in frame `place` (0 = the oldest) and in the newest.
  std::vector<CornerPair> pairs_since(std::size_t place) const;

 private:
  void flow(const FlowImage& image, int levels, const std::vector<cv::Point2f>& start,
            std::vector<cv::Point2f>& end, std::vector<std::uint8_t>& found) const;
  std::vector<Corner> follow(const FlowImage& image, const HalfDepth& depth) const;
  void thin_out(const CornerGrid& grid, std::vector<Corner>& corners);
  void fill_gaps(const cv::Mat& grey, const CornerGrid& grid, int first, int last,
                 std::vector<Corner>& corners);
  void renew(const cv::Mat& grey, const std::vector<cv::Rect>& close, std::vector<Corner>& corners);

  std::size_t history_;
  double max_error_px_;
  std::deque<std::vector<Corner>> corners_;  // oldest frame first
  FlowImage last_;
  std::vector<float> last_depth_;
  bool upper_ = true;                  // the half of the image whose turn it is
  std::array<double, 2> strongest_{};  // corner of the halves, when it was their turn
  std::vector<int> count_;             // of corners in every field
  cv::Mat strength_;
};

}  // namespace dynslam::segmentation
