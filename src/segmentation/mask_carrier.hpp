// Moves masks from one image to another by the motion of the corners inside them.
#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "dynslam/segmentation/segmenter.hpp"

#include "segmentation/depth_window.hpp"

namespace dynslam::segmentation {

/// Of the flow, at half resolution: window and levels above the first.
inline const cv::Size kFlowWindow(9, 9);
inline constexpr int kFlowLevels = 3;

/// A grey image at half resolution with the pyramid that optical flow needs.
struct FlowImage {
  cv::Size full;  ///< of the image it was made from
  cv::Mat grey;   ///< half resolution
  std::vector<cv::Mat> pyramid;

  bool empty() const { return grey.empty(); }
};

/// `image` as `Segmenter::segment` takes it.
FlowImage make_flow_image(const cv::Mat& image);

struct CarryOptions {
  int max_points = 150;       ///< per instance
  double max_error_px = 1.5;  ///< forward and backward, full resolution
};

/// Corners inside an instance: where they were in the instance's own image, and where they are now.
/// Half resolution.
struct PointTracks {
  std::vector<cv::Point2f> from;
  std::vector<cv::Point2f> to;
  std::vector<cv::Point2f> step;  ///< of the last advance, to predict the next
  int tried = 0;                  ///< corners at the start

  double tracked() const { return tried > 0 ? static_cast<double>(from.size()) / tried : 0.0; }
};

/// Corners inside every instance of `image`.
std::vector<PointTracks> start_tracks(const FlowImage& image,
                                      const std::vector<Instance>& instances,
                                      const CarryOptions& options);

/// Follows the corners from one image to the next; those that are lost go.
void advance_tracks(std::vector<PointTracks>& tracks, const FlowImage& from, const FlowImage& to,
                    const CarryOptions& options);

/// An instance in another image. `tracked` is the share of its corners that were found again, 0 if
/// there were none to follow (then it keeps its place); the box is empty if it left the image.
struct CarriedInstance {
  Instance instance;
  double tracked = 0.0;
};

/// Drops the pairs that move unlike the others: the background at the mask's border. Gives the
/// common motion; there must be at least one pair.
cv::Point2f keep_the_common_motion(PointTracks& motion);

/// A mask and the depth under it in cells of the half image: cell (x, y) is pixel (2x, 2y).
struct CellMask {
  cv::Rect cells;  ///< of the half image
  cv::Mat in;      ///< 8UC1, 0 or 255
  cv::Mat z;       ///< 32FC1, metres, 0 = unknown
};

/// Where cells can be after the motion; it may go beyond the image.
cv::Rect reach_of(const cv::Rect& cells, const PointTracks& motion, cv::Point2f common);

/// Cells of the half image that a box touches.
cv::Rect cells_of(const cv::Rect& box);

/// `depth` may be null.
CellMask cell_mask(const Instance& instance, const HalfDepth* depth);

/// The mask where the smooth field of the motion brings it in an image of `half` cells, `common`
/// where there are no corners; its depth comes along.
CellMask move_cells(const CellMask& source, const PointTracks& motion, cv::Point2f common,
                    cv::Size half);

/// Gives the instance the mask, at full resolution; the box is empty if nothing is left of it.
void paint_cells(const CellMask& mask, cv::Size full, Instance& instance);

/// Moves instances as their corners moved, in an image of size `full`.
std::vector<CarriedInstance> move_instances(const std::vector<Instance>& instances,
                                            const std::vector<PointTracks>& tracks, cv::Size full);

/// All three in one: carries instances from the image `from` to the image `to` of the same size.
/// The result has one entry for each instance.
std::vector<CarriedInstance> carry_instances(const FlowImage& from, const FlowImage& to,
                                             const std::vector<Instance>& instances,
                                             const CarryOptions& options);

/// How far from an instance's median depth its pixels may be, and its median from one frame to the
/// next, as a share of the depth.
inline constexpr float kMaxDepthJump = 0.10F;

/// Median of the depths under the mask (every second pixel); 0 if there are hardly any.
float median_depth(const Instance& instance, DepthView depth);

/// Takes out of a carried mask what is farther than `kMaxDepthJump` from the depth that the
/// instance had: what came before it, or what it left behind. Gives the share of the measured
/// pixels that stayed; 1, and nothing happens, without depth.
double keep_depth(Instance& instance, DepthView depth, float expected);

/// Pixels that two instances share, and the pixels of each.
struct Overlap {
  int both = 0;
  int first = 0;
  int second = 0;
  double iou() const;
  double of_smaller() const;
};
Overlap overlap_of(const Instance& first, const Instance& second);

}  // namespace dynslam::segmentation
