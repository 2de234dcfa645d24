// What people carry: things of no class that move because somebody holds them.
#pragma once

#include <cstddef>
#include <vector>

#include <opencv2/core/mat.hpp>

#include "dynslam/segmentation/depth_refinement.hpp"
#include "dynslam/segmentation/segmenter.hpp"

namespace dynslam::segmentation {

/// Which surfaces beside a person count as carried.
struct CarriedRegionOptions {
  double arm_m = 0.7;  ///< metres that a carried thing may be before the carrier, and beside its
                       ///< box, > 0 (an arm's length)
  double behind_m = 0.15;  ///< metres that it may be behind the carrier's median depth, >= 0
  double max_share = 0.6;  ///< of the carrier's pixels that one thing may have, > 0: what is larger
                           ///< is furniture that the carrier stands at (engineering)
  double min_contact = 0.1;      ///< share of a thing's outline that must be at the carrier, 0..1
  DepthRefinementOptions depth;  ///< what one surface is, and the camera's focal ratio

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// The pixels of things that the instances in `carriers` (indices) carry: 8UC1 of the
/// segmentation's size, 0 or 255, without the carriers' own masks. A thing is a smooth surface in
/// the carrier's reach that touches its mask, is not steep (floors, tables), is wholly within arm's
/// length of its box (what goes on is a wall or a table) and is smaller than `max_share` of it. All
/// 0 without depth.
///
/// Throws InvalidArgument for bad options, a depth of another size, or an index that is no
/// instance. O(pixels around the carriers). Thread-safe. Source: engineering, after DynaSLAM's
/// (Bescos 2018) region growing around dynamic points.
cv::Mat carried_region(const Segmentation& segmentation, const std::vector<std::size_t>& carriers,
                       DepthView depth, const CarriedRegionOptions& options = {});

}  // namespace dynslam::segmentation
