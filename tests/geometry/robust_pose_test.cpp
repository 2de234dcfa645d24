#include "dynslam/geometry/robust_pose.hpp"

#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "geometry/synthetic.hpp"

namespace dynslam::geometry {
namespace {

using synthetic::kCamera;

/// Points of a background and of movers, seen from a known pose.
struct World {
  std::vector<Eigen::Vector3d> world;
  std::vector<Eigen::Vector2f> pixels;
  std::vector<float> depths, weights, ages;
  std::mt19937 generator{3};
  RigidTransform T_cam_world{so3_exp({0.05, -0.1, 0.02}), {0.1, -0.05, 0.2}};

  double uniform(double a, double b) {
    return std::uniform_real_distribution<double>(a, b)(generator);
  }
  /// `count` points in a region of the image that move by `motion` in the camera's frame.
  void add(int count, double x0, double x1, double z0, double z1, const RigidTransform& motion,
           float weight, float age, double noise = 0.3) {
    std::normal_distribution<double> normal;
    for (int i = 0; i < count; ++i) {
      const double z = uniform(z0, z1);
      const Eigen::Vector3d X = kCamera.unproject({uniform(x0, x1), uniform(10, 470)}, z);
      world.push_back(T_cam_world.inverse() * X);
      const Eigen::Vector3d Y = motion * X;
      const Eigen::Vector2d p = kCamera.project(Y);
      pixels.emplace_back(static_cast<float>(p.x() + noise * normal(generator)),
                          static_cast<float>(p.y() + noise * normal(generator)));
      depths.push_back(static_cast<float>(Y.z() + 0.003 * noise * normal(generator)));
      weights.push_back(weight);
      ages.push_back(age);
    }
  }
  PoseProblem problem() const {
    PoseProblem p;
    p.world = world;
    p.pixels = pixels;
    p.depths = depths;
    return p;
  }
  RobustPoseResult solve(const PoseProblem& p, const PosePrior* prior = nullptr,
                         const DepthCheck& check = {}, const RobustPoseOptions& options = {}) {
    RobustPoseResult result;
    RobustPoseWorkspace workspace;
    estimate_pose(kCamera, p, prior, check, options, workspace, result);
    return result;
  }
  double error(const RobustPoseResult& result) const {
    return se3_log(result.T_cam_world * T_cam_world.inverse()).norm();
  }
};

const RigidTransform kWalk(so3_exp({0, 0.05, 0}), {0.15, 0.0, 0.05});

TEST(RobustPose, IsExactOnExactPoints) {
  World w;
  w.add(60, 0, 640, 1, 4, {}, 0.5F, 1, 0.0);
  const RobustPoseResult result = w.solve(w.problem());
  EXPECT_EQ(result.status, PoseStatus::kOk);
  EXPECT_LT(w.error(result), 1e-5);  // pixels and depths are floats
  EXPECT_EQ(result.hypotheses.size(), 1U);
  EXPECT_EQ(result.hypotheses[0].inliers, 60);
  EXPECT_TRUE(result.dominant_is_background);
}

TEST(RobustPose, FindsBackgroundAndMoverAmongOutliers) {
  World w;
  w.add(200, 0, 640, 1, 4, {}, 0.5F, 1);
  w.add(100, 250, 400, 1, 1.5, kWalk, 0.5F, 1);
  const std::size_t outliers = w.world.size();
  w.add(100, 0, 640, 1, 4, {}, 0.5F, 1);
  for (std::size_t i = outliers; i < w.world.size(); ++i) {
    w.pixels[i] = Eigen::Vector2f(static_cast<float>(w.uniform(0, 640)),
                                  static_cast<float>(w.uniform(0, 480)));
  }
  const RobustPoseResult result = w.solve(w.problem());
  ASSERT_TRUE(result.ok());
  EXPECT_LT(w.error(result), 0.003);
  ASSERT_GE(result.hypotheses.size(), 2U);
  int background = 0, mover = 0;
  for (std::size_t i = 0; i < 200; ++i) background += result.motion[i] == result.chosen ? 1 : 0;
  for (std::size_t i = 200; i < 300; ++i) {
    mover += result.motion[i] >= 0 && result.motion[i] != result.chosen ? 1 : 0;
  }
  EXPECT_GT(background, 190);
  EXPECT_GT(mover, 90);
}

World crowded() {
  World w;
  w.add(80, 0, 640, 1.5, 4, {}, 0.5F, 30);
  w.add(160, 200, 450, 1, 1.5, kWalk, 0.5F, 3);
  return w;
}

TEST(RobustPose, ChoosesTheMinorityThatFitsTheLastVelocity) {
  World w = crowded();
  PosePrior prior;
  prior.T_cam_world =
      se3_exp((Vector6d() << 0.02, 0.01, 0, 0.01, 0, 0.01).finished()) * w.T_cam_world;
  const RobustPoseResult result = w.solve(w.problem(), &prior);
  ASSERT_TRUE(result.ok());
  EXPECT_LT(w.error(result), 0.005);
  EXPECT_FALSE(result.dominant_is_background);
  EXPECT_LT(result.hypotheses[static_cast<std::size_t>(result.chosen)].inliers, 90);
}

TEST(RobustPose, LooksFirstForTheMotionThatContinuesThePrior) {
  World w = crowded();
  PosePrior prior;
  prior.T_cam_world = w.T_cam_world;
  const RobustPoseResult result = w.solve(w.problem(), &prior);
  ASSERT_EQ(result.hypotheses.size(), 2U);
  EXPECT_LT(se3_log(result.hypotheses[0].T_cam_world * w.T_cam_world.inverse()).norm(), 0.01);
  EXPECT_LT(result.hypotheses[0].inliers, result.hypotheses[1].inliers);
}

TEST(RobustPose, ChoosesTheMinorityOfOldMapPoints) {
  World w = crowded();
  PoseProblem problem = w.problem();
  problem.ages = w.ages;
  const RobustPoseResult result = w.solve(problem);
  ASSERT_TRUE(result.ok());
  EXPECT_LT(w.error(result), 0.005);
  EXPECT_FALSE(result.dominant_is_background);
}

TEST(RobustPose, ChoosesTheMinorityThatExplainsTheDepthImage) {
  World w = crowded();
  const RobustPoseResult result = w.solve(w.problem(), nullptr, [&](const RigidTransform& T) {
    return se3_log(T * w.T_cam_world.inverse()).norm() < 0.05 ? 0.9 : 0.3;
  });
  ASSERT_TRUE(result.ok());
  EXPECT_LT(w.error(result), 0.005);
  EXPECT_FALSE(result.dominant_is_background);
  EXPECT_EQ(result.hypotheses[static_cast<std::size_t>(result.chosen)].depth_score, 0.9);
}

TEST(RobustPose, FollowsTheWeightsOfADetector) {
  World w;
  w.add(60, 0, 640, 1.5, 4, {}, 0.9F, 1);
  w.add(240, 150, 500, 1, 1.5, kWalk, 0.05F, 1);
  PoseProblem problem = w.problem();
  problem.weights = w.weights;
  const RobustPoseResult result = w.solve(problem);
  ASSERT_TRUE(result.ok());
  EXPECT_LT(w.error(result), 0.005);
}

TEST(RobustPose, TakesPointsWithoutDepthAsInliers) {
  World w;
  w.add(100, 0, 640, 1, 4, {}, 0.5F, 1);
  for (std::size_t i = 0; i < 50; ++i) w.depths[i] = i % 2 ? 0.0F : std::nanf("");
  const RobustPoseResult result = w.solve(w.problem());
  EXPECT_LT(w.error(result), 0.003);
  EXPECT_GT(result.hypotheses[0].inliers, 95);
  for (std::size_t i = 0; i < 50; ++i) w.pixels[i].x() = std::nanf("");
  EXPECT_LE(w.solve(w.problem()).hypotheses[0].inliers, 50);
  EXPECT_EQ(w.solve(w.problem()).motion[0], -1);
}

TEST(RobustPose, RefinesThePriorWhereNoDepthIsMeasured) {
  World w;
  w.add(100, 0, 640, 1, 4, {}, 0.5F, 1, 0.0);
  PoseProblem problem = w.problem();
  problem.depths = {};
  EXPECT_EQ(w.solve(problem).status, PoseStatus::kTooFewPoints);
  PosePrior prior;
  Vector6d small;
  small << 0.002, -0.002, 0.002, 0.001, -0.001, 0.001;
  prior.T_cam_world = se3_exp(small) * w.T_cam_world;
  const RobustPoseResult result = w.solve(problem, &prior);
  ASSERT_TRUE(result.ok());
  EXPECT_LT(w.error(result), 1e-5);
}

TEST(RobustPose, GivesTheSameResultForTheSameSeed) {
  World w = crowded();
  const RobustPoseResult a = w.solve(w.problem()), b = w.solve(w.problem());
  EXPECT_EQ(a.T_cam_world.t, b.T_cam_world.t);
  EXPECT_EQ(a.T_cam_world.R, b.T_cam_world.R);
  EXPECT_EQ(a.motion, b.motion);
}

TEST(RobustPose, SaysWhenItHasNothing) {
  World w;
  EXPECT_EQ(w.solve(w.problem()).status, PoseStatus::kTooFewPoints);
  w.add(2, 0, 640, 1, 4, {}, 0.5F, 1);
  EXPECT_EQ(w.solve(w.problem()).status, PoseStatus::kTooFewPoints);
  w.add(60, 0, 640, 1, 4, {}, 0.5F, 1);
  for (auto& p : w.pixels) {
    p = Eigen::Vector2f(static_cast<float>(w.uniform(0, 640)),
                        static_cast<float>(w.uniform(0, 480)));
  }
  const RobustPoseResult result = w.solve(w.problem());
  EXPECT_EQ(result.status, PoseStatus::kNoConsensus);
  EXPECT_FALSE(result.ok());
  EXPECT_EQ(result.chosen, -1);
  World same;  // all points in one place: no motion can be told
  same.world.assign(50, Eigen::Vector3d(0, 0, 2));
  same.pixels.assign(50, Eigen::Vector2f(320, 240));
  same.depths.assign(50, 2.0F);
  EXPECT_EQ(same.solve(same.problem()).status, PoseStatus::kNoConsensus);
}

TEST(RobustPose, RefusesArraysAndPriorsThatDoNotFit) {
  World w;
  w.add(20, 0, 640, 1, 4, {}, 0.5F, 1);
  PoseProblem problem = w.problem();
  problem.pixels = Pixels(w.pixels[0].data(), 3);
  EXPECT_THROW(w.solve(problem), InvalidArgument);
  const std::vector<float> two(2, 1.0F);
  for (const auto member :
       {&PoseProblem::depths, &PoseProblem::scales, &PoseProblem::weights, &PoseProblem::ages}) {
    problem = w.problem();
    problem.*member = two;
    EXPECT_THROW(w.solve(problem), InvalidArgument);
  }
  PosePrior prior;
  prior.T_cam_world.t.x() = std::nan("");
  EXPECT_THROW(w.solve(w.problem(), &prior), InvalidArgument);
  prior = PosePrior();
  prior.sigma_rotation = 0.0;
  EXPECT_THROW(w.solve(w.problem(), &prior), InvalidArgument);
  prior = PosePrior();
  prior.sigma_translation = -1.0;
  EXPECT_THROW(w.solve(w.problem(), &prior), InvalidArgument);
}

TEST(RobustPose, RefusesEachInvalidOption) {
  using O = RobustPoseOptions;
  EXPECT_NO_THROW(O().validate());
  for (double O::*member :
       {&O::confidence, &O::pixel_threshold, &O::depth_threshold, &O::separation}) {
    O options;
    options.*member = 0.0;
    EXPECT_THROW(options.validate(), InvalidArgument);
  }
  for (double O::*member : {&O::depth_floor, &O::min_share, &O::prior_weight, &O::age_weight,
                            &O::extent_weight, &O::depth_weight}) {
    O options;
    options.*member = -0.1;
    EXPECT_THROW(options.validate(), InvalidArgument);
  }
  O options;
  options.max_hypotheses = 9;
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = O();
  options.max_iterations = 0;
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = O();
  options.min_inliers = 3;
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = O();
  options.refinements = -1;
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = O();
  options.confidence = 1.0;
  EXPECT_THROW(options.validate(), InvalidArgument);
}

}  // namespace
}  // namespace dynslam::geometry
