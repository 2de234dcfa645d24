// Unlucky frames are statuses, broken contracts are errors by name.
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/factors/pose_optimizer.hpp"

#include "factors/synthetic.hpp"

namespace dynslam::factors {
namespace {

using synthetic::Frame;
using synthetic::make_frame;

constexpr WeightMode kAllModes[] = {WeightMode::kFixed, WeightMode::kJoint,
                                    WeightMode::kEliminated};
const float kNan = std::nanf("");
const float kInfinity = std::numeric_limits<float>::infinity();

Frame small_frame(int points, unsigned seed = 1) {
  synthetic::FrameOptions o;
  o.points = points;
  return make_frame(o, seed);
}

// Runs every mode and checks what holds whatever happens.
void for_each_mode(const Frame& f,
                   const std::function<void(const PoseResult&, const PoseOptimizer&)>& check) {
  for (const WeightMode mode : kAllModes) {
    PoseOptimizerOptions options;
    options.weights = mode;
    PoseOptimizer optimizer(options);
    const PoseResult result = optimizer.optimize(f.camera, f.view(), f.start);
    EXPECT_TRUE(result.T_cam_world.all_finite());
    EXPECT_TRUE(std::isfinite(result.final_cost));
    EXPECT_EQ(optimizer.inliers().size(), f.points.size());
    for (const float w : optimizer.weights()) EXPECT_TRUE(w >= 0.0F && w <= 1.0F);
    EXPECT_TRUE(!result.covariance || result.covariance->allFinite());
    check(result, optimizer);
  }
}

TEST(PoseOptimizerStatus, IsTooFewPointsForFewOrNone) {
  for (const int n : {0, 1, 3}) {
    const Frame f = small_frame(n);
    for_each_mode(f, [&](const PoseResult& result, const PoseOptimizer&) {
      EXPECT_EQ(result.status, SolveStatus::kTooFewPoints);
      EXPECT_EQ(result.T_cam_world.matrix(), f.start.matrix());
      EXPECT_EQ(result.observations, n);
      EXPECT_FALSE(result.covariance.has_value());
    });
  }
}

TEST(PoseOptimizerStatus, IsTooFewPointsWhenAllAreBehindTheCamera) {
  Frame f = small_frame(50);
  RigidTransform turn;
  turn.R = Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitY()).toRotationMatrix();
  f.start = turn * f.start;
  for_each_mode(f, [](const PoseResult& result, const PoseOptimizer& optimizer) {
    EXPECT_EQ(result.status, SolveStatus::kTooFewPoints);
    EXPECT_EQ(result.observations, 0);
    for (const float s : optimizer.squared_residuals()) EXPECT_EQ(s, kInfinity);
  });
}

TEST(PoseOptimizerStatus, OfPointsHalfBehindIsDecidedByTheOthers) {
  Frame f = small_frame(100);
  for (std::size_t i = 0; i < 50; ++i) f.points[i] = f.truth.inverse() * Eigen::Vector3d(0, 0, -2);
  for_each_mode(f, [&](const PoseResult& result, const PoseOptimizer& optimizer) {
    EXPECT_EQ(result.status, SolveStatus::kConverged);
    EXPECT_EQ(result.observations, 50);
    EXPECT_LT(synthetic::pose_error(result.T_cam_world, f.truth), 0.02);
    for (std::size_t i = 0; i < 50; ++i) EXPECT_EQ(optimizer.inliers()[i], 0);
  });
}

TEST(PoseOptimizerStatus, NanMeansNotThere) {
  Frame f = small_frame(100);
  f.points[0].x() = std::nan("");
  f.pixels[1].y() = kNan;
  f.inverse_sigma[2] = kNan;
  f.inverse_sigma[3] = 0.0F;
  f.inverse_sigma[4] = kInfinity;
  f.weights[5] = kNan;
  f.weights[6] = 0.0F;
  f.points[7].z() = std::numeric_limits<double>::infinity();
  f.points[8].x() = 1e300;
  f.right[9] = kNan;        // mono, still used
  f.right[10] = -1.0F;      // mono, still used
  f.right[11] = kInfinity;  // mono, still used
  for_each_mode(f, [&](const PoseResult& result, const PoseOptimizer& optimizer) {
    EXPECT_EQ(result.status, SolveStatus::kConverged);
    EXPECT_EQ(result.observations, 91);
    for (std::size_t i = 0; i < 9; ++i) {
      EXPECT_EQ(optimizer.inliers()[i], 0);
      EXPECT_EQ(optimizer.weights()[i], 0.0F);
    }
    EXPECT_LT(synthetic::pose_error(result.T_cam_world, f.truth), 0.02);
  });
}

TEST(PoseOptimizerStatus, IsTooFewPointsWhenEverythingIsNan) {
  Frame f = small_frame(100);
  for (auto& p : f.pixels) p.setConstant(kNan);
  for_each_mode(f, [](const PoseResult& result, const PoseOptimizer&) {
    EXPECT_EQ(result.status, SolveStatus::kTooFewPoints);
  });
}

TEST(PoseOptimizerStatus, IsDegenerateForCoincidentPoints) {
  Frame f = small_frame(20);
  for (std::size_t i = 1; i < 20; ++i) {
    f.points[i] = f.points[0];
    f.pixels[i] = f.pixels[0];
    f.right[i] = f.right[0];
  }
  for_each_mode(f, [](const PoseResult& result, const PoseOptimizer&) {
    EXPECT_EQ(result.status, SolveStatus::kDegenerate);
    EXPECT_FALSE(result.covariance.has_value());
  });
}

TEST(PoseOptimizerStatus, IsDegenerateForPointsOnALine) {
  Frame f = small_frame(30);
  for (std::size_t i = 0; i < 30; ++i) {
    const Eigen::Vector3d X =
        Eigen::Vector3d(-1, 0.5, 3) + 0.07 * i * Eigen::Vector3d(1, -0.4, 0.3);
    f.points[i] = f.truth.inverse() * X;
    const Eigen::Vector3d p = f.camera.project3(X);
    f.pixels[i] = p.head<2>().cast<float>();
    f.right[i] = static_cast<float>(p[2]);
  }
  for_each_mode(f, [](const PoseResult& result, const PoseOptimizer&) {
    EXPECT_EQ(result.status, SolveStatus::kDegenerate);
  });
}

TEST(PoseOptimizerStatus, IsDegenerateForALineOrOnePointWithoutDepth) {
  for (const double spacing : {0.0, 0.07}) {
    Frame f = small_frame(30);
    for (std::size_t i = 0; i < 30; ++i) {
      const Eigen::Vector3d X = Eigen::Vector3d(-1, 0.5, 3) +
                                spacing * static_cast<double>(i) * Eigen::Vector3d(1, -0.4, 0.3);
      f.points[i] = f.truth.inverse() * X;
      f.pixels[i] = f.camera.project3(X).head<2>().cast<float>();
      f.right[i] = kNan;
    }
    for_each_mode(f, [](const PoseResult& result, const PoseOptimizer&) {
      EXPECT_EQ(result.status, SolveStatus::kDegenerate);
    });
  }
}

TEST(PoseOptimizerStatus, WithoutAnyDepthIsGoodFromPixelsAlone) {
  Frame f = small_frame(200);
  for (float& right : f.right) right = kNan;
  for_each_mode(f, [&](const PoseResult& result, const PoseOptimizer&) {
    EXPECT_EQ(result.status, SolveStatus::kConverged);
    EXPECT_LT(synthetic::pose_error(result.T_cam_world, f.truth), 0.02);
  });
}

TEST(PoseOptimizerStatus, IsTooFewPointsWhenNothingIsTrusted) {
  for (const float weight : {0.0F, -0.0F, kNan}) {
    Frame f = small_frame(50);
    for (float& w : f.weights) w = weight;
    for_each_mode(f, [&](const PoseResult& result, const PoseOptimizer&) {
      EXPECT_EQ(result.status, SolveStatus::kTooFewPoints);
      EXPECT_EQ(result.T_cam_world.matrix(), f.start.matrix());
    });
  }
}

TEST(PoseOptimizerStatus, OfAPureRotationIsGood) {
  synthetic::FrameOptions o;
  o.start_distance = 0.0;
  o.start_rotation = 0.1;
  const Frame f = make_frame(o, 8);
  for_each_mode(f, [&](const PoseResult& result, const PoseOptimizer&) {
    EXPECT_EQ(result.status, SolveStatus::kConverged);
    EXPECT_LT(synthetic::pose_error(result.T_cam_world, f.truth), 0.005);
  });
}

TEST(PoseOptimizerStatus, IsNonFiniteForAPoseThatIs) {
  Frame f = small_frame(50);
  f.start.t.x() = std::nan("");
  PoseOptimizer optimizer;
  const PoseResult result = optimizer.optimize(f.camera, f.view(), f.start);
  EXPECT_EQ(result.status, SolveStatus::kNonFinite);
  EXPECT_EQ(result.T_cam_world.t.y(), f.start.t.y());
}

TEST(PoseOptimizerStatus, IsTooFewPointsWhenRoundsRejectEverything) {
  const Frame f = small_frame(40);
  for (const WeightMode mode : kAllModes) {
    PoseOptimizerOptions options;
    options.weights = mode;
    options.rounds = 2;
    options.chi2_mono = options.chi2_depth = 1e-9;
    PoseOptimizer optimizer(options);
    const PoseResult result = optimizer.optimize(f.camera, f.view(), f.start);
    EXPECT_EQ(result.status, SolveStatus::kTooFewPoints);
    EXPECT_LT(se3_log(result.T_cam_world * f.start.inverse()).norm(), 1e-12);
    EXPECT_EQ(result.observations, 40);
    EXPECT_EQ(result.inliers, 0);
  }
}

TEST(PoseOptimizerStatus, IsMaxIterationsWhenTimeIsUp) {
  const Frame f = small_frame(100);
  PoseOptimizerOptions options;
  options.max_iterations = 1;
  PoseOptimizer optimizer(options);
  const PoseResult result = optimizer.optimize(f.camera, f.view(), f.start);
  EXPECT_EQ(result.status, SolveStatus::kMaxIterations);
  EXPECT_EQ(result.iterations, 1);
}

TEST(SolveStatus, HasNames) {
  EXPECT_STREQ(to_string(SolveStatus::kConverged), "Converged");
  EXPECT_STREQ(to_string(SolveStatus::kDegenerate), "Degenerate");
  EXPECT_TRUE(usable(SolveStatus::kMaxIterations));
  EXPECT_FALSE(usable(SolveStatus::kTooFewPoints));
}

// --- contracts -------------------------------------------------------------------------------

std::string message_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const InvalidArgument& e) {
    return e.what();
  }
  return "nothing thrown";
}

