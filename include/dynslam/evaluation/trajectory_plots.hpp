// The usual plots of an evaluation, ready for plot_svg().
#pragma once

#include <string>
#include <vector>

#include "dynslam/core/span.hpp"
#include "dynslam/core/trajectory.hpp"
#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/evaluation/plot.hpp"

namespace dynslam::evaluation {

/// The view of a trajectory from above: coordinates 0 (x), 1 (y) or 2 (z), `across` < `up`.
struct ViewAxes {
  int across = 0;
  int up = 1;
};

/// The two axes of largest extent of the positions; x and y for fewer than two poses and for ties.
/// O(n).
ViewAxes choose_view(Span<const StampedPose> trajectory);

/// A trajectory in the truth's frame with its name, for `overlay_plot`.
struct NamedTrajectory {
  std::string name;
  Trajectory poses;
};

/// Errors of a system with its name, for `ate_over_time_plot`.
struct NamedAte {
  std::string name;
  AteResult ate;
};

// In all plots times are seconds since the first true pose (the first estimated one without truth),
// and lines are broken where two poses are more than ten median steps apart. None of these
// functions throws on empty input: the plot is then empty. They take O(n) and allocate; all are
// thread-safe.

/// Truth and aligned estimate from above with a line from each associated true position to the
/// estimated one.
Plot error_lines_plot(Span<const StampedPose> truth, const AteResult& ate, const std::string& name);

/// The associated estimate from above, coloured by its error.
Plot error_heat_plot(Span<const StampedPose> truth, const AteResult& ate);

/// Several trajectories over the truth (which may be empty) from above.
Plot overlay_plot(Span<const StampedPose> truth, const std::vector<NamedTrajectory>& systems);

/// Error of each associated pose over time, of one or several systems.
Plot ate_over_time_plot(Span<const StampedPose> truth, const std::vector<NamedAte>& systems);

/// Relative translation error over time.
Plot rpe_over_time_plot(Span<const StampedPose> truth, const RpeResult& rpe);

/// KITTI's translation error over the length of the stretch.
Plot kitti_by_length_plot(const KittiResult& kitti);

}  // namespace dynslam::evaluation
