// Motion between two frames that are far apart: nothing is known of it beforehand.
#pragma once

#include <algorithm>
#include <optional>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"

#include "depth_alignment.hpp"

namespace dynslam::slam {

/// How two surfaces fit under a motion; shares are of the points of both that have depth.
struct SurfaceFit {
  double agree = 0.0;     ///< lie on the other surface and are as bright
  double conflict = 0.0;  ///< hang in space that the other camera saw through
  double behind = 0.0;    ///< are hidden by the other surface
  double seen = 0.0;      ///< lie in the other camera's image

  /// What speaks for the motion less what speaks against it, of what both cameras see; at most 1.
  /// A point in conflict weighs more than one that agrees: surfaces agree by chance, above all
  /// planes, but conflict only if something is wrong or moves. Less than half seen counts less.
  double score() const { return (agree - 2.0 * conflict - 0.5 * behind) / std::max(0.5, seen); }
};

/// Looks from both cameras at every `step`-th cell of the other's grid. O(cells / step^2).
SurfaceFit measure_fit(const SurfaceGrid& from, const SurfaceGrid& to, const PinholeCamera& camera,
                       const RigidTransform& T_from_to, int step);

/// Surface that stays where it was under a motion, as a share of what both cameras see. A cell
/// counts by the square metres that it covers, up to those at 5 m; it agrees if it lies within half
/// of SurfaceFit's tolerance on the other surface, and is as bright. Looks as measure_fit does.
double agreeing_surface(const SurfaceGrid& from, const SurfaceGrid& to, const PinholeCamera& camera,
                        const RigidTransform& T_from_to, int step);

/// Weights for SurfaceGrid::trust under which each square metre that is seen counts alike.
cv::Mat surface_by_cell(const SurfaceGrid& grid);

/// What align_wide found.
struct WideAlignment {
  SurfaceAlignment alignment;
  SurfaceFit fit;
};

/// Motion between two frames by dense alignment from many starts: the `guesses`, and rotations of
/// up to 24 degrees about the camera and about what it looks at. The starts are aligned coarsely,
/// the few that fit best finely, and the best fit is taken if it explains most of what both cameras
/// see. Where the surfaces leave a direction open and brightness does not close it, nothing.
///
/// O(starts x cells); about 20 ms. Deterministic.
std::optional<WideAlignment> align_wide(const SurfaceGrid& from, const SurfaceGrid& to,
                                        const PinholeCamera& camera,
                                        Span<const RigidTransform> guesses);

}  // namespace dynslam::slam
