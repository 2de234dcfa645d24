// What the depth of the newest frame says of masks that were made for an older one.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "segmentation/corner_tracker.hpp"
#include "segmentation/depth_window.hpp"
#include "segmentation/mask_carrier.hpp"

namespace dynslam::segmentation {

inline constexpr int kOutside = -1;  ///< label of corners that belong to no instance
inline constexpr int kUnknown = -2;  ///< and of those at the border of one

/// A corner speaks for the surface around it, half-resolution cells: twice the usual distance to
/// the next corner near masks, so that all of a surface with corners hears one.
inline constexpr int kVoiceCells = 30;

/// The instance that a corner (half resolution) is in; kUnknown next to the border of one.
int label_at(cv::Point2f at, const std::vector<Instance>& instances);

/// The median, 0 of nothing. Changes the order.
float median_of(std::vector<float>& values);

/// The median of the measured depths of a mask's cells, 0 = unknown.
float median_depth(const CellMask& mask);

/// A mask by the smooth surfaces under it: those of at least `least` cells, then all the rest,
/// which may have no cell; every part keeps the whole mask's window. O(cells).
std::vector<CellMask> smooth_parts(const CellMask& mask, const DepthRefinementOptions& options,
                                   int least);

/// Labelled corners of an older frame in the newest one, and the depths of both.
struct CarriedCorners {
  std::vector<CornerPair> pairs;
  std::vector<int> labels;  ///< of the pairs, by `label_at`
};

/// 1 for the cells of `now`, as far as they are in the window `where`, whose surface was outside
/// all masks: each cell hears the corner that is nearest on its own smooth surface, within
/// `kVoiceCells`. O(cells around `where`).
void surfaces_from_outside(const HalfDepth& now, const CarriedCorners& corners,
                           const DepthRefinementOptions& options, const cv::Rect& where,
                           std::vector<std::uint8_t>& outside);

/// 1 for the cells of `now` around an instance, that was `was` and moved by `motion`, where the
/// older frame did not show what was at its depth: behind something nearer, outside the image,
/// without depth. O(cells of the columns around the instance).
void cells_hidden_before(const CellMask& was, cv::Point2f motion, const HalfDepth& before,
                         const HalfDepth& now, int margin, std::vector<std::uint8_t>& hidden);

/// A thing that came out from behind an instance.
struct RevealedThing {
  CellMask mask;
  std::size_t hider = 0;  ///< index of the instance that hid most of it
};

/// Things that the older frame did not show, because an instance hid them, and that stand before
/// what surrounds them now. `taken`: 1 for the cells that belong to carried masks. O(cells).
std::vector<RevealedThing> revealed_things(const HalfDepth& before, const HalfDepth& now,
                                           const std::vector<Instance>& instances,
                                           const CarriedCorners& corners,
                                           const DepthRefinementOptions& options,
                                           const std::vector<std::uint8_t>& taken);

}  // namespace dynslam::segmentation
