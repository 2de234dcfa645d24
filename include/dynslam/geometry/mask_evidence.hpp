// What a mask says, such as a segmentation's, as evidence beside what the depth says.
#pragma once

#include <cmath>
#include <cstddef>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/image_view.hpp"
#include "dynslam/geometry/depth_consistency.hpp"

namespace dynslam::geometry {

/// Adds a mask to the evidence of a frame that was judged without the depth under it.
///
/// Cells take their depth from `depth`, the whole image's; one whose pixels lie under the mask (any
/// value but 0) in a share s > 1/2 gets `log_odds` (2 s - 1): contours, where a mask errs, say
/// little. That something is not under the mask says nothing: a network knows few classes.
///
/// Throws InvalidArgument if depth and mask differ in size, `evidence` is not of cells of such an
/// image, or `log_odds` is not finite and positive. O(pixels), no allocation.
void add_mask(ImageView<const float> depth, MaskView mask, double log_odds,
              DepthEvidence& evidence);

}  // namespace dynslam::geometry

#include "dynslam/geometry/detail/mask_evidence_impl.hpp"