void expect_names(const std::string& name, const std::function<void()>& call) {
  const std::string message = message_of(call);
  EXPECT_NE(message.find(name), std::string::npos) << message;
}

TEST(PoseOptimizerContract, NamesWhatIsWrongWithItsViews) {
  const Frame good = small_frame(20);
  PoseOptimizer optimizer;
  const auto run = [&](Frame f) {
    return [f, &optimizer] { optimizer.optimize(f.camera, f.view(), f.start); };
  };
  Frame f = good;
  f.pixels.pop_back();
  expect_names("pixels", run(f));
  f = good;
  f.right.pop_back();
  expect_names("right_columns", run(f));
  f = good;
  f.weights.pop_back();
  expect_names("weights", run(f));
  f = good;
  f.weights[3] = -0.1F;
  expect_names("weights", run(f));
  f.weights[3] = 1.1F;
  expect_names("weights", run(f));
  f = good;
  f.inverse_sigma.pop_back();
  expect_names("inverse_sigma", run(f));
  f = good;
  f.inverse_sigma[3] = -1.0F;
  expect_names("inverse_sigma", run(f));
  f = good;
  f.camera.fx = 0.0;
  expect_names("fx", run(f));
  f = good;
  f.start.R *= 2.0;
  expect_names("initial.R", run(f));
}

