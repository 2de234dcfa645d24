// Any text through the reader of trajectories, and what it read through the writer.
#pragma once

#include <cstdlib>
#include <string_view>

#include "dynslam/core/errors.hpp"
#include "dynslam/evaluation/trajectory_io.hpp"

namespace dynslam::evaluation::testing {

/// Throws IoError for what the reader refuses; aborts if it lets an unsound trajectory pass.
inline void parse_any(std::string_view text) {
  const Trajectory trajectory = parse_trajectory(text, "fuzz");
  if (trajectory.empty()) std::abort();
  for (std::size_t i = 0; i < trajectory.size(); ++i) {
    if (!trajectory[i].T_world_cam.all_finite()) std::abort();
    if (i > 0 && !(trajectory[i].timestamp > trajectory[i - 1].timestamp)) std::abort();
  }
}

}  // namespace dynslam::evaluation::testing
