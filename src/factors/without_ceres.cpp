// A build without Ceres: the Ceres routes say so by name.
#include "dynslam/core/errors.hpp"
#include "dynslam/factors/pose_graph.hpp"

#include "factors/ceres_routes.hpp"

namespace dynslam::factors {
namespace {

[[noreturn]] void refuse(const char* function) {
  throw_invalid_argument(function, "build", "a dynslam built without Ceres",
                         "one built with Ceres (see has_ceres())");
}

}  // namespace

bool has_ceres() { return false; }

BundleSummary optimize_bundle_with_ceres(const BundleProblem&, const BundleOptions&) {
  refuse("optimize_bundle");
}

PoseGraphSummary optimize_pose_graph(Span<RigidTransform>, Span<const PoseGraphEdge>,
                                     Span<const std::uint8_t>, const PoseGraphOptions&) {
  refuse("optimize_pose_graph");
}

PoseGraphSummary optimize_pose_graph(Span<Similarity>, Span<const Sim3GraphEdge>,
                                     Span<const std::uint8_t>, const PoseGraphOptions&) {
  refuse("optimize_pose_graph");
}

}  // namespace dynslam::factors