TEST(PoseOptimizerContract, NamesWhatIsWrongWithItsPrior) {
  const Frame f = small_frame(20);
  PoseOptimizer optimizer;
  PosePrior prior;
  const auto run = [&] { optimizer.optimize(f.camera, f.view(), f.start, &prior); };
  prior.mean.t.x() = std::nan("");
  expect_names("prior.mean", run);
  prior = {};
  prior.information(0, 0) = std::nan("");
  expect_names("prior.information", run);
  prior = {};
  prior.information(0, 1) = 1.0;
  expect_names("symmetric", run);
  prior = {};
  prior.information(0, 0) = -1.0;
  expect_names("eigenvalue", run);
}

TEST(PoseOptimizerOptions, RefusesByName) {
  const auto refuses = [](const char* name, auto&& change) {
    PoseOptimizerOptions options;
    change(options);
    expect_names(name, [&] { PoseOptimizer optimizer(options); });
  };
  refuses("lambda", [](auto& o) { o.lambda = 0.0; });
  refuses("scale", [](auto& o) { o.loss.scale = -1.0; });
  refuses("rounds", [](auto& o) { o.rounds = 0; });
  refuses("max_iterations", [](auto& o) { o.max_iterations = 0; });
  refuses("chi2_mono", [](auto& o) { o.chi2_mono = 0.0; });
  refuses("chi2_depth", [](auto& o) { o.chi2_depth = std::nan(""); });
  refuses("min_observations", [](auto& o) { o.min_observations = 2; });
  refuses("step_tolerance", [](auto& o) { o.step_tolerance = -1.0; });
  refuses("cost_tolerance", [](auto& o) { o.cost_tolerance = std::nan(""); });
  refuses("initial_damping", [](auto& o) { o.initial_damping = 0.0; });
}

TEST(PoseOptimizerOptions, AreKeptWhenNewOnesAreRefused) {
  PoseOptimizer optimizer;
  PoseOptimizerOptions broken;
  broken.rounds = 0;
  EXPECT_THROW(optimizer.set_options(broken), InvalidArgument);
  EXPECT_EQ(optimizer.options().rounds, 1);
}

}  // namespace
}  // namespace dynslam::factors
