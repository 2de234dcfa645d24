#include "dynslam/matching/motion_consensus.hpp"

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/matching/reject.hpp"
#include "dynslam/matching/rules.hpp"

#include "matching/synthetic_pairs.hpp"

namespace {

namespace dm = dynslam::matching;
using Flags = std::vector<std::uint8_t>;
using Weights = std::vector<float>;

struct Answer {
  Flags keep;
  Weights weight;
  synthetic::Score score;
};

template <typename Rule>
Answer run(const Rule& rule, const synthetic::Pairs& pairs) {
  Answer answer{Flags(pairs.matches.size()), Weights(pairs.matches.size()), {}};
  dm::Workspace workspace;
  dm::reject(rule, pairs.matches, pairs.points1, pairs.points2, answer.keep, answer.weight,
             workspace);
  answer.score = synthetic::score(answer.keep, pairs.good);
  return answer;
}

/// Mean over ten scenes and 30, 50, 70 % wrong matches; each mean must reach the bounds.
void expect_score(synthetic::Setup setup, double precision, double recall) {
  for (const double outliers : {0.3, 0.5, 0.7}) {
    setup.outliers = outliers;
    synthetic::Score mean;
    for (unsigned seed = 1; seed <= 10; ++seed) {
      setup.seed = seed;
      const Answer answer = run(dm::DefaultRule(), synthetic::make_pairs(setup));
      mean.precision += answer.score.precision / 10;
      mean.recall += answer.score.recall / 10;
    }
    EXPECT_GE(mean.precision, precision) << outliers;
    EXPECT_GE(mean.recall, recall) << outliers;
  }
}

synthetic::Setup moved(double x, double y, double z, double yaw = 0, double pitch = 0,
                       double roll = 0) {
  synthetic::Setup setup;
  setup.camera.translation << x, y, z;
  setup.camera.rotation = synthetic::turn(yaw, pitch, roll);
  setup.camera.roll_degrees = roll;
  return setup;
}

TEST(MotionConsensus, KeepsTheMatchesOfAPureRotation) {
  expect_score(moved(0, 0, 0, 8), 0.95, 0.95);
  expect_score(moved(0, 0, 0, 3, 5, 10), 0.95, 0.95);
}

TEST(MotionConsensus, KeepsTheMatchesOfARollOfAnyAngle) {
  expect_score(moved(0, 0, 0, 0, 0, 45), 0.95, 0.95);
  expect_score(moved(0.05, 0, 0, 0, 0, 180), 0.95, 0.95);
}

TEST(MotionConsensus, FindsARollWithoutKeypointAngles) {
  synthetic::Setup setup = moved(0, 0, 0, 0, 0, 60);
  setup.angles = false;
  setup.matches = 2000;
  expect_score(setup, 0.95, 0.95);
}

TEST(MotionConsensus, KeepsTheMatchesOfForwardMotion) {
  expect_score(moved(0, 0, -0.3, 1), 0.95, 0.95);
}

TEST(MotionConsensus, KeepsTheMatchesOfSidewaysMotion) {
  expect_score(moved(-0.2, 0, 0, 2), 0.95, 0.95);
  expect_score(moved(-0.6, 0.1, 0, -5), 0.95, 0.95);
}

TEST(MotionConsensus, KeepsBothOfTwoMotions) {
  for (const double speed : {0.1, 0.3, 0.6}) {
    synthetic::Setup setup = moved(-0.1, 0, 0.05, 2);
    setup.mover = true;
    setup.mover_motion.rotation = synthetic::turn(3, 2, 4);
    setup.mover_motion.translation << speed, 0.3 * speed, -0.5 * speed;
    expect_score(setup, 0.95, 0.90);
  }
}

TEST(MotionConsensus, KeepsMostOfTheMoverItself) {
  synthetic::Setup setup = moved(-0.1, 0, 0.05, 2);
  setup.mover = true;
  setup.mover_motion.translation << 0.1, 0.3, 0;
  setup.matches = 1000;
  const synthetic::Pairs pairs = synthetic::make_pairs(setup);
  const Answer answer = run(dm::DefaultRule(), pairs);
  int movers = 0, kept = 0;
  for (std::size_t i = 0; i < pairs.good.size(); ++i) {
    if (pairs.on_mover[i] == 0 || pairs.good[i] == 0) continue;
    ++movers;
    kept += answer.keep[i];
  }
  ASSERT_GT(movers, 30);
  EXPECT_GE(kept, 0.8 * movers);
}

TEST(MotionConsensus, KeepsMuchMoreThanTheModalBinAndIsRight) {
  const synthetic::Pairs pairs = synthetic::make_pairs(moved(0, 0, -0.5));
  const synthetic::Score ours = run(dm::DefaultRule(), pairs).score;
  const synthetic::Score modal = run(dm::ModalBin(), pairs).score;
  EXPECT_GE(ours.recall, modal.recall + 0.2);
  EXPECT_GE(ours.precision, 0.95);
}

TEST(MotionConsensus, RejectsWhatIsAllWrong) {
  synthetic::Setup setup;
  setup.outliers = 1.0;
  const Answer answer = run(dm::DefaultRule(), synthetic::make_pairs(setup));
  EXPECT_LE(std::count(answer.keep.begin(), answer.keep.end(), 1), 25);
}

TEST(MotionConsensus, TrustsTheRightMatchesMore) {
  const synthetic::Pairs pairs = synthetic::make_pairs(moved(-0.2, 0, 0.1));
  const Answer answer = run(dm::DefaultRule(), pairs);
  std::vector<std::int32_t> order(pairs.matches.size());
  dm::prosac_order(answer.weight, order);
  int good = 0;
  for (std::size_t i = 0; i < 100; ++i) good += pairs.good[static_cast<std::size_t>(order[i])];
  EXPECT_GE(good, 98);
  for (const float weight : answer.weight) {
    ASSERT_GE(weight, 0.0F);
    ASSERT_LE(weight, 1.0F);
  }
}

TEST(MotionConsensus, PutsTheCamerasMotionBeforeThatOfAMover) {
  synthetic::Setup setup = moved(-0.1, 0, 0.05, 2);
  setup.mover = true;
  setup.mover_motion.translation << 0.2, 0.4, 0;
  const synthetic::Pairs pairs = synthetic::make_pairs(setup);
  const Answer answer = run(dm::DefaultRule(), pairs);
  double still = 0, stills = 0, moving = 0, movers = 0;
  for (std::size_t i = 0; i < pairs.good.size(); ++i) {
    if (answer.keep[i] == 0 || pairs.good[i] == 0) continue;
    (pairs.on_mover[i] != 0 ? moving : still) += static_cast<double>(answer.weight[i]);
    (pairs.on_mover[i] != 0 ? movers : stills) += 1;
  }
  EXPECT_GT(still / stills, 1.3 * moving / movers);
}

TEST(MotionConsensus, GivesTheSameAnswerTwice) {
  const synthetic::Pairs pairs = synthetic::make_pairs(moved(-0.2, 0, 0.1));
  dm::Workspace workspace;
  Answer first = run(dm::DefaultRule(), pairs);
  for (int i = 0; i < 3; ++i) {
    Flags keep(pairs.matches.size());
    Weights weight(pairs.matches.size());
    dm::reject(dm::DefaultRule(), pairs.matches, pairs.points1, pairs.points2, keep, weight,
               workspace);
    EXPECT_EQ(keep, first.keep);
    EXPECT_EQ(weight, first.weight);
  }
}

TEST(MotionConsensus, WorksOnImagesOfDifferentSize) {
  for (const double scale : {0.5, 2.0}) {
    synthetic::Setup setup = moved(-0.2, 0, 0.05);
    setup.scale2 = scale;
    setup.noise = 0.5;
    for (const bool angles : {true, false}) {
      setup.angles = angles;
      synthetic::Pairs pairs = synthetic::make_pairs(setup);
      for (std::size_t i = 0; angles && i < pairs.points1.size(); ++i) {
        pairs.points1[i].size = 31.0F;
        pairs.points2[i].size = static_cast<float>(31.0 * scale);
      }
      const Answer answer = run(dm::DefaultRule(), pairs);
      EXPECT_GE(answer.score.precision, 0.93) << scale << angles;
      EXPECT_GE(answer.score.recall, 0.85) << scale << angles;
    }
  }
}

TEST(MotionConsensus, KeepsAllThatMoveByTheSame) {
  synthetic::Pairs pairs = synthetic::make_pairs(moved(0, 0, 0));
  for (std::size_t i = 0; i < pairs.points1.size(); ++i) {
    pairs.points2[i] = pairs.points1[i];
    pairs.points2[i].x += 12.0F;
  }
  const Answer answer = run(dm::DefaultRule(), pairs);
  EXPECT_GE(std::count(answer.keep.begin(), answer.keep.end(), 1), 495);
}

TEST(MotionConsensus, RejectsMatchesThatLieOnOnePoint) {
  const std::vector<dm::Keypoint> points(50);
  Flags keep(50, 1);
  Weights weight(50, 1.0F);
  dm::Workspace workspace;
  const auto summary = dm::reject_pairs(dm::DefaultRule(), points, points, keep, weight, workspace);
  EXPECT_EQ(summary.kept, 0U);
  EXPECT_EQ(weight, Weights(50, 0.0F));
}

TEST(MotionConsensus, KeepsMatchesOnALine) {
  std::vector<dm::Keypoint> a(60), b(60);
  for (std::size_t i = 0; i < 60; ++i) {
    a[i].x = 10.0F * static_cast<float>(i);
    b[i].x = a[i].x + 7.0F;
    a[i].y = b[i].y = 5.0F;
  }
  Flags keep(60);
  Weights weight(60);
  dm::Workspace workspace;
  EXPECT_EQ(dm::reject_pairs(dm::DefaultRule(), a, b, keep, weight, workspace).kept, 60U);
  for (const float w : weight) EXPECT_TRUE(w > 0.0F && w <= 1.0F) << w;
}

TEST(MotionConsensus, SurvivesAFewAbsurdCoordinates) {
  synthetic::Pairs pairs = synthetic::make_pairs(moved(-0.2, 0, 0.05));
  for (std::size_t i = 0; i < 5; ++i) {
    pairs.points1[i].x = 9e5F;
    pairs.points2[i].y = -9e5F;
    pairs.good[i] = 0;
  }
  EXPECT_GE(run(dm::DefaultRule(), pairs).score.recall, 0.95);
}

TEST(MotionConsensus, TakesLinearTimeWhereAllPointsCrowd) {
  std::vector<dm::Keypoint> a(20000), b(20000);
  for (std::size_t i = 0; i < a.size(); ++i) {
    a[i].x = static_cast<float>(i % 7);
    a[i].y = static_cast<float>(i % 3);
    b[i].x = static_cast<float>(i % 11);
  }
  Flags keep(a.size());
  dm::Workspace workspace(a.size());
  const auto start = std::chrono::steady_clock::now();
  dm::reject_pairs(dm::DefaultRule(), a, b, keep, {}, workspace);
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start;
  EXPECT_LT(elapsed.count(), 2.0);  // all pairs would be 2 * 10^8 comparisons
}

TEST(MotionConsensus, LeavesTheDecisionToSupportWithoutHypotheses) {
  dm::MotionConsensusOptions options;
  options.maximum_hypotheses = 0;
  const synthetic::Pairs pairs = synthetic::make_pairs(moved(-0.2, 0, 0.05));
  const Answer answer = run(dm::MotionConsensus(options), pairs);
  EXPECT_GE(answer.score.precision, 0.9);
  EXPECT_GE(answer.score.recall, 0.85);
  EXPECT_NE(answer.keep, run(dm::DefaultRule(), pairs).keep);
}

TEST(MotionConsensus, BringsIsolatedMatchesBackThatSupportMisses) {
  dm::MotionConsensusOptions options;
  options.maximum_hypotheses = 0;
  synthetic::Setup setup = moved(-0.6, 0.1, 0.1, -5);
  setup.outliers = 0.7;
  const synthetic::Pairs pairs = synthetic::make_pairs(setup);
  EXPECT_GT(run(dm::DefaultRule(), pairs).score.recall,
            run(dm::MotionConsensus(options), pairs).score.recall + 0.02);
}

TEST(MotionConsensusOptions, RefuseWhatMakesNoSenseByName) {
  const auto expect_named = [](const char* name, auto change) {
    dm::MotionConsensusOptions options;
    change(options);
    try {
      const dm::MotionConsensus rule(options);
      ADD_FAILURE() << name << " was taken";
    } catch (const dynslam::InvalidArgument& error) {
      EXPECT_NE(std::string(error.what()).find(name), std::string::npos) << error.what();
    }
  };
  const float nan = std::numeric_limits<float>::quiet_NaN();
  expect_named("epipolar_tolerance", [](auto& o) { o.epipolar_tolerance = 0; });
  expect_named("epipolar_tolerance", [&](auto& o) { o.epipolar_tolerance = nan; });
  expect_named("support_tolerance", [](auto& o) { o.support_tolerance = -1; });
  expect_named("support_slope", [](auto& o) { o.support_slope = 1; });
  expect_named("support_slope", [&](auto& o) { o.support_slope = nan; });
  expect_named("independence", [](auto& o) { o.independence = 0; });
  expect_named("minimum_support", [](auto& o) { o.minimum_support = 0; });
  expect_named("maximum_hypotheses", [](auto& o) { o.maximum_hypotheses = -1; });
  expect_named("maximum_hypotheses", [](auto& o) { o.maximum_hypotheses = 1001; });
}

}  // namespace
