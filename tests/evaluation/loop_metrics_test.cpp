#include "dynslam/evaluation/loop_metrics.hpp"

#include <cstdint>
#include <limits>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

namespace dynslam::evaluation {
namespace {

// Images 3, 4 and 5 show the places of 0, 1 and 2.
struct Truth {
  std::vector<std::uint8_t> pixels = std::vector<std::uint8_t>(48, 0);  // rows with a gap
  Truth() {
    for (std::size_t q = 3; q < 6; ++q) pixels[q * 8 + q - 3] = 255;
    for (std::size_t q = 0; q < 6; ++q) pixels[q * 8 + 7] = 255;  // in the gap
  }
  ImageView<const std::uint8_t> view() const { return {pixels.data(), 6, 6, 8}; }
};

TEST(LoopScores, CountsWhatIsTrueFoundAndRight) {
  const Truth truth;
  const std::vector<LoopDetection> found = {{3, 0, 0.9}, {4, 0, 0.4}, {5, 2, 0.6}, {2, 0, 0.1}};
  const LoopScores scores = score_loops(truth.view(), found);
  EXPECT_EQ(scores.queries, 6u);
  EXPECT_EQ(scores.loops_true, 3u);
  EXPECT_EQ(scores.detected, 4u);
  EXPECT_EQ(scores.correct, 2u);
  EXPECT_DOUBLE_EQ(scores.precision, 0.5);
  EXPECT_DOUBLE_EQ(scores.recall, 2.0 / 3.0);
  EXPECT_DOUBLE_EQ(scores.recall_at_full_precision, 2.0 / 3.0);
  ASSERT_EQ(scores.curve.size(), 4u);
  EXPECT_DOUBLE_EQ(scores.curve[0].threshold, 0.9);
  EXPECT_DOUBLE_EQ(scores.curve[2].precision, 2.0 / 3.0);
}

TEST(LoopScores, DropsEqualScoresTogether) {
  const Truth truth;
  const std::vector<LoopDetection> found = {{3, 0, 0.5}, {4, 0, 0.5}};
  const LoopScores scores = score_loops(truth.view(), found);
  EXPECT_EQ(scores.curve.size(), 1u);
  EXPECT_DOUBLE_EQ(scores.recall_at_full_precision, 0.0)
      << "no threshold lets the true one through alone";
}

TEST(LoopScores, CountsAQueryOnceForRecall) {
  const Truth truth;
  const std::vector<LoopDetection> found = {{3, 0, 0.9}, {3, 0, 0.8}, {3, 0, 0.7}};
  const LoopScores scores = score_loops(truth.view(), found);
  EXPECT_DOUBLE_EQ(scores.precision, 1.0);
  EXPECT_DOUBLE_EQ(scores.recall, 1.0 / 3.0);
}

TEST(LoopScores, AgreeWithCountingAtEveryThreshold) {
  std::mt19937 random(1);
  std::vector<std::uint8_t> pixels(1600);
  for (auto& p : pixels) p = random() % 20 == 0;
  const ImageView<const std::uint8_t> truth(pixels.data(), 40, 40);
  std::vector<LoopDetection> found;
  for (int q = 0; q < 40; ++q) {
    found.push_back({q, static_cast<int>(random() % 40), static_cast<double>(random() % 12)});
  }
  const LoopScores scores = score_loops(truth, found);
  for (const PrecisionRecall& point : scores.curve) {
    double kept = 0, right = 0;
    for (const LoopDetection& d : found) {
      kept += d.score >= point.threshold;
      right += d.score >= point.threshold && truth(d.match, d.query) != 0;
    }
    EXPECT_DOUBLE_EQ(point.precision, right / kept);
    EXPECT_DOUBLE_EQ(point.recall, right / static_cast<double>(scores.loops_true));
  }
}

TEST(LoopScores, OfNoDetectionsAreNeitherWrongNorComplete) {
  const Truth truth;
  const LoopScores scores = score_loops(truth.view(), {});
  EXPECT_DOUBLE_EQ(scores.precision, 1.0);
  EXPECT_DOUBLE_EQ(scores.recall, 0.0);
  EXPECT_DOUBLE_EQ(scores.recall_at_full_precision, 0.0);
  EXPECT_TRUE(scores.curve.empty());
}

TEST(LoopScores, MissNothingWhereThereAreNoLoops) {
  const std::vector<std::uint8_t> none(9, 0);
  const ImageView<const std::uint8_t> truth(none.data(), 3, 3);
  EXPECT_DOUBLE_EQ(score_loops(truth, {}).recall, 1.0);
  const std::vector<LoopDetection> wrong = {{2, 0, 1.0}};
  EXPECT_DOUBLE_EQ(score_loops(truth, wrong).precision, 0.0);
  EXPECT_DOUBLE_EQ(score_loops(truth, wrong).recall_at_full_precision, 0.0);
}

TEST(LoopScores, RefuseBrokenInput) {
  const Truth truth;
  const auto score = [&](LoopDetection d) { return score_loops(truth.view(), {&d, 1}); };
  EXPECT_THROW(score_loops({}, {}), InvalidArgument);
  EXPECT_THROW(score({6, 0, 1.0}), InvalidArgument);
  EXPECT_THROW(score({-1, 0, 1.0}), InvalidArgument);
  EXPECT_THROW(score({0, 6, 1.0}), InvalidArgument);
  EXPECT_THROW(score({0, -1, 1.0}), InvalidArgument);
  EXPECT_THROW(score({3, 0, std::numeric_limits<double>::quiet_NaN()}), InvalidArgument);
}

}  // namespace
}  // namespace dynslam::evaluation
