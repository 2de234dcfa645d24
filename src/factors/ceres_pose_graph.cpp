// Pose graphs over SE(3) and Sim(3) by Ceres.
#include <cmath>
#include <vector>

#include <Eigen/Eigenvalues>
#include <ceres/solver.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/factors/ceres.hpp"
#include "dynslam/factors/pose_graph.hpp"

#include "factors/ceres_solver.hpp"

namespace dynslam::factors {
namespace {

constexpr const char* kOptimizePoseGraph = "optimize_pose_graph";

bool proper(const RigidTransform& T) { return T.all_finite(); }
bool proper(const Similarity& S) { return S.all_finite() && S.s > 0.0; }

const RigidTransform& measurement(const PoseGraphEdge& edge) { return edge.T_to_from; }
const Similarity& measurement(const Sim3GraphEdge& edge) { return edge.S_to_from; }

void add_node(ceres::Problem& problem, RigidTransform& T) { add_pose_block(problem, T); }
void add_node(ceres::Problem& problem, Similarity& S) { add_similarity_block(problem, S); }

ceres::CostFunction* make_cost(const PoseGraphEdge& edge, const Matrix6d& L) {
  return new RelativePoseCost(edge.T_to_from, L);
}
ceres::CostFunction* make_cost(const Sim3GraphEdge& edge, const Matrix7d& L) {
  return new RelativeSimilarityCost(edge.S_to_from, L);
}

RigidTransform cleaned(const RigidTransform& T) { return T.normalized(); }
Similarity cleaned(const Similarity& S) {
  return {S.s, RigidTransform(S.R, S.t).normalized().R, S.t};
}

// L with L'L = information; a direction of information 0 is free.
Eigen::MatrixXd square_root(const Eigen::MatrixXd& information) {
  require(information.allFinite(), kOptimizePoseGraph, "edges.information", "NaN or infinity",
          "a finite matrix");
  const double largest = std::max(1e-300, information.cwiseAbs().maxCoeff());
  require((information - information.transpose()).cwiseAbs().maxCoeff() <= 1e-9 * largest,
          kOptimizePoseGraph, "edges.information", "a matrix that is not symmetric",
          "a symmetric matrix");
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(information);
  require(eigen.eigenvalues()[0] >= -1e-9 * largest, kOptimizePoseGraph, "edges.information",
          eigen.eigenvalues()[0], "no negative eigenvalue");
  return eigen.eigenvalues().cwiseMax(0.0).cwiseSqrt().asDiagonal() *
         eigen.eigenvectors().transpose();
}

const char* cholesky_name(const ceres::Solver::Summary& summary) {
  switch (summary.sparse_linear_algebra_library_type) {
    case ceres::SUITE_SPARSE:
      return "Ceres SPARSE_NORMAL_CHOLESKY (SUITE_SPARSE)";
    case ceres::EIGEN_SPARSE:
      return "Ceres SPARSE_NORMAL_CHOLESKY (EIGEN_SPARSE)";
    default:
      return "Ceres SPARSE_NORMAL_CHOLESKY (other)";
  }
}

template <typename Node, typename Edge>
void check(Span<Node> nodes, Span<const Edge> edges, Span<const std::uint8_t> fixed) {
  require(fixed.empty() || fixed.size() == nodes.size(), kOptimizePoseGraph, "fixed", fixed.size(),
          "as many as nodes, or none");
  for (const Node& node : nodes)
    require(proper(node), kOptimizePoseGraph, "nodes", "NaN, infinity or a scale <= 0",
            "finite poses");
  for (const Edge& edge : edges) {
    require(edge.from < nodes.size(), kOptimizePoseGraph, "edges.from", edge.from,
            "an index of a node");
    require(edge.to < nodes.size(), kOptimizePoseGraph, "edges.to", edge.to, "an index of a node");
    require(edge.from != edge.to, kOptimizePoseGraph, "edges", "an edge from a node to itself",
            "two different nodes");
    require(proper(measurement(edge)), kOptimizePoseGraph, "edges.measurement",
            "NaN, infinity or a scale <= 0", "a finite motion");
  }
}

template <typename Node, typename Edge, typename Matrix>
PoseGraphSummary run(Span<Node> nodes, Span<const Edge> edges, Span<const std::uint8_t> fixed,
                     const PoseGraphOptions& options) {
  options.validate();
  check(nodes, edges, fixed);
  std::vector<Matrix> roots;
  for (const Edge& edge : edges) roots.push_back(square_root(edge.information));
  PoseGraphSummary summary;
  if (edges.empty()) return summary;

  std::vector<Node> state(nodes.begin(), nodes.end());
  ceres::Problem problem;
  const auto add = [&](std::uint32_t i) {
    double* block = parameter_block(state[i]);
    if (problem.HasParameterBlock(block)) return;
    add_node(problem, state[i]);
    if (fixed.empty() ? i == 0 : fixed[i] != 0) problem.SetParameterBlockConstant(block);
  };
  for (std::size_t k = 0; k < edges.size(); ++k) {
    add(edges[k].from);
    add(edges[k].to);
    ceres::LossFunction* loss =
        options.loss.kind == LossKind::kNone ? nullptr : new RobustLossFunction(options.loss);
    problem.AddResidualBlock(make_cost(edges[k], roots[k]), loss,
                             parameter_block(state[edges[k].from]),
                             parameter_block(state[edges[k].to]));
  }
  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  solver.sparse_linear_algebra_library_type = best_sparse_library();
  solver.max_num_iterations = options.max_iterations;
  solver.function_tolerance = options.cost_tolerance;
  solver.gradient_tolerance = 1e-14;
  solver.parameter_tolerance = 1e-14;
  solver.logging_type = ceres::SILENT;
  solver.num_threads = 1;
  ceres::Solver::Summary result;
  ceres::Solve(solver, &problem, &result);
  summary.initial_cost = result.initial_cost;
  summary.final_cost = result.final_cost;
  summary.iterations = static_cast<int>(result.iterations.size()) - 1;
  summary.linear_solver = cholesky_name(result);
  summary.status = status_of(result);
  if (summary.status == SolveStatus::kDegenerate) return summary;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const double* block = parameter_block(state[i]);
    if (problem.HasParameterBlock(block) && !problem.IsParameterBlockConstant(block))
      nodes[i] = cleaned(state[i]);
  }
  return summary;
}

}  // namespace

PoseGraphSummary optimize_pose_graph(Span<RigidTransform> T_cam_world,
                                     Span<const PoseGraphEdge> edges,
                                     Span<const std::uint8_t> fixed,
                                     const PoseGraphOptions& options) {
  return run<RigidTransform, PoseGraphEdge, Matrix6d>(T_cam_world, edges, fixed, options);
}

PoseGraphSummary optimize_pose_graph(Span<Similarity> S_cam_world, Span<const Sim3GraphEdge> edges,
                                     Span<const std::uint8_t> fixed,
                                     const PoseGraphOptions& options) {
  return run<Similarity, Sim3GraphEdge, Matrix7d>(S_cam_world, edges, fixed, options);
}

}  // namespace dynslam::factors
