// What a build can do, with Ceres and without: this file is compiled either way.
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/factors/bundle_adjustment.hpp"
#include "dynslam/factors/pose_graph.hpp"

#include "factors/synthetic_bundle.hpp"

namespace dynslam::factors {
namespace {

template <typename Call>
std::string refusal(Call&& call) {
  try {
    call();
  } catch (const InvalidArgument& e) {
    return e.what();
  }
  return "";
}

TEST(SolverChoice, OwnSolverNeedsNoCeres) {
  synthetic::Bundle b = synthetic::make_bundle({}, 1);
  const BundleSummary summary = optimize_bundle(b.view());
  EXPECT_TRUE(usable(summary.status));
  EXPECT_EQ(std::string(summary.linear_solver).find("Ceres"), std::string::npos);
}

TEST(SolverChoice, CeresRunsOrIsRefusedByNameWithNothingTouched) {
  synthetic::Bundle b = synthetic::make_bundle({}, 2);
  const synthetic::Bundle before = b;
  BundleOptions options;
  options.solver = BundleSolver::kCeres;
  BundleSummary summary;
  const std::string message = refusal([&] { summary = optimize_bundle(b.view(), options); });
  if (has_ceres()) {
    EXPECT_EQ(message, "");
    EXPECT_TRUE(usable(summary.status));
  } else {
    EXPECT_NE(message.find("options.solver"), std::string::npos) << message;
    EXPECT_NE(message.find("without Ceres"), std::string::npos) << message;
    EXPECT_EQ(b.poses[5].matrix(), before.poses[5].matrix());
    EXPECT_EQ(b.points[5], before.points[5]);
  }
}

template <typename Node, typename Edge>
void check_pose_graph() {
  std::vector<Node> nodes(2);
  Edge edge;
  edge.from = 0;
  edge.to = 1;
  const std::string message =
      refusal([&] { optimize_pose_graph(nodes, Span<const Edge>(&edge, 1)); });
  if (has_ceres()) {
    EXPECT_EQ(message, "");
  } else {
    EXPECT_NE(message.find("optimize_pose_graph"), std::string::npos) << message;
    EXPECT_NE(message.find("without Ceres"), std::string::npos) << message;
  }
}

TEST(SolverChoice, PoseGraphsRunOrAreRefusedByName) {
  check_pose_graph<RigidTransform, PoseGraphEdge>();
  check_pose_graph<Similarity, Sim3GraphEdge>();
}

}  // namespace
}  // namespace dynslam::factors
