// What every measure asks of a trajectory.
#pragma once

#include <cmath>
#include <string>
#include <string_view>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/core/trajectory.hpp"

namespace dynslam::evaluation {

/// Throws InvalidArgument unless all timestamps are finite and strictly increasing.
inline void require_times(std::string_view function, std::string_view name,
                          Span<const StampedPose> trajectory) {
  for (std::size_t i = 0; i < trajectory.size(); ++i) {
    const double t = trajectory[i].timestamp;
    if (!std::isfinite(t) || (i > 0 && t <= trajectory[i - 1].timestamp)) {
      throw_invalid_argument(
          function, name,
          "timestamp " + std::to_string(t) + " at pose " + std::to_string(i) +
              (i > 0 ? " after " + std::to_string(trajectory[i - 1].timestamp) : ""),
          "finite and strictly increasing timestamps");
    }
  }
}

/// Throws InvalidArgument unless timestamps are in order and all poses finite.
inline void require_trajectory(std::string_view function, std::string_view name,
                               Span<const StampedPose> trajectory) {
  require_times(function, name, trajectory);
  for (std::size_t i = 0; i < trajectory.size(); ++i) {
    if (!trajectory[i].T_world_cam.all_finite()) {
      throw_invalid_argument(function, name, "NaN or infinity in pose " + std::to_string(i),
                             "finite poses");
    }
  }
}

}  // namespace dynslam::evaluation
