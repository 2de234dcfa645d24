#include "dynslam/factors/pose_graph.hpp"

#include "dynslam/core/errors.hpp"

namespace dynslam::factors {

void PoseGraphOptions::validate() const {
  const char* where = "PoseGraphOptions";
  require(max_iterations >= 1, where, "max_iterations", max_iterations, "at least 1");
  require(cost_tolerance >= 0.0, where, "cost_tolerance", cost_tolerance, "a number >= 0");
  loss.validate();
}

}  // namespace dynslam::factors
