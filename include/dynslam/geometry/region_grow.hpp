// From scattered evidence to a mask that covers the mover.
#pragma once

#include <cstdint>
#include <vector>

#include "dynslam/core/image_view.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/geometry/depth_consistency.hpp"
#include "dynslam/geometry/detail/hole_voters.hpp"
#include "dynslam/geometry/verdict.hpp"
#include "dynslam/geometry/views.hpp"

namespace dynslam::geometry {

struct RegionGrowOptions {
  double jump = 0.03;       ///< share of depth, > 0: neighbouring cells whose depths differ by more
                            ///< than slope explains are not connected; engineering
  double reach = 0.25;      ///< metres along the surface over which evidence is shared, > 0
  double fill_share = 0.5;  ///< share of dynamic among the judged cells of a depth-connected
                            ///< region that makes the whole region dynamic, (0, 1]
  double known_share = 0.0;  ///< share of all the region's cells that must be dynamic for that,
                             ///< [0, 1]: little evidence does not tell of a large surface
  double max_fill = 0.35;  ///< share of the image that such a region may cover, (0, 1]: floors and
                           ///< walls are larger
  int min_cells = 12;      ///< smaller dynamic patches are noise, >= 1
  double decision = 0.4;   ///< shared log-odds that makes a cell dynamic, > 0
  double doubt = 0.02;     ///< weight of no evidence in what is shared, >= 0: how soon what flows
                           ///< along a surface of which nothing is known fades; engineering
  double feature_weight = 4.0;  ///< cells' worth of a feature's verdict, >= 0; engineering
  /// Log-odds, >= 0: what the surfaces that continue a region behind something add to it; surer
  /// regions are not asked about. 0: sure masks only, without what is seen through gaps and with
  /// contours by the vote of both sides. Engineering.
  double completion = 1.0;
  int dilate = 0;  ///< pixels that the mask is grown at the end, >= 0

  void validate() const;
};

/// Scratch of `grow_regions`. No allocation after warm-up.
struct RegionGrowWorkspace {
  std::vector<float> sum, weight, gain, right, down;
  std::vector<std::uint8_t> label, line;
  std::vector<int> region, queue, borders, strays;
  detail::KnownPixels known;
};

/// Fills the mask of what moves (255) from cell evidence and, optionally, feature verdicts.
///
/// Evidence is shared between cells along connected depth (a recursive edge-aware filter over the
/// grid), so that holes and cells that a mover's own former image made look static are outvoted by
/// their surroundings, while floor and walls outvote what leaks onto them. Then regions between
/// depth edges that are mostly dynamic are filled, and small patches removed. Regions of which
/// little is known take after what continues them at the same depth behind nearer surfaces (legs
/// under a table). The mask is brought to full resolution along depth edges: a pixel takes the
/// label of the neighbouring cell nearest in depth, one seen through a gap that of what it
/// continues; a pixel without depth that of its cell or, given the grey image `guide`, that of the
/// side of the contour that it touches and looks like: depth is missing along contours above all.
///
/// `depth`: full resolution, metres; `mask`, and `guide` unless empty: same size.
/// `pixels`/`verdicts`: features whose log-odds are added to their cells; may be empty. Returns the
/// share of dynamic pixels. Throws InvalidArgument if sizes do not fit or options are invalid;
/// `mask` is then untouched. Under 2 ms for VGA with stride 4; no allocation after warm-up. Source:
/// the filter is the recursive domain transform of Gastal and Oliveira (SIGGRAPH 2011) with depth
/// as the guide; its use here is ours.
double grow_regions(ImageView<const float> depth, const DepthEvidence& evidence, Pixels pixels,
                    Span<const FeatureVerdict> verdicts, const RegionGrowOptions& options,
                    RegionGrowWorkspace& workspace, ImageView<std::uint8_t> mask,
                    ImageView<const std::uint8_t> guide = {});

}  // namespace dynslam::geometry

#include "dynslam/geometry/detail/region_grow_impl.hpp"
