// What a mask says, such as a segmentation's, as evidence beside what the depth says.
#pragma once

#include <cmath>
#include <cstddef>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/image_view.hpp"
#include "dynslam/geometry/depth_consistency.hpp"

namespace dynslam::geometry {

struct MaskEvidenceOptions {
  double under = 3.0;   ///< log-odds of what is under the mask, > 0: of the inner pixels of a
                        ///< network's masks nineteen in twenty are right
  double beside = 0.3;  ///< log-odds against what lies just outside of its contour, >= 0; small, as
                        ///< another mover may stand there that the network does not know
  int margin = 8;       ///< pixels that "beside" reaches, 1..64; engineering

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Adds a mask to the evidence of a frame that was judged without the depth under it.
///
/// Cells take their depth from `depth`, the whole image's; one whose pixels lie under the mask (any
/// value but 0) in a share s > 1/2 gets `under` (2 s - 1): contours, where a mask errs, say little.
/// A cell that is not under the mask but touches it, or has a masked pixel `margin` pixels to one
/// of its four sides, loses `beside`: networks see where a thing of their classes ends. Farther
/// outside a mask says nothing: a network knows few classes.
///
/// Throws InvalidArgument if depth and mask differ in size, `evidence` is not of cells of such an
/// image, or options are invalid. O(pixels), no allocation.
void add_mask(ImageView<const float> depth, MaskView mask, const MaskEvidenceOptions& options,
              DepthEvidence& evidence);

}  // namespace dynslam::geometry

#include "dynslam/geometry/detail/mask_evidence_impl.hpp"
