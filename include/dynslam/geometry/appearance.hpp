// What looks say where depths agree: a surface that slides within itself, or takes the place of
// another, stands where a reference saw something but does not look like it.
#pragma once

#include <cstdint>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/image_view.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/geometry/depth_consistency.hpp"

namespace dynslam::geometry {

struct AppearanceOptions {
  int radius = 1;           ///< cells around a cell that are compared with it, 1..16; engineering
  double noise = 2.0;       ///< grey levels, > 0: standard deviation that means nothing, as of a
                            ///< cell seen from elsewhere; engineering
  double texture = 4.0;     ///< grey levels, >= 0: where neither image deviates by more there is
                            ///< nothing to compare; engineering
  double neutral = 0.5;     ///< likeness, in (-1, 1), that tells nothing; engineering
  double below = 0.34;      ///< and at most this much below the median of what stands still, >= 0:
                            ///< blur and an inexact pose make everything unlike; engineering
  double scale = 0.25;      ///< likeness beyond that which says all that there is to say, > 0
  double evidence = 3.0;    ///< log-odds of that, > 0; measured: 2 to 4 below, 2 to 6 above
  double least_seen = 0.4;  ///< share of the cells around that the reference must have seen, (0, 1]

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Scratch of `add_appearance`. No allocation after warm-up.
struct AppearanceWorkspace {
  std::vector<float> now, seen, before, product, rows;
  std::vector<float> sums[6];
};

/// Adds to the evidence of a frame what its cells look like in the references.
///
/// A cell that stands still looks in a reference as it does now. Where a reference's depth agrees
/// with the cell's (`kSeen`, at edges and on former movers, too), the reference's grey level is
/// read at the place where the cell would then have been. Of the (2 radius + 1)^2 cells around, as
/// far as seen, the likeness is the correlation
///
///     r = cov(I, I_ref) / sqrt((var I + noise^2) (var I_ref + noise^2))
///
/// and with q, the median of cells that stand still as far as `evidence` knows, each reference
/// changes the cell's log-odds by `evidence` clamp((min(neutral, q - below) - r) / scale, -1, 1).
/// Light that changes with time or place does not matter.
///
/// `gray`: the frame's mean grey levels of blocks of `evidence.stride` pixels, as many as there are
/// whole ones; `grays`: the same of each reference, empty ones are skipped. `consistency`: margins
/// of depth. Throws InvalidArgument if options are invalid, there are not as many `grays` as
/// `references`, one is not of such cells, or `evidence` not of this camera's. O(cells x
/// references), under 2 ms for 160 x 120 cells and 5 references; no allocation after warm-up.
/// Thread-safe with one workspace per thread. Source: normalized cross-correlation; its use beside
/// depth is ours.
void add_appearance(const PinholeCamera& camera, ImageView<const std::uint8_t> gray,
                    Span<const DepthReference> references,
                    Span<const ImageView<const std::uint8_t>> grays,
                    const DepthConsistencyOptions& consistency, const AppearanceOptions& options,
                    AppearanceWorkspace& workspace, DepthEvidence& evidence);

}  // namespace dynslam::geometry

#include "dynslam/geometry/detail/appearance_impl.hpp"
