// Masks that follow the depth image; masks from boxes and depth alone.
#pragma once

#include <memory>
#include <vector>

#include <opencv2/core/types.hpp>

#include "dynslam/segmentation/segmenter.hpp"

namespace dynslam::segmentation {

/// How masks are fitted to depth. Lengths are relative, so that nothing depends on the camera but
/// `focal_ratio`.
struct DepthRefinementOptions {
  double focal_ratio = 0.8;  ///< focal length / image width, > 0; to tell floors from fronts
  /// Neighbouring pixels are one surface if their depths differ by less than this share of the
  /// depth, plus `step_m`; > 0 (a Kinect's noise and quantization at 3 m are about 1 %)
  double step_share = 0.015;
  double step_m = 0.02;      ///< metres, >= 0
  double max_slant = 1.2;    ///< growing stops at surfaces steeper than this (tangent; floors), > 0
  double max_growth = 0.6;   ///< a region next to the mask joins if it is at most this share of the
                             ///< mask's area, >= 0
  double max_removal = 0.4;  ///< at most this share of a mask is taken out as background or as
                             ///< what stands before, 0..1; if it would be more, nothing is
  double side_margin = 0.25;  ///< a mask grows at most this share of its box's width or height
                              ///< (the smaller) beyond the box, 0..1
  double reach = 2.0;  ///< parts behind something nearer are looked for this many box heights above
                       ///< and below, >= 0; 0 = not at all

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Fits masks to the depth image of their frame.
///
/// For every instance: the depth band of its mask (the mode of the depths under it, extended while
/// the histogram goes on); pixels of the mask that no smooth path inside it joins to the band are
/// taken out (background seen through, things standing before it); smooth surfaces in the band that
/// continue the mask outside are added unless they are steep (floors, tables) or run out of the
/// neighbourhood (walls); parts of the same depth above or below something nearer are added (legs
/// under a table); holes of the depth image inside the mask are filled. Pixels without depth keep
/// what the network said.
///
/// Works at half resolution, with the border decided at full resolution. Source: engineering, after
/// the depth-based region growing of DynaSLAM (Bescos 2018) and NGD-SLAM (2024), described in
/// docs/components/segmentation.md.
///
/// Not thread-safe: it owns its scratch.
class DepthRefiner {
 public:
  /// Throws InvalidArgument for bad options.
  explicit DepthRefiner(const DepthRefinementOptions& options = {});
  ~DepthRefiner();
  DepthRefiner(DepthRefiner&&) noexcept;
  DepthRefiner& operator=(DepthRefiner&&) noexcept;

  /// Changes boxes and masks of `segmentation` in place; an instance is never lost and nothing
  /// happens where there is no depth. Throws InvalidArgument if the depth's size is not the
  /// segmentation's. O(pixels + pixels around the boxes).
  void refine(Segmentation& segmentation, DepthView depth);

  /// Makes the masks of `segmentation` from its boxes: the nearest surface that takes a good part
  /// of the box's middle, grown as above. Where the box has no depth the mask is the whole box. For
  /// networks that give boxes only; throws and costs as `refine`.
  void masks_from_boxes(Segmentation& segmentation, DepthView depth);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dynslam::segmentation
