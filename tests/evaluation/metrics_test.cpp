#include "dynslam/evaluation/metrics.hpp"

#include <cmath>
#include <limits>
#include <string>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

#include "evaluation/support.hpp"

namespace dynslam::evaluation {
namespace {

using testing::kNaN;

RpeOptions step_of(double delta, RpeUnit unit, RpePairs pairs = RpePairs::kAuto) {
  RpeOptions options;
  options.delta = delta;
  options.unit = unit;
  options.pairs = pairs;
  return options;
}

TEST(Statistics, AreThoseOfTheDefinition) {
  const std::vector<double> values = {4.0, 1.0, 3.0, 2.0};
  const Statistics s = statistics(values);
  EXPECT_DOUBLE_EQ(s.rmse, std::sqrt(30.0 / 4.0));
  EXPECT_DOUBLE_EQ(s.mean, 2.5);
  EXPECT_DOUBLE_EQ(s.median, 2.5);
  EXPECT_DOUBLE_EQ(s.std, std::sqrt(5.0 / 4.0)) << "of the population";
  EXPECT_DOUBLE_EQ(s.min, 1.0);
  EXPECT_DOUBLE_EQ(s.max, 4.0);
  EXPECT_EQ(s.count, 4u);
  EXPECT_DOUBLE_EQ(statistics(std::vector<double>{5.0, 1.0, 2.0}).median, 2.0);
}

TEST(Statistics, OfNothingAreNaN) {
  const Statistics s = statistics({});
  EXPECT_EQ(s.count, 0u);
  EXPECT_TRUE(std::isnan(s.rmse) && std::isnan(s.median) && std::isnan(s.max));
}

TEST(Statistics, RefuseNaN) {
  EXPECT_THROW(statistics(std::vector<double>{1.0, kNaN}), InvalidArgument);
}

TEST(Quantile, InterpolatesAndLeavesNaNOut) {
  const std::vector<double> values = {kNaN, 10.0, 20.0, 30.0, 40.0};
  EXPECT_DOUBLE_EQ(quantile(values, 0.0), 10.0);
  EXPECT_DOUBLE_EQ(quantile(values, 0.95), 38.5);  // numpy.quantile
  EXPECT_DOUBLE_EQ(quantile(values, 1.0), 40.0);
  EXPECT_TRUE(std::isnan(quantile(std::vector<double>{kNaN}, 0.5)));
  EXPECT_THROW(quantile(values, 1.5), InvalidArgument);
  EXPECT_THROW(quantile(values, kNaN), InvalidArgument);
}

TEST(Improvement, IsTheShareOfTheErrorThatWentAway) {
  EXPECT_DOUBLE_EQ(improvement_percent(0.5, 0.1), 80.0);
  EXPECT_DOUBLE_EQ(improvement_percent(0.1, 0.2), -100.0);
  EXPECT_TRUE(std::isnan(improvement_percent(0.0, 0.2)));
}

TEST(Ate, DoesNotFeelARigidMotionOfTheEstimate) {
  std::mt19937 random(1);
  for (int round = 0; round < 30; ++round) {
    const Trajectory truth = testing::random_walk(random, 60);
    const Trajectory estimate = testing::with_noise(truth, random, 0.05);
    const Similarity S{1.0, testing::random_transform(random)};
    EXPECT_NEAR(ate(truth, transform(estimate, S)).error.rmse, ate(truth, estimate).error.rmse,
                1e-10);
  }
}

TEST(Ate, DoesNotFeelTheScaleOfTheEstimateAfterSim3) {
  std::mt19937 random(2);
  AteOptions options;
  options.alignment = Alignment::kSim3;
  for (const double scale : {0.01, 0.5, 3.0, 200.0}) {
    const Trajectory truth = testing::random_walk(random, 60);
    const Trajectory estimate = testing::with_noise(truth, random, 0.05);
    const Similarity S{scale, testing::random_transform(random)};
    EXPECT_NEAR(ate(truth, transform(estimate, S), options).error.rmse,
                ate(truth, estimate, options).error.rmse, 1e-9);
    EXPECT_GT(ate(truth, transform(estimate, S)).error.rmse, 1.0);
  }
}

TEST(Ate, OfTheTruthItselfIsZero) {
  std::mt19937 random(3);
  const Trajectory truth = testing::random_walk(random, 40);
  EXPECT_LT(ate(truth, truth).error.max, 1e-12);
  EXPECT_EQ(ate(truth, truth).coverage.time_share, 1.0);
}

TEST(Ate, AlignsPosesThatWereNotAssociatedAsWell) {
  std::mt19937 random(4);
  const Trajectory truth = testing::random_walk(random, 40);
  const Similarity S{1.0, testing::random_transform(random)};
  const Trajectory estimate = transform(truth, S);
  const Trajectory half(truth.begin(), truth.begin() + 20);
  const AteResult result = ate(half, estimate);
  EXPECT_EQ(result.pairs.size(), 20u);
  ASSERT_EQ(result.aligned.size(), 40u);
  EXPECT_LT((result.aligned[39].T_world_cam.matrix() - truth[39].T_world_cam.matrix()).norm(),
            1e-8);
}

TEST(Ate, OfFewPosesIsDefined) {
  std::mt19937 random(5);
  const Trajectory truth = testing::random_walk(random, 3);
  const Trajectory none, one(truth.begin(), truth.begin() + 1),
      two(truth.begin(), truth.begin() + 2);
  for (const auto& [a, b] : {std::pair{none, none}, {truth, none}, {none, truth}}) {
    const AteResult result = ate(a, b);
    EXPECT_EQ(result.error.count, 0u);
    EXPECT_EQ(result.alignment.status, AlignmentStatus::kNoPoints);
    EXPECT_EQ(result.aligned.size(), b.size());
    EXPECT_EQ(result.coverage.time_share, 0.0);
    EXPECT_EQ(rpe(a, b).translation.count, 0u);
    EXPECT_EQ(kitti_metric(a, b).all.count, 0u);
  }
  EXPECT_EQ(ate(truth, one).alignment.status, AlignmentStatus::kNoExtent);
  EXPECT_LT(ate(truth, one).error.max, 1e-12);
  EXPECT_EQ(ate(one, one).coverage.time_share, 1.0);
  EXPECT_EQ(ate(truth, two).alignment.status, AlignmentStatus::kCollinear);
  EXPECT_EQ(rpe(truth, one).translation.count, 0u);
  EXPECT_EQ(rpe(truth, two).translation.count, 1u);
}

TEST(Ate, FindsNoPairsOnAnotherClock) {
  std::mt19937 random(6);
  const Trajectory truth = testing::random_walk(random, 10);
  Trajectory estimate = truth;
  for (StampedPose& pose : estimate) pose.timestamp += 1e6;
  EXPECT_EQ(ate(truth, estimate).error.count, 0u);
  AteOptions options;
  options.association.offset = -1e6;
  EXPECT_EQ(ate(truth, estimate, options).error.count, 10u);
}

TEST(Coverage, IsTheShareOfTimeThatWasTracked) {
  std::mt19937 random(7);
  const Trajectory truth = testing::random_walk(random, 101);
  Trajectory estimate;
  for (std::size_t i = 0; i < truth.size(); i += 2) {
    if (i <= 20 || i >= 80) estimate.push_back(truth[i]);
  }
  const Coverage coverage = ate(truth, estimate).coverage;
  EXPECT_NEAR(coverage.time_share, 0.4, 1e-9);
  EXPECT_EQ(coverage.truth_poses, 101u);
  EXPECT_EQ(coverage.estimate_poses, 22u);
  EXPECT_EQ(coverage.pairs, 22u);
}

TEST(Rpe, OfEqualTrajectoriesIsZero) {
  std::mt19937 random(8);
  const Trajectory truth = testing::random_walk(random, 80);
  for (const RpeUnit unit : {RpeUnit::kFrames, RpeUnit::kSeconds, RpeUnit::kMetres}) {
    for (const RpePairs pairs : {RpePairs::kConsecutive, RpePairs::kAll}) {
      const RpeResult result = rpe(truth, truth, step_of(2.0, unit, pairs));
      EXPECT_GT(result.translation.count, 2u);
      EXPECT_LT(result.translation.max, 1e-12);
      EXPECT_LT(result.rotation_deg.max, 1e-6);
    }
  }
}

TEST(Rpe, DoesNotFeelARigidMotionOfTheEstimate) {
  std::mt19937 random(9);
  const Trajectory truth = testing::random_walk(random, 80);
  const Trajectory estimate = testing::with_noise(truth, random, 0.05);
  const Similarity S{1.0, testing::random_transform(random)};
  const RpeOptions options = step_of(3.0, RpeUnit::kMetres);
  EXPECT_NEAR(rpe(truth, transform(estimate, S), options).translation.rmse,
              rpe(truth, estimate, options).translation.rmse, 1e-9);
}

TEST(Rpe, MeasuresAKnownDrift) {
  // Each step of the estimate is 1 cm too long and turns 0.1 degrees too far.
  Trajectory truth, estimate;
  RigidTransform a, b;
  const double turn = 0.1 * M_PI / 180.0;
  for (int i = 0; i < 50; ++i) {
    truth.push_back({i * 0.1, a});
    estimate.push_back({i * 0.1, b});
    a = a * RigidTransform{Eigen::Matrix3d::Identity(), {0, 0, 0.5}};
    b = b * RigidTransform{so3_exp({0, turn, 0}), {0, 0, 0.51}};
  }
  const RpeResult result = rpe(truth, estimate);
  EXPECT_EQ(result.translation.count, 49u);
  EXPECT_NEAR(result.translation.rmse, 0.01, 1e-12);
  EXPECT_NEAR(result.translation.std, 0.0, 1e-12);
  EXPECT_NEAR(result.rotation_deg.mean, 0.1, 1e-9);
  EXPECT_EQ(result.errors[4].first.truth, 4u);
  EXPECT_EQ(result.errors[4].second.estimate, 5u);
  EXPECT_DOUBLE_EQ(result.errors[4].time, 0.5);
}

TEST(Rpe, ChainsConsecutivePairsAndBeginsAllPairsEverywhere) {
  std::mt19937 random(10);
  const Trajectory truth = testing::random_walk(random, 31);
  EXPECT_EQ(rpe(truth, truth, step_of(10, RpeUnit::kFrames)).errors.size(), 3u);
  EXPECT_EQ(rpe(truth, truth, step_of(10, RpeUnit::kFrames, RpePairs::kAll)).errors.size(), 21u);
  EXPECT_EQ(rpe(truth, truth, step_of(1, RpeUnit::kSeconds)).errors.size(), 22u)
      << "seconds take all pairs unless told otherwise, the last one 0.9 s long";
  const RpeResult chained =
      rpe(truth, truth, step_of(1, RpeUnit::kSeconds, RpePairs::kConsecutive));
  ASSERT_EQ(chained.errors.size(), 3u);
  EXPECT_EQ(chained.errors[1].first, chained.errors[0].second);
}

TEST(Rpe, LeavesOutStepsOverAGapInTime) {
  std::mt19937 random(11);
  const Trajectory truth = testing::random_walk(random, 40);
  Trajectory estimate(truth.begin(), truth.begin() + 15);
  estimate.insert(estimate.end(), truth.begin() + 25, truth.end());
  const RpeResult all = rpe(truth, estimate, step_of(0.5, RpeUnit::kSeconds));
  EXPECT_EQ(all.errors.size(), 10u + 10u);
  for (const RelativeError& error : all.errors) {
    EXPECT_NEAR(truth[error.second.truth].timestamp - truth[error.first.truth].timestamp, 0.5,
                1e-9);
  }
  const RpeResult chained =
      rpe(truth, estimate, step_of(0.5, RpeUnit::kSeconds, RpePairs::kConsecutive));
  EXPECT_EQ(chained.errors.size(), 2u + 2u) << "0-5, 5-10, 25-30, 30-35";
}

TEST(Rpe, HasNoPairsForAStepBeyondTheEnd) {
  std::mt19937 random(12);
  const Trajectory truth = testing::random_walk(random, 10);
  for (const RpePairs pairs : {RpePairs::kConsecutive, RpePairs::kAll}) {
    EXPECT_EQ(rpe(truth, truth, step_of(10, RpeUnit::kFrames, pairs)).errors.size(), 0u);
    EXPECT_EQ(rpe(truth, truth, step_of(1e300, RpeUnit::kFrames, pairs)).errors.size(), 0u);
    EXPECT_EQ(rpe(truth, truth, step_of(1e6, RpeUnit::kSeconds, pairs)).errors.size(), 0u);
    EXPECT_EQ(rpe(truth, truth, step_of(1e6, RpeUnit::kMetres, pairs)).errors.size(), 0u);
  }
}

TEST(Rpe, OfACameraThatStandsStillHasNoStepsInMetres) {
  Trajectory still;
  for (int i = 0; i < 20; ++i) still.push_back({0.1 * i, {}});
  for (const RpePairs pairs : {RpePairs::kConsecutive, RpePairs::kAll}) {
    EXPECT_TRUE(rpe(still, still, step_of(1.0, RpeUnit::kMetres, pairs)).errors.empty());
  }
}

TEST(KittiMetric, MeasuresAWrongScale) {
  Trajectory truth;
  for (int i = 0; i < 1200; ++i) {
    truth.push_back({i * 0.1, {so3_exp({0, 0.001 * i, 0}), {0.8 * i, 0, 0.1 * i}}});
  }
  const Trajectory estimate = transform(truth, {1.02, {}});
  const KittiResult result = kitti_metric(truth, estimate);
  // Stretches end at the first pose past the length, so they are up to one step longer.
  EXPECT_NEAR(result.all.translation_percent, 2.0, 0.01);
  EXPECT_NEAR(result.all.rotation_deg_per_100m, 0.0, 1e-6);
  ASSERT_EQ(result.by_length.size(), 8u);
  EXPECT_EQ(result.by_length[7].length, 800.0);
  std::size_t count = 0;
  for (const KittiMean& mean : result.by_length) count += mean.count;
  EXPECT_EQ(count, result.all.count);
  EXPECT_EQ(result.segments.size(), result.all.count);
  KittiOptions options;
  options.alignment = Alignment::kSim3;
  EXPECT_LT(kitti_metric(truth, estimate, options).all.translation_percent, 1e-9);
}

TEST(KittiMetric, HasNoFiguresForAShortPath) {
  std::mt19937 random(13);
  const Trajectory truth = testing::random_walk(random, 50);
  const KittiResult result = kitti_metric(truth, truth);
  EXPECT_EQ(result.all.count, 0u);
  EXPECT_TRUE(std::isnan(result.all.translation_percent));
}

TEST(Measures, RefuseBrokenTrajectories) {
  std::mt19937 random(14);
  const Trajectory good = testing::random_walk(random, 5);
  Trajectory repeated = good, nan = good;
  repeated[2].timestamp = repeated[1].timestamp;
  nan[3].T_world_cam.R(0, 0) = kNaN;
  for (const Trajectory& bad : {repeated, nan}) {
    EXPECT_THROW(ate(good, bad), InvalidArgument);
    EXPECT_THROW(ate(bad, good), InvalidArgument);
    EXPECT_THROW(rpe(good, bad), InvalidArgument);
    EXPECT_THROW(kitti_metric(bad, good), InvalidArgument);
  }
  EXPECT_EQ(testing::message_of<InvalidArgument>([&] { ate(good, nan); }),
            "ate: estimate: got NaN or infinity in pose 3, expected finite poses");
}

TEST(Measures, CheckTheirOptions) {
  for (const double delta : {0.0, -1.0, 1.5, kNaN, std::numeric_limits<double>::infinity()}) {
    EXPECT_THROW(step_of(delta, RpeUnit::kFrames).validate(), InvalidArgument) << delta;
  }
  EXPECT_NO_THROW(step_of(1.5, RpeUnit::kSeconds).validate());
  for (const double tolerance : {0.0, 1.0, kNaN}) {
    RpeOptions options;
    options.tolerance = tolerance;
    EXPECT_THROW(options.validate(), InvalidArgument);
  }
  RpeOptions rpe_options;
  rpe_options.association.max_difference = kNaN;
  EXPECT_THROW(rpe_options.validate(), InvalidArgument);
  AteOptions ate_options;
  ate_options.association.max_difference = -1.0;
  EXPECT_THROW(ate_options.validate(), InvalidArgument);
  KittiOptions kitti;
  kitti.lengths = {};
  EXPECT_THROW(kitti.validate(), InvalidArgument);
  kitti.lengths = {100.0, 0.0};
  EXPECT_THROW(kitti.validate(), InvalidArgument);
  kitti = {};
  kitti.step = 0;
  EXPECT_THROW(kitti.validate(), InvalidArgument);
  kitti = {};
  kitti.association.offset = kNaN;
  EXPECT_THROW(kitti.validate(), InvalidArgument);
}

}  // namespace
}  // namespace dynslam::evaluation
