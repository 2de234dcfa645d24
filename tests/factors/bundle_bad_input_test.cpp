// Unlucky bundles: a status and finite poses, by either solver and in every mode of the weights.
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/factors/bundle_adjustment.hpp"

#include "factors/synthetic_bundle.hpp"

namespace dynslam::factors {
namespace {

using synthetic::Bundle;
using synthetic::BundleShape;
using synthetic::make_bundle;

BundleShape tiny_shape() {
  BundleShape shape;
  shape.keyframes = 5;
  shape.points = 60;
  shape.seen = 0.9;
  shape.length = 0.6;
  return shape;
}

// What every point looks like from the true poses, without noise.
void look_again(Bundle& b) {
  for (BundleObservation& o : b.observations) {
    const Eigen::Vector3d p = b.camera.project3(b.truth[o.keyframe] * b.points[o.point]);
    o.u = static_cast<float>(p[0]);
    o.v = static_cast<float>(p[1]);
    if (std::isfinite(o.right_column)) o.right_column = static_cast<float>(p[2]);
  }
}

using Check = std::function<void(const BundleSummary&, const Bundle& result)>;

void for_each_solver(const Bundle& start, const Check& check) {
  std::vector<BundleSolver> solvers{BundleSolver::kSchur};
  if (has_ceres()) solvers.push_back(BundleSolver::kCeres);
  for (const BundleSolver solver : solvers) {
    for (const WeightMode mode :
         {WeightMode::kFixed, WeightMode::kJoint, WeightMode::kEliminated}) {
      SCOPED_TRACE(std::string(solver == BundleSolver::kCeres ? "Ceres" : "Schur") + ", mode " +
                   std::to_string(static_cast<int>(mode)));
      Bundle b = start;
      BundleOptions options;
      options.solver = solver;
      options.weights = mode;
      options.max_iterations = 30;
      const BundleSummary summary = optimize_bundle(b.view(), options);
      EXPECT_TRUE(std::isfinite(summary.initial_cost));
      EXPECT_TRUE(std::isfinite(summary.final_cost));
      for (const RigidTransform& T : b.poses) EXPECT_TRUE(T.all_finite());
      for (const float w : b.weights) EXPECT_TRUE(w >= 0.0F && w <= 1.0F);
      SCOPED_TRACE(to_string(summary.status));
      check(summary, b);
    }
  }
}

void expect_untouched(const Bundle& start, const Bundle& result) {
  for (std::size_t k = 0; k < start.poses.size(); ++k)
    EXPECT_EQ(start.poses[k].matrix(), result.poses[k].matrix());
  for (const std::uint8_t in : result.inliers) EXPECT_EQ(in, 0);
}

// Nothing to go by: TooFewPoints, and nothing moves.
void expect_too_few(const Bundle& start) {
  for_each_solver(start, [&](const BundleSummary& summary, const Bundle& result) {
    EXPECT_EQ(summary.status, SolveStatus::kTooFewPoints);
    EXPECT_EQ(summary.observations, 0);
    expect_untouched(start, result);
  });
}

TEST(BundleBadInput, NoObservations) {
  Bundle b = make_bundle(tiny_shape(), 1);
  b.observations.clear();
  expect_too_few(b);
}

TEST(BundleBadInput, AllPointsBehind) {
  Bundle b = make_bundle(tiny_shape(), 2);
  for (Eigen::Vector3d& X : b.points) X.z() = -X.z();
  expect_too_few(b);
}

TEST(BundleBadInput, AllPointsNan) {
  Bundle b = make_bundle(tiny_shape(), 3);
  for (Eigen::Vector3d& X : b.points) X.y() = std::nan("");
  expect_too_few(b);
}

TEST(BundleBadInput, AllWeightsZero) {
  Bundle b = make_bundle(tiny_shape(), 4);
  for (BundleObservation& o : b.observations) o.weight = 0.0F;
  expect_too_few(b);
}

TEST(BundleBadInput, AllWeightsNan) {
  Bundle b = make_bundle(tiny_shape(), 4);
  for (BundleObservation& o : b.observations) o.weight = std::nanf("");
  expect_too_few(b);
}

TEST(BundleBadInput, NanDepthIsMono) {
  Bundle b = make_bundle(tiny_shape(), 5);
  for (BundleObservation& o : b.observations) o.right_column = std::nanf("");
  for_each_solver(b, [&](const BundleSummary& summary, const Bundle& result) {
    EXPECT_TRUE(usable(summary.status));
    EXPECT_GT(summary.inliers, 0.8 * static_cast<double>(b.observations.size()));
    for (const Eigen::Vector3d& X : result.points) EXPECT_TRUE(X.allFinite());
  });
}

TEST(BundleBadInput, CoincidentPoints) {
  for (const double depth : {0.0, 1.0}) {
    BundleShape shape = tiny_shape();
    shape.depth = depth;
    Bundle b = make_bundle(shape, 6);
    for (Eigen::Vector3d& X : b.points) X = Eigen::Vector3d(0.1, 0.1, 3.0);
    look_again(b);
    for_each_solver(b, [](const BundleSummary& summary, const Bundle& result) {
      EXPECT_NE(summary.status, SolveStatus::kNonFinite);
      for (const Eigen::Vector3d& X : result.points) EXPECT_TRUE(X.allFinite());
    });
  }
}

TEST(BundleBadInput, PointsOnALine) {
  for (const double depth : {0.0, 1.0}) {
    BundleShape shape = tiny_shape();
    shape.depth = depth;
    Bundle b = make_bundle(shape, 7);
    for (std::size_t p = 0; p < b.points.size(); ++p)
      b.points[p] = Eigen::Vector3d(-0.5, 0.2, 3.0) +
                    0.02 * static_cast<double>(p) * Eigen::Vector3d(1, 0, 0.2);
    look_again(b);
    for_each_solver(b, [](const BundleSummary& summary, const Bundle& result) {
      EXPECT_NE(summary.status, SolveStatus::kNonFinite);
      EXPECT_LE(summary.final_cost, summary.initial_cost);
      for (const Eigen::Vector3d& X : result.points) EXPECT_TRUE(X.allFinite());
    });
  }
}

TEST(BundleBadInput, PureRotationWithoutDepthLeavesDistancesOpen) {
  BundleShape shape = tiny_shape();
  shape.depth = 0.0;
  shape.fixed = 1;
  Bundle b = make_bundle(shape, 8);
  for (std::size_t k = 0; k < b.truth.size(); ++k) {
    b.truth[k] = {so3_exp({0.0, 0.03 * static_cast<double>(k), 0.0}), Eigen::Vector3d::Zero()};
    b.poses[k] = b.truth[k];
  }
  look_again(b);
  for_each_solver(b, [](const BundleSummary& summary, const Bundle& result) {
    EXPECT_NE(summary.status, SolveStatus::kNonFinite);
    EXPECT_LE(summary.final_cost, summary.initial_cost);
    for (const Eigen::Vector3d& X : result.points) EXPECT_TRUE(X.allFinite());
  });
}

TEST(BundleBadInput, PureRotationWithDepthIsGood) {
  BundleShape shape = tiny_shape();
  Bundle b = make_bundle(shape, 9);
  for (std::size_t k = 0; k < b.truth.size(); ++k) {
    b.truth[k] = {so3_exp({0.0, 0.03 * static_cast<double>(k), 0.0}), Eigen::Vector3d::Zero()};
    if (b.fixed[k]) b.poses[k] = b.truth[k];
  }
  b.points = b.true_points;
  look_again(b);
  for_each_solver(b, [](const BundleSummary& summary, const Bundle& result) {
    EXPECT_TRUE(usable(summary.status));
    for (std::size_t k = 0; k < result.poses.size(); ++k)
      EXPECT_LT(se3_log(result.poses[k] * result.truth[k].inverse()).norm(), 1e-3);
  });
}

}  // namespace
}  // namespace dynslam::factors
