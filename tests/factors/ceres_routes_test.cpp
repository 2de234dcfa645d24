// Bundle adjustment through Ceres against dynslam's own solver, and pose graphs.
#include <atomic>
#include <cmath>
#include <cstring>
#include <functional>
#include <string>

#include <gtest/gtest.h>

#include "dynslam/factors/bundle_adjustment.hpp"
#include "dynslam/factors/pose_graph.hpp"

#include "factors/synthetic_bundle.hpp"

namespace dynslam::factors {
namespace {

using synthetic::Bundle;
using synthetic::BundleShape;
using synthetic::make_bundle;
using synthetic::random_twist;

TEST(CeresRoute, AgreesWithTheSchurSolverForEveryModeAndLoss) {
  ASSERT_TRUE(has_ceres());
  BundleShape shape;
  shape.keyframes = 5;
  shape.points = 80;
  shape.seen = 0.9;
  shape.depth = 0.6;
  shape.outliers = 0.02;
  shape.start_point = 0.01;
  shape.start_distance = 0.01;
  shape.start_rotation = 0.002;
  const std::pair<WeightMode, RobustLoss> cases[] = {
      {WeightMode::kFixed, {}},
      {WeightMode::kFixed, {LossKind::kHuber, 2.447, 1.0}},
      {WeightMode::kFixed, {LossKind::kCauchy, 2.0, 1.0}},
      {WeightMode::kFixed, {LossKind::kBarron, 2.0, 0.5}},
      {WeightMode::kJoint, {}},
      {WeightMode::kEliminated, {}}};
  for (const auto& [mode, loss] : cases) {
    Bundle a = make_bundle(shape, 21);
    std::mt19937 rng(1);
    std::uniform_real_distribution<float> uniform(0.5F, 1.0F);
    for (BundleObservation& o : a.observations) {
      o.weight = uniform(rng);
      if (o.point % 2 == 0) o.right_inverse_sigma = uniform(rng);
    }
    Bundle b = a;
    BundleOptions options;
    options.weights = mode;
    options.loss = loss;
    options.max_iterations = 200;
    options.cost_tolerance = 1e-12;
    const BundleSummary own = optimize_bundle(a.view(), options);
    options.solver = BundleSolver::kCeres;
    const BundleSummary ceres = optimize_bundle(b.view(), options);
    EXPECT_NEAR(own.initial_cost, ceres.initial_cost, 1e-9 * own.initial_cost);
    EXPECT_NEAR(own.final_cost, ceres.final_cost, 1e-6 * own.final_cost)
        << "mode " << static_cast<int>(mode) << " loss " << static_cast<int>(loss.kind);
    EXPECT_EQ(own.observations, ceres.observations);
    EXPECT_NEAR(own.inliers, ceres.inliers, 1);
    EXPECT_NE(std::strstr(ceres.linear_solver, "Ceres"), nullptr);
    EXPECT_EQ(a.poses[0].matrix(), b.poses[0].matrix());
  }
}

TEST(CeresRoute, SaysWhichLinearSolverRan) {
  BundleShape shape;
  shape.keyframes = 5;
  shape.points = 60;
  for (const double depth : {0.0, 1.0}) {
    shape.depth = depth;
    Bundle a = make_bundle(shape, 22);
    Bundle b = a;
    BundleOptions options;
    options.solver = BundleSolver::kCeres;
    options.cost_tolerance = 1e-12;
    options.max_iterations = 50;
    const BundleSummary dense = optimize_bundle(a.view(), options);
    EXPECT_STREQ(dense.linear_solver, "Ceres DENSE_SCHUR");
    options.ceres_dense_keyframes = 0;
    const BundleSummary sparse = optimize_bundle(b.view(), options);
    EXPECT_NE(std::strstr(sparse.linear_solver, "Ceres SPARSE_SCHUR ("), nullptr);
    EXPECT_NEAR(dense.final_cost, sparse.final_cost, 1e-8 * dense.final_cost);
  }
}

TEST(CeresRoute, StopsWhenAskedAndSaysTooFew) {
  std::atomic<bool> abort{true};
  BundleOptions options;
  options.solver = BundleSolver::kCeres;
  options.abort = &abort;
  Bundle b = make_bundle({}, 13);
  EXPECT_EQ(optimize_bundle(b.view(), options).status, SolveStatus::kAborted);
  b.observations.clear();
  EXPECT_EQ(optimize_bundle(b.view(), options).status, SolveStatus::kTooFewPoints);
}

TEST(CeresRoute, LeavesOutNanAndPointsBehind) {
  BundleShape shape;
  shape.keyframes = 5;
  shape.points = 60;
  Bundle b = make_bundle(shape, 14);
  b.points[0].x() = std::nan("");
  b.observations[50].u = std::nanf("");
  b.points[5] = Eigen::Vector3d(0.0, 0.0, -3.0);
  BundleOptions options;
  options.solver = BundleSolver::kCeres;
  const BundleSummary summary = optimize_bundle(b.view(), options);
  EXPECT_TRUE(usable(summary.status));
  EXPECT_EQ(b.inliers[50], 0);
  for (const RigidTransform& T : b.poses) EXPECT_TRUE(T.all_finite());
}

// A ring of poses measured from each to the next, drifting, and closed.
struct Ring {
  std::vector<RigidTransform> truth, poses;
  std::vector<PoseGraphEdge> edges;
};

Ring make_ring(int n, double noise, unsigned seed) {
  std::mt19937 rng(seed);
  Ring ring;
  for (int i = 0; i < n; ++i) {
    const double angle = 2.0 * M_PI * i / n;
    const Eigen::Matrix3d R = so3_exp({0.0, angle, 0.0});
    ring.truth.push_back(
        {R, -R * Eigen::Vector3d(5.0 * std::cos(angle), 0, 5.0 * std::sin(angle))});
  }
  for (int i = 0; i < n; ++i) {
    PoseGraphEdge edge;
    edge.from = static_cast<std::uint32_t>(i);
    edge.to = static_cast<std::uint32_t>((i + 1) % n);
    edge.T_to_from = se3_exp(random_twist(rng, noise, 0.3 * noise)) * ring.truth[edge.to] *
                     ring.truth[edge.from].inverse();
    edge.information = Vector6d(1.0, 1.0, 1.0, 10.0, 10.0, 10.0).asDiagonal();
    ring.edges.push_back(edge);
  }
  ring.poses.push_back(ring.truth[0]);
  for (int i = 0; i + 1 < n; ++i) ring.poses.push_back(ring.edges[i].T_to_from * ring.poses[i]);
  return ring;
}

TEST(PoseGraph, RecoversAnExactRingFromABadStart) {
  Ring ring = make_ring(30, 0.0, 1);
  std::mt19937 rng(2);
  for (std::size_t i = 1; i < ring.poses.size(); ++i)
    ring.poses[i] = se3_exp(random_twist(rng, 0.5, 0.2)) * ring.poses[i];
  const PoseGraphSummary summary = optimize_pose_graph(ring.poses, ring.edges);
  EXPECT_EQ(summary.status, SolveStatus::kConverged);
  EXPECT_LT(summary.final_cost, 1e-12);
  for (std::size_t i = 0; i < ring.poses.size(); ++i)
    EXPECT_LT(se3_log(ring.poses[i] * ring.truth[i].inverse()).norm(), 1e-5);
}

TEST(PoseGraph, SpreadsTheDriftWhenALoopCloses) {
  Ring ring = make_ring(60, 0.05, 3);
  const auto end_error = [&] {
    return se3_log(ring.poses.back() * ring.truth.back().inverse()).norm();
  };
  const double drifted = end_error();
  const RigidTransform first = ring.poses[0];
  const PoseGraphSummary summary = optimize_pose_graph(ring.poses, ring.edges);
  EXPECT_EQ(summary.status, SolveStatus::kConverged);
  EXPECT_LT(summary.final_cost, summary.initial_cost);
  EXPECT_LT(end_error(), 0.5 * drifted);
  EXPECT_EQ(ring.poses[0].matrix(), first.matrix());
}

TEST(PoseGraph, RobustLossSurvivesAWrongLoop) {
  Ring ring = make_ring(30, 0.0, 4);
  PoseGraphEdge wrong;
  wrong.from = 3;
  wrong.to = 18;
  wrong.T_to_from = RigidTransform();
  ring.edges.push_back(wrong);
  PoseGraphOptions options;
  options.loss = {LossKind::kGemanMcClure, 0.5, 0.0};
  const PoseGraphSummary summary = optimize_pose_graph(ring.poses, ring.edges, {}, options);
  EXPECT_TRUE(usable(summary.status));
  EXPECT_LT(se3_log(ring.poses[18] * ring.truth[18].inverse()).norm(), 0.02);
}

TEST(PoseGraph, Sim3TakesOutTheDriftOfScale) {
  const Ring ring = make_ring(40, 0.0, 5);
  std::vector<Similarity> truth, poses;
  std::vector<Sim3GraphEdge> edges;
  double scale = 1.0;
  for (const RigidTransform& T : ring.truth) {
    truth.emplace_back(T);
    Similarity drifted(T);
    drifted.s = scale;
    drifted.t *= scale;
    poses.push_back(drifted);
    scale *= 1.02;
  }
  poses[0] = truth[0];
  for (const PoseGraphEdge& edge : ring.edges) {
    Sim3GraphEdge e;
    e.from = edge.from;
    e.to = edge.to;
    e.S_to_from = truth[edge.to] * truth[edge.from].inverse();
    edges.push_back(e);
  }
  const PoseGraphSummary summary = optimize_pose_graph(poses, edges);
  EXPECT_EQ(summary.status, SolveStatus::kConverged);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    EXPECT_NEAR(poses[i].s, 1.0, 1e-4);
    EXPECT_LT((poses[i].rigid().inverse().t - ring.truth[i].inverse().t).norm(), 1e-3);
  }
}

TEST(PoseGraph, HoldsWhatIsFixedAndDoesNothingWithoutEdges) {
  Ring ring = make_ring(10, 0.05, 6);
  const Ring before = ring;
  std::vector<std::uint8_t> fixed(10, 0);
  fixed[0] = fixed[9] = 1;
  optimize_pose_graph(ring.poses, ring.edges, fixed);
  EXPECT_EQ(ring.poses[9].matrix(), before.poses[9].matrix());
  EXPECT_NE(ring.poses[5].matrix(), before.poses[5].matrix());
  EXPECT_EQ(optimize_pose_graph(ring.poses, Span<const PoseGraphEdge>()).status,
            SolveStatus::kTooFewPoints);
}

TEST(PoseGraphContract, NamesWhatIsWrong) {
  const auto refuses = [](const char* name, auto&& change) {
    Ring ring = make_ring(10, 0.01, 7);
    change(ring);
    const Ring before = ring;
    try {
      optimize_pose_graph(ring.poses, ring.edges);
      ADD_FAILURE() << "nothing thrown for " << name;
    } catch (const InvalidArgument& e) {
      EXPECT_NE(std::string(e.what()).find(name), std::string::npos) << e.what();
    }
    EXPECT_EQ(ring.poses[4].t, before.poses[4].t);
  };
  refuses("edges.from", [](Ring& r) { r.edges[2].from = 10; });
  refuses("edges.to", [](Ring& r) { r.edges[2].to = 10; });
  refuses("itself", [](Ring& r) { r.edges[2].to = r.edges[2].from; });
  refuses("edges.measurement", [](Ring& r) { r.edges[2].T_to_from.t.x() = std::nan(""); });
  refuses("nodes", [](Ring& r) { r.poses[2].t.x() = std::nan(""); });
  refuses("finite matrix", [](Ring& r) { r.edges[2].information(0, 0) = std::nan(""); });
  refuses("symmetric", [](Ring& r) { r.edges[2].information(0, 1) = 1.0; });
  refuses("eigenvalue", [](Ring& r) { r.edges[2].information(0, 0) = -1.0; });
  Ring ring = make_ring(10, 0.01, 7);
  const std::vector<std::uint8_t> few(3, 0);
  EXPECT_THROW(optimize_pose_graph(ring.poses, ring.edges, few), InvalidArgument);
  PoseGraphOptions options;
  options.max_iterations = 0;
  EXPECT_THROW(optimize_pose_graph(ring.poses, ring.edges, {}, options), InvalidArgument);
  options = {};
  options.cost_tolerance = -1.0;
  EXPECT_THROW(optimize_pose_graph(ring.poses, ring.edges, {}, options), InvalidArgument);
  std::vector<Similarity> shrunk(2);
  shrunk[1].s = 0.0;
  Sim3GraphEdge edge;
  edge.to = 1;
  EXPECT_THROW(optimize_pose_graph(shrunk, Span<const Sim3GraphEdge>(&edge, 1)), InvalidArgument);
}

}  // namespace
}  // namespace dynslam::factors
