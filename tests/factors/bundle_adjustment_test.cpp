#include "dynslam/factors/bundle_adjustment.hpp"

#include <atomic>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <string>

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include "factors/synthetic_bundle.hpp"

namespace dynslam::factors {
namespace {

using synthetic::Bundle;
using synthetic::BundleShape;
using synthetic::make_bundle;

BundleShape small_shape() {
  BundleShape shape;
  shape.keyframes = 6;
  shape.points = 120;
  shape.seen = 0.9;
  shape.length = 0.6;
  return shape;
}

BundleOptions precise(WeightMode mode) {
  BundleOptions options;
  options.weights = mode;
  options.max_iterations = 200;
  options.cost_tolerance = 1e-14;
  return options;
}

double largest_pose_error(const Bundle& b) {
  double worst = 0.0;
  for (std::size_t k = 0; k < b.poses.size(); ++k)
    worst = std::max(worst, se3_log(b.poses[k] * b.truth[k].inverse()).norm());
  return worst;
}

TEST(BundleAdjustment, FindsTheExactMapOfExactObservations) {
  for (const WeightMode mode : {WeightMode::kFixed, WeightMode::kJoint, WeightMode::kEliminated}) {
    for (const double depth : {0.0, 0.5, 1.0}) {
      BundleShape shape = small_shape();
      shape.noise = 0.0;
      shape.depth = depth;
      Bundle b = make_bundle(shape, 1);
      const BundleSummary summary = optimize_bundle(b.view(), precise(mode));
      EXPECT_TRUE(usable(summary.status)) << to_string(summary.status);
      EXPECT_LT(summary.final_cost, 1e-3);
      EXPECT_LT(largest_pose_error(b), 1e-4);  // pixels are floats
    }
  }
}

TEST(BundleAdjustment, JointAndEliminatedReachTheSameOptimum) {
  for (unsigned seed = 0; seed < 10; ++seed) {
    BundleShape shape = small_shape();
    shape.outliers = 0.01 * seed;
    shape.depth = 0.7;
    Bundle a = make_bundle(shape, 100 + seed);
    std::mt19937 rng(seed);
    std::uniform_real_distribution<float> uniform(0.3F, 1.0F);
    for (BundleObservation& o : a.observations) o.weight = uniform(rng);
    Bundle b = a;
    const BundleSummary joint = optimize_bundle(a.view(), precise(WeightMode::kJoint));
    const BundleSummary eliminated = optimize_bundle(b.view(), precise(WeightMode::kEliminated));
    EXPECT_NEAR(joint.final_cost, eliminated.final_cost, 1e-8 * eliminated.final_cost)
        << "seed " << seed;
    for (std::size_t i = 0; i < a.weights.size(); ++i)
      EXPECT_NEAR(a.weights[i], b.weights[i], 1e-3F);
  }
}

TEST(BundleAdjustment, OptimumIsOne) {
  // No small change of any free state lowers the cost.
  Bundle b = make_bundle(small_shape(), 3);
  BundleOptions options = precise(WeightMode::kEliminated);
  const BundleSummary best = optimize_bundle(b.view(), options);
  options.max_iterations = 1;
  const auto cost_of = [&](Bundle moved) {
    return optimize_bundle(moved.view(), options).initial_cost;
  };
  EXPECT_NEAR(cost_of(b), best.final_cost, 1e-9 * best.final_cost);
  for (int k = 0; k < 6; ++k) {
    for (const double step : {-1e-4, 1e-4}) {
      Vector6d xi = Vector6d::Zero();
      xi[k] = step;
      Bundle moved = b;
      moved.poses[3] = se3_exp(xi) * moved.poses[3];
      EXPECT_GT(cost_of(moved), best.final_cost);
      moved = b;
      moved.points[7][k % 3] += 10.0 * step;
      EXPECT_GT(cost_of(moved), best.final_cost);
    }
  }
}

TEST(BundleAdjustment, MarksOutliersAndKeepsTheRest) {
  BundleShape shape = small_shape();
  shape.outliers = 0.1;
  for (const WeightMode mode : {WeightMode::kFixed, WeightMode::kEliminated}) {
    Bundle b = make_bundle(shape, 5);
    const BundleSummary summary = optimize_bundle(b.view(), precise(mode));
    int wrong = 0, kept = 0, good = 0;
    for (std::size_t i = 0; i < b.outlier.size(); ++i) {
      wrong += b.outlier[i] && b.inliers[i];
      good += !b.outlier[i];
      kept += !b.outlier[i] && b.inliers[i];
    }
    EXPECT_LE(wrong, 2);
    EXPECT_GT(kept, 0.85 * good);
    EXPECT_EQ(summary.inliers, wrong + kept);
  }
}

TEST(BundleAdjustment, HoldsFixedKeyframesAndPoints) {
  Bundle b = make_bundle(small_shape(), 6);
  const Bundle before = b;
  std::vector<std::uint8_t> point_fixed(b.points.size(), 0);
  point_fixed[4] = 1;
  BundleProblem problem = b.view();
  problem.point_fixed = point_fixed;
  optimize_bundle(problem);
  EXPECT_EQ(b.poses[0].matrix(), before.poses[0].matrix());
  EXPECT_EQ(b.poses[1].matrix(), before.poses[1].matrix());
  EXPECT_NE(b.poses[2].matrix(), before.poses[2].matrix());
  EXPECT_EQ(b.points[4], before.points[4]);
  EXPECT_NE(b.points[5], before.points[5]);
}

TEST(BundleAdjustment, MovesOnlyPointsWhenAllKeyframesAreFixedAndOnlyKeyframesOtherwise) {
  BundleShape shape = small_shape();
  shape.fixed = shape.keyframes;
  shape.noise = 0.2;
  Bundle b = make_bundle(shape, 7);
  EXPECT_TRUE(usable(optimize_bundle(b.view(), precise(WeightMode::kFixed)).status));
  double error = 0.0;
  for (std::size_t p = 0; p < b.points.size(); ++p)
    error += (b.points[p] - b.true_points[p]).norm() / static_cast<double>(b.points.size());
  EXPECT_LT(error, 0.03);

  shape.fixed = 0;
  Bundle c = make_bundle(shape, 8);
  c.points = c.true_points;
  const std::vector<std::uint8_t> all(c.points.size(), 1);
  BundleProblem problem = c.view();
  problem.point_fixed = all;
  EXPECT_TRUE(usable(optimize_bundle(problem, precise(WeightMode::kFixed)).status));
  EXPECT_LT(largest_pose_error(c), 0.01);
}

TEST(BundleAdjustment, SparseAndDenseCamerasAgree) {
  // A long corridor is sparse; the same problem short of the threshold is dense.
  BundleShape shape;
  shape.keyframes = 60;
  shape.points = 700;
  shape.length = 60.0;
  shape.seen = 0.9;
  Bundle b = make_bundle(shape, 9);
  const BundleSummary sparse = optimize_bundle(b.view(), precise(WeightMode::kFixed));
  EXPECT_NE(std::strstr(sparse.linear_solver, "sparse"), nullptr) << sparse.linear_solver;
  EXPECT_TRUE(usable(sparse.status)) << to_string(sparse.status) << " after " << sparse.iterations;
  EXPECT_LT(sparse.final_cost, 2.0 * static_cast<double>(b.observations.size()));
  BundleOptions one = precise(WeightMode::kFixed);
  one.max_iterations = 1;
  Bundle again = b;
  EXPECT_NEAR(optimize_bundle(again.view(), one).initial_cost, sparse.final_cost,
              1e-9 * sparse.final_cost);
}

TEST(BundleAdjustment, AgreesAcrossInstructionSets) {
  const Bundle start = make_bundle(small_shape(), 10);
  Bundle reference = start;
  const BundleSummary best = optimize_bundle(reference.view(), precise(WeightMode::kFixed));
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    Bundle b = start;
    const BundleSummary summary = optimize_bundle(b.view(), precise(WeightMode::kFixed));
    EXPECT_NEAR(summary.final_cost, best.final_cost, 1e-9 * best.final_cost)
        << hwy::TargetName(target);
  }
  hwy::SetSupportedTargetsForTest(0);
}

TEST(BundleAdjustment, GivesTheSameAnswerFromAUsedWorkspace) {
  BundleWorkspace workspace;
  const Bundle start = make_bundle(small_shape(), 11);
  Bundle other = make_bundle({}, 12);
  Bundle a = start, b = start;
  optimize_bundle(a.view());
  BundleOptions brief;
  brief.max_iterations = 2;
  optimize_bundle(other.view(), brief, &workspace);
  optimize_bundle(b.view(), {}, &workspace);
  for (std::size_t k = 0; k < a.poses.size(); ++k)
    EXPECT_EQ(a.poses[k].matrix(), b.poses[k].matrix());
}

TEST(BundleAdjustment, StopsWhenAsked) {
  std::atomic<bool> abort{true};
  BundleOptions options;
  options.abort = &abort;
  Bundle b = make_bundle(small_shape(), 13);
  const Bundle before = b;
  const BundleSummary summary = optimize_bundle(b.view(), options);
  EXPECT_EQ(summary.status, SolveStatus::kAborted);
  EXPECT_EQ(b.poses[3].matrix(), before.poses[3].matrix());
  EXPECT_GT(summary.inliers, 0);
}

TEST(BundleAdjustment, AddsUpTwoSightingsFromOneKeyframe) {
  Bundle b = make_bundle(small_shape(), 14);
  Bundle doubled = b;
  doubled.observations.insert(doubled.observations.end(), b.observations.begin(),
                              b.observations.end());
  BundleOptions options = precise(WeightMode::kFixed);
  options.loss = {};
  const BundleSummary one = optimize_bundle(b.view(), options);
  const BundleSummary two = optimize_bundle(doubled.view(), options);
  EXPECT_NEAR(two.final_cost, 2.0 * one.final_cost, 1e-8 * one.final_cost);
  EXPECT_LT(se3_log(b.poses[4] * doubled.poses[4].inverse()).norm(), 1e-6);
}

// Two bundles of the same noise, one of which has other sigmas or fewer rows.
void expect_same_result(Bundle a, Bundle b) {
  optimize_bundle(a.view(), precise(WeightMode::kFixed));
  optimize_bundle(b.view(), precise(WeightMode::kFixed));
  for (std::size_t k = 0; k < a.poses.size(); ++k)
    EXPECT_EQ(a.poses[k].matrix(), b.poses[k].matrix());
}

TEST(BundleAdjustment, TakesTheSigmaOfTheKeyPointForTheRightColumnUnlessItIsGiven) {
  BundleShape shape = small_shape();
  shape.depth = 0.7;
  const Bundle b = make_bundle(shape, 15);
  Bundle given = b, none = b, mono = b;
  for (BundleObservation& o : given.observations) o.right_inverse_sigma = o.inverse_sigma;
  expect_same_result(b, given);
  for (BundleObservation& o : none.observations) o.right_inverse_sigma = 0.0F;
  for (BundleObservation& o : mono.observations) o.right_column = std::nanf("");
  expect_same_result(none, mono);
}

TEST(BundleAdjustment, BelievesDepthAsFarAsItsSigmaSays) {
  BundleShape shape = small_shape();
  shape.depth = 1.0;
  shape.noise = 0.1;
  Bundle b = make_bundle(shape, 16);
  std::mt19937 rng(4);
  std::normal_distribution<float> error(0.0F, 4.0F);
  for (BundleObservation& o : b.observations) o.right_column += error(rng);
  Bundle told = b;
  for (BundleObservation& o : told.observations) o.right_inverse_sigma = 0.1F / 4.0F;
  BundleOptions options = precise(WeightMode::kFixed);
  options.loss = {};
  optimize_bundle(b.view(), options);
  optimize_bundle(told.view(), options);
  EXPECT_LT(largest_pose_error(told), 0.3 * largest_pose_error(b));
}

// --- unlucky data ----------------------------------------------------------------------------

TEST(BundleAdjustmentStatus, IsTooFewPointsForNothing) {
  Bundle b;
  EXPECT_EQ(optimize_bundle(b.view()).status, SolveStatus::kTooFewPoints);
  b = make_bundle(small_shape(), 1);
  b.observations.clear();
  EXPECT_EQ(optimize_bundle(b.view()).status, SolveStatus::kTooFewPoints);
}

TEST(BundleAdjustmentStatus, IsTooFewPointsWhenAllPointsAreBehind) {
  Bundle b = make_bundle(small_shape(), 1);
  for (Eigen::Vector3d& X : b.points) X.z() = -X.z();
  const Bundle before = b;
  EXPECT_EQ(optimize_bundle(b.view()).status, SolveStatus::kTooFewPoints);
  EXPECT_EQ(b.points[3], before.points[3]);
  for (const std::uint8_t in : b.inliers) EXPECT_EQ(in, 0);
}

TEST(BundleAdjustmentStatus, NanTakesNoPart) {
  Bundle b = make_bundle(small_shape(), 2);
  b.points[0].y() = std::nan("");
  b.observations[200].u = std::nanf("");
  b.observations[201].v = std::numeric_limits<float>::infinity();
  b.observations[202].weight = 0.0F;
  b.observations[203].inverse_sigma = std::nanf("");
  b.observations[204].right_column = 50.0F;  // with such a sigma it is as without
  b.observations[204].right_inverse_sigma = std::numeric_limits<float>::infinity();
  const BundleSummary summary = optimize_bundle(b.view(), precise(WeightMode::kFixed));
  EXPECT_TRUE(usable(summary.status));
  EXPECT_TRUE(std::isfinite(summary.final_cost));
  for (std::size_t i = 200; i < 204; ++i) {
    EXPECT_EQ(b.inliers[i], 0);
    EXPECT_EQ(b.squared_residuals[i], std::numeric_limits<float>::infinity());
  }
  for (const RigidTransform& T : b.poses) EXPECT_TRUE(T.all_finite());
  EXPECT_LT(largest_pose_error(b), 0.02);
}

TEST(BundleAdjustmentStatus, APointSeenOnceWithoutDepthStaysWhereItIs) {
  Bundle b = make_bundle(small_shape(), 3);
  b.points.push_back({0.0, 0.0, 4.0});
  BundleObservation o;
  o.keyframe = 2;
  o.point = static_cast<std::uint32_t>(b.points.size() - 1);
  o.u = o.v = 100.0F;
  b.observations.push_back(o);
  EXPECT_TRUE(usable(optimize_bundle(b.view()).status));
  EXPECT_EQ(b.points.back(), Eigen::Vector3d(0.0, 0.0, 4.0));
  EXPECT_EQ(b.inliers.back(), 0);
}

TEST(BundleAdjustmentStatus, CoincidentPointsAndFreeGaugeStayFinite) {
  for (const WeightMode mode : {WeightMode::kFixed, WeightMode::kJoint, WeightMode::kEliminated}) {
    BundleShape shape = small_shape();
    shape.fixed = 0;
    Bundle b = make_bundle(shape, 4);
    for (Eigen::Vector3d& X : b.points) X = Eigen::Vector3d(0.0, 0.0, 3.0);
    BundleOptions options;
    options.weights = mode;
    optimize_bundle(b.view(), options);
    for (const RigidTransform& T : b.poses) EXPECT_TRUE(T.all_finite());
    for (const Eigen::Vector3d& X : b.points) EXPECT_TRUE(X.allFinite());
  }
}

// --- contracts -------------------------------------------------------------------------------

void expect_refusal(const std::string& name, const std::function<void()>& call) {
  try {
    call();
    ADD_FAILURE() << "nothing thrown for " << name;
  } catch (const InvalidArgument& e) {
    EXPECT_NE(std::string(e.what()).find(name), std::string::npos) << e.what();
  }
}

TEST(BundleAdjustmentContract, NamesWhatIsWrong) {
  const auto refuses = [](const char* name, auto&& change) {
    Bundle b = make_bundle(small_shape(), 1);
    const Bundle before = b;
    BundleProblem problem = b.view();
    change(b, problem);
    expect_refusal(name, [&] { optimize_bundle(problem); });
    EXPECT_EQ(b.points[1], before.points[1]);
  };
  const std::vector<std::uint8_t> short_flags(2, 0);
  std::vector<float> short_floats(2);
  std::vector<std::uint8_t> short_bytes(2);
  refuses("keyframe_fixed", [&](Bundle&, BundleProblem& p) { p.keyframe_fixed = short_flags; });
  refuses("point_fixed", [&](Bundle&, BundleProblem& p) { p.point_fixed = short_flags; });
  refuses("inliers", [&](Bundle&, BundleProblem& p) { p.inliers = short_bytes; });
  refuses("weights", [&](Bundle&, BundleProblem& p) { p.weights = short_floats; });
  refuses("squared_residuals",
          [&](Bundle&, BundleProblem& p) { p.squared_residuals = short_floats; });
  refuses("observations.keyframe",
          [](Bundle& b, BundleProblem&) { b.observations[9].keyframe = 6; });
  refuses("observations.point", [](Bundle& b, BundleProblem&) { b.observations[9].point = 120; });
  refuses("observations.weight", [](Bundle& b, BundleProblem&) { b.observations[9].weight = 2; });
  refuses("observations.inverse_sigma",
          [](Bundle& b, BundleProblem&) { b.observations[9].inverse_sigma = -1; });
  refuses("T_cam_world", [](Bundle& b, BundleProblem&) { b.poses[2].t.x() = std::nan(""); });
  refuses("T_cam_world.R", [](Bundle& b, BundleProblem&) { b.poses[2].R *= 1.1; });
  refuses("bf", [](Bundle&, BundleProblem& p) { p.camera.bf = 0.0; });
}

TEST(BundleOptions, RefuseByName) {
  const auto refuses = [](const char* name, auto&& change) {
    BundleOptions options;
    change(options);
    expect_refusal(name, [&] { options.validate(); });
  };
  refuses("lambda", [](auto& o) { o.lambda = std::nan(""); });
  refuses("scale", [](auto& o) { o.loss.scale = 0.0; });
  refuses("max_iterations", [](auto& o) { o.max_iterations = 0; });
  refuses("chi2_mono", [](auto& o) { o.chi2_mono = 0.0; });
  refuses("chi2_depth", [](auto& o) { o.chi2_depth = -1.0; });
  refuses("cost_tolerance", [](auto& o) { o.cost_tolerance = -1.0; });
  refuses("initial_damping", [](auto& o) { o.initial_damping = 0.0; });
  refuses("ceres_dense_keyframes", [](auto& o) { o.ceres_dense_keyframes = -1; });
}

}  // namespace
}  // namespace dynslam::factors
