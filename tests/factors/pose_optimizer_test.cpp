#include "dynslam/factors/pose_optimizer.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include "dynslam/factors/static_weight.hpp"

#include "factors/synthetic.hpp"

namespace dynslam::factors {
namespace {

using synthetic::Frame;
using synthetic::FrameOptions;
using synthetic::make_frame;
using synthetic::pose_error;

constexpr WeightMode kModes[] = {WeightMode::kFixed, WeightMode::kJoint, WeightMode::kEliminated};

PoseOptimizerOptions precise_pose(WeightMode mode) {
  PoseOptimizerOptions options;
  options.weights = mode;
  options.max_iterations = 100;
  options.step_tolerance = 1e-11;
  options.cost_tolerance = 0.0;
  return options;
}

TEST(PoseOptimizer, FindsTheExactPoseOfExactPoints) {
  for (const WeightMode mode : kModes) {
    for (const bool depth : {true, false}) {
      FrameOptions o;
      o.points = 60;
      o.noise = 0.0;
      o.depth = depth;
      const Frame f = make_frame(o, 1);
      PoseOptimizer optimizer(precise_pose(mode));
      const PoseResult result = optimizer.optimize(f.camera, f.view(), f.start);
      EXPECT_TRUE(result) << to_string(result.status);
      // Pixels are floats: their rounding is what is left.
      EXPECT_LT(se3_log(result.T_cam_world * f.truth.inverse()).norm(), 1e-5);
      EXPECT_EQ(result.inliers, 60);
      EXPECT_EQ(result.observations, 60);
      EXPECT_GT(result.initial_cost, result.final_cost);
    }
  }
}

TEST(PoseOptimizer, JointAndEliminatedReachTheSameOptimum) {
  for (unsigned seed = 0; seed < 100; ++seed) {
    FrameOptions o;
    o.points = 200;
    o.movers = 0.6 * seed / 99.0;
    o.outliers = 0.05;
    Frame f = make_frame(o, 1000 + seed);
    std::mt19937 rng(seed);
    std::uniform_real_distribution<float> uniform(0.3F, 1.0F);
    for (float& weight : f.weights) weight = uniform(rng);
    PoseOptimizer joint(precise_pose(WeightMode::kJoint));
    PoseOptimizer eliminated(precise_pose(WeightMode::kEliminated));
    const PoseResult a = joint.optimize(f.camera, f.view(), f.start);
    const PoseResult b = eliminated.optimize(f.camera, f.view(), f.start);
    EXPECT_EQ(a.status, SolveStatus::kConverged);
    EXPECT_EQ(b.status, SolveStatus::kConverged);
    EXPECT_NEAR(a.final_cost, b.final_cost, 1e-9 * b.final_cost) << "seed " << seed;
    EXPECT_LT(se3_log(a.T_cam_world * b.T_cam_world.inverse()).norm(), 1e-8) << "seed " << seed;
    EXPECT_EQ(a.inliers, b.inliers);
    for (std::size_t i = 0; i < f.weights.size(); ++i)
      EXPECT_NEAR(joint.weights()[i], eliminated.weights()[i], 1e-5F);
  }
}

TEST(PoseOptimizer, EliminatedHalvesHubersErrorAmongMovers) {
  // 40 % of the points move as one; the masks miss half of them. Both detectors count 0.5.
  std::vector<double> eliminated_errors, huber_errors;
  PoseOptimizer eliminated;
  PoseOptimizerOptions options;
  options.weights = WeightMode::kFixed;
  PoseOptimizer huber(options);
  for (unsigned seed = 0; seed < 100; ++seed) {
    FrameOptions o;
    o.movers = 0.4;
    Frame f = make_frame(o, 7000 + seed);
    const std::vector<float> nothing_known(f.weights.size(), 1.0F);
    std::mt19937 rng(seed);
    for (std::size_t i = 0; i < f.weights.size(); ++i) {
      const bool masked = f.moves[i] != 0 && rng() % 2 == 0;
      const DetectorVote votes[] = {{masked ? 0.0 : 1.0, 0.5}, {1.0, 0.5}};
      f.weights[i] = static_cast<float>(initial_weight(votes));
    }
    const PoseResult a = eliminated.optimize(f.camera, f.view(), f.start);
    f.weights = nothing_known;
    const PoseResult b = huber.optimize(f.camera, f.view(), f.start);
    eliminated_errors.push_back(pose_error(a.T_cam_world, f.truth));
    huber_errors.push_back(pose_error(b.T_cam_world, f.truth));
  }
  std::nth_element(eliminated_errors.begin(), eliminated_errors.begin() + 50,
                   eliminated_errors.end());
  std::nth_element(huber_errors.begin(), huber_errors.begin() + 50, huber_errors.end());
  EXPECT_LT(eliminated_errors[50], 0.5 * huber_errors[50]);
}

TEST(PoseOptimizer, GivesMoversLowWeightsAndFlagsThem) {
  FrameOptions o;
  o.movers = 0.3;
  o.motion = 0.3;
  const Frame f = make_frame(o, 5);
  PoseOptimizer optimizer;
  ASSERT_TRUE(optimizer.optimize(f.camera, f.view(), f.start));
  double moving = 0.0, still = 0.0;
  int movers = 0, caught = 0;
  for (std::size_t i = 0; i < f.moves.size(); ++i) {
    (f.moves[i] ? moving : still) += optimizer.weights()[i];
    movers += f.moves[i];
    caught += f.moves[i] && !optimizer.inliers()[i];
  }
  EXPECT_LT(moving / movers, 0.2);
  EXPECT_GT(still / (500 - movers), 0.7);
  EXPECT_GT(caught, 0.85 * movers);
}

TEST(PoseOptimizer, RoundsWithRejectionEndNearLeastSquaresOverTheInliers) {
  FrameOptions o;
  o.outliers = 0.3;
  PoseOptimizerOptions options;
  options.weights = WeightMode::kFixed;
  options.rounds = 4;
  options.loss_in_last_round = false;
  PoseOptimizer optimizer(options);
  PoseOptimizer clean_optimizer(precise_pose(WeightMode::kFixed));
  double with = 0.0, clean = 0.0;
  for (unsigned seed = 0; seed < 20; ++seed) {
    const Frame f = make_frame(o, seed);
    with += pose_error(optimizer.optimize(f.camera, f.view(), f.start).T_cam_world, f.truth);
    o.outliers = 0.0;
    const Frame g = make_frame(o, seed);
    clean += pose_error(clean_optimizer.optimize(g.camera, g.view(), g.start).T_cam_world, g.truth);
    o.outliers = 0.3;
  }
  EXPECT_LT(with, 2.0 * clean);
}

TEST(PoseOptimizer, CovarianceIsThatOfManyNoisyRuns) {
  FrameOptions o;
  o.points = 100;
  o.start_distance = o.start_rotation = 0.0;
  PoseOptimizerOptions options = precise_pose(WeightMode::kFixed);
  options.loss = {};
  PoseOptimizer optimizer(options);
  // The same geometry each time, fresh noise.
  Frame f = make_frame(o, 11);
  std::mt19937 rng(1);
  std::normal_distribution<double> normal;
  Matrix6d sample = Matrix6d::Zero(), claimed = Matrix6d::Zero();
  constexpr int kRuns = 2000;
  for (int run = 0; run < kRuns; ++run) {
    for (std::size_t i = 0; i < f.points.size(); ++i) {
      const double sigma = 1.0 / f.inverse_sigma[i];
      const Eigen::Vector3d m = f.camera.project3(f.truth * f.points[i]);
      f.pixels[i] =
          Eigen::Vector2d(m[0] + sigma * normal(rng), m[1] + sigma * normal(rng)).cast<float>();
      f.right[i] = static_cast<float>(m[2] + sigma * normal(rng));
    }
    const PoseResult result = optimizer.optimize(f.camera, f.view(), f.truth);
    ASSERT_TRUE(result.covariance.has_value());
    const Vector6d xi = se3_log(result.T_cam_world * f.truth.inverse());
    sample += xi * xi.transpose() / kRuns;
    claimed += *result.covariance / kRuns;
  }
  for (int i = 0; i < 6; ++i) EXPECT_NEAR(sample(i, i) / claimed(i, i), 1.0, 0.12);
}

TEST(PoseOptimizer, PriorHoldsWhatTheDataDoNot) {
  FrameOptions o;
  o.points = 6;
  const Frame f = make_frame(o, 2);
  PosePrior prior;
  prior.mean = f.truth;
  prior.information = 1e12 * Matrix6d::Identity();
  PoseOptimizer optimizer(precise_pose(WeightMode::kFixed));
  const PoseResult result = optimizer.optimize(f.camera, f.view(), f.start, &prior);
  EXPECT_TRUE(result);
  EXPECT_LT(se3_log(result.T_cam_world * f.truth.inverse()).norm(), 1e-4);
  prior.information.setZero();
  const PoseResult with = optimizer.optimize(f.camera, f.view(), f.start, &prior);
  const PoseResult without = optimizer.optimize(f.camera, f.view(), f.start);
  EXPECT_LT(se3_log(with.T_cam_world * without.T_cam_world.inverse()).norm(), 1e-10);
}

TEST(PoseOptimizer, OptimumWithPriorHasZeroGradient) {
  FrameOptions o;
  o.points = 40;
  const Frame f = make_frame(o, 3);
  PosePrior prior;
  prior.mean = f.start;
  prior.information = Vector6d(1e4, 2e4, 3e4, 4e4, 5e4, 6e4).asDiagonal();
  PoseOptimizer optimizer(precise_pose(WeightMode::kEliminated));
  const PoseResult best = optimizer.optimize(f.camera, f.view(), f.start, &prior);
  ASSERT_TRUE(best);
  PoseOptimizerOptions one = precise_pose(WeightMode::kEliminated);
  one.max_iterations = 1;
  PoseOptimizer prober(one);
  for (int k = 0; k < 12; ++k) {
    Vector6d xi = Vector6d::Zero();
    xi[k / 2] = k % 2 ? 1e-4 : -1e-4;
    const RigidTransform near = se3_exp(xi) * best.T_cam_world;
    EXPECT_GT(prober.optimize(f.camera, f.view(), near, &prior).initial_cost, best.final_cost);
  }
}

TEST(PoseOptimizer, ReadsDoublePixelsAsWellAsFloats) {
  const Frame f = make_frame({}, 4);
  std::vector<Eigen::Vector2d> pixels;
  for (const auto& p : f.pixels) pixels.push_back(p.cast<double>());
  PoseOptimizer optimizer;
  const PoseResult a = optimizer.optimize(f.camera, f.view(), f.start);
  const PoseObservations<double> view{as_points<double>(f.points), as_points<double>(pixels),
                                      f.right, f.inverse_sigma, f.weights};
  const PoseResult b = optimizer.optimize(f.camera, view, f.start);
  EXPECT_EQ(a.T_cam_world.matrix(), b.T_cam_world.matrix());
}

TEST(PoseOptimizer, GivesTheSameAnswerTwiceAndWhateverCameBetween) {
  const Frame f = make_frame({}, 4);
  FrameOptions larger;
  larger.points = 1500;
  const Frame g = make_frame(larger, 5);
  for (const WeightMode mode : kModes) {
    PoseOptimizerOptions options;
    options.weights = mode;
    PoseOptimizer optimizer(options, 10);  // grows
    const PoseResult a = optimizer.optimize(f.camera, f.view(), f.start);
    optimizer.optimize(g.camera, g.view(), g.start);
    const PoseResult b = optimizer.optimize(f.camera, f.view(), f.start);
    EXPECT_EQ(a.T_cam_world.matrix(), b.T_cam_world.matrix());
    EXPECT_EQ(a.final_cost, b.final_cost);
    EXPECT_EQ(a.iterations, b.iterations);
  }
}

TEST(PoseOptimizer, AgreesAcrossInstructionSets) {
  const Frame f = make_frame({}, 6);
  PoseOptimizer optimizer(precise_pose(WeightMode::kJoint));
  const PoseResult best = optimizer.optimize(f.camera, f.view(), f.start);
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    const PoseResult result = optimizer.optimize(f.camera, f.view(), f.start);
    EXPECT_LT(se3_log(result.T_cam_world * best.T_cam_world.inverse()).norm(), 1e-9)
        << hwy::TargetName(target);
  }
  hwy::SetSupportedTargetsForTest(0);
}

TEST(PoseOptimizer, ConvergesFromFarForEveryLoss) {
  FrameOptions o;
  o.outliers = 0.1;
  o.start_distance = 0.3;
  o.start_rotation = 0.1;
  for (const RobustLoss loss :
       {RobustLoss{LossKind::kHuber, 2.447, 0.0}, RobustLoss{LossKind::kCauchy, 2.0, 0.0},
        RobustLoss{LossKind::kBarron, 2.0, 0.5}}) {
    PoseOptimizerOptions options = precise_pose(WeightMode::kFixed);
    options.loss = loss;
    PoseOptimizer optimizer(options);
    for (unsigned seed = 0; seed < 10; ++seed) {
      const Frame f = make_frame(o, 50 + seed);
      const PoseResult result = optimizer.optimize(f.camera, f.view(), f.start);
      EXPECT_EQ(result.status, SolveStatus::kConverged);
      EXPECT_LT(pose_error(result.T_cam_world, f.truth), 0.01);
    }
  }
}

}  // namespace
}  // namespace dynslam::factors
