// Pose graphs over SE(3) and Sim(3), for closing loops. Needs a build with Ceres.
#pragma once

#include <cstdint>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/factors/pose_optimizer.hpp"
#include "dynslam/factors/robust_loss.hpp"
#include "dynslam/factors/similarity.hpp"

namespace dynslam::factors {

/// Measured motion between two nodes: T_to_from = T_to_world T_from_world^-1.
struct PoseGraphEdge {
  std::uint32_t from = 0;
  std::uint32_t to = 0;
  RigidTransform T_to_from;
  Matrix6d information = Matrix6d::Identity();  ///< of the error [rho; omega], symmetric, >= 0
};

/// The same with scale.
struct Sim3GraphEdge {
  std::uint32_t from = 0;
  std::uint32_t to = 0;
  Similarity S_to_from;
  Matrix7d information = Matrix7d::Identity();  ///< of the error [rho; omega; sigma]
};

/// Options of the pose graph.
struct PoseGraphOptions {
  int max_iterations = 50;       ///< >= 1
  double cost_tolerance = 1e-9;  ///< stop on relative decrease below, >= 0
  RobustLoss loss = {};          ///< over each edge's squared error; default: none

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// What happened.
struct PoseGraphSummary {
  SolveStatus status = SolveStatus::kTooFewPoints;
  double initial_cost = 0.0;
  double final_cost = 0.0;
  int iterations = 0;
  const char* linear_solver = "";
};

/// Minimizes 1/2 sum rho(e' information e), e = log(T_to_from^-1 T_to T_from^-1), over the nodes'
/// T_cam_world, in place. `fixed`: 1 = held; empty: node 0 is held.
///
/// Throws InvalidArgument (nodes untouched) for indices out of range, an edge from a node to
/// itself, sizes that differ, non-finite nodes or measurements, information that is not symmetric
/// or has a negative eigenvalue, or a build without Ceres. No edges: TooFewPoints.
PoseGraphSummary optimize_pose_graph(Span<RigidTransform> T_cam_world,
                                     Span<const PoseGraphEdge> edges,
                                     Span<const std::uint8_t> fixed = {},
                                     const PoseGraphOptions& options = {});

/// The same over similarities S_cam_world.
PoseGraphSummary optimize_pose_graph(Span<Similarity> S_cam_world, Span<const Sim3GraphEdge> edges,
                                     Span<const std::uint8_t> fixed = {},
                                     const PoseGraphOptions& options = {});

}  // namespace dynslam::factors
