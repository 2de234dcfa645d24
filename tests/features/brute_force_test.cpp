#include <limits>

#include <gtest/gtest.h>
#include <opencv2/features2d.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/features/hamming_reference.hpp"
#include "dynslam/features/matcher.hpp"

#include "features/support.hpp"

namespace dynslam::features {
namespace {

using testing::noise;
using testing::view;

std::vector<Match> match(const cv::Mat& query, const cv::Mat& train,
                         const BruteForceOptions& options = {}) {
  std::vector<Match> matches = {{5, 5, 5.0F}};
  match_brute_force(view(query), view(train), options, matches);
  return matches;
}

bool same(const std::vector<Match>& a, const std::vector<Match>& b) {
  return a.size() == b.size() &&
         std::equal(a.begin(), a.end(), b.begin(), [](const Match& p, const Match& q) {
           return p.query == q.query && p.train == q.train && p.distance == q.distance;
         });
}

/// Descriptors with few bits set, so that many distances are equal.
cv::Mat sparse(int rows, int width, unsigned seed) {
  cv::Mat a = noise(width, rows, seed);
  const cv::Mat b = noise(width, rows, seed + 1000);
  const cv::Mat c = noise(width, rows, seed + 2000);
  cv::bitwise_and(a, b, a);
  cv::bitwise_and(a, c, a);
  return a;
}

int distance(const cv::Mat& a, int i, const cv::Mat& b, int j) {
  return hamming_distance_reference(a.ptr(i), b.ptr(j), static_cast<std::size_t>(a.cols));
}

/// The definition, with loops.
std::vector<Match> by_hand(const cv::Mat& query, const cv::Mat& train,
                           const BruteForceOptions& options) {
  const auto nearest = [](const cv::Mat& a, int i, const cv::Mat& b, int* second) {
    int best = -1;
    int best_distance = 1 << 30;
    int second_distance = 1 << 30;
    for (int j = 0; j < b.rows; ++j) {
      const int d = distance(a, i, b, j);
      if (d < best_distance) {
        second_distance = best_distance;
        best_distance = d;
        best = j;
      } else if (d < second_distance) {
        second_distance = d;
      }
    }
    if (second != nullptr) *second = second_distance;
    return best;
  };
  std::vector<Match> matches;
  for (int i = 0; i < query.rows; ++i) {
    int second = 0;
    const int best = nearest(query, i, train, &second);
    if (best < 0) continue;
    const int d = distance(query, i, train, best);
    if (d > options.max_distance) continue;
    if (options.ratio < 1.0F && train.rows > 1 &&
        !(static_cast<float>(d) < options.ratio * static_cast<float>(second))) {
      continue;
    }
    if (options.cross_check && nearest(train, best, query, nullptr) != i) continue;
    matches.push_back({i, best, static_cast<float>(d)});
  }
  return matches;
}

TEST(MatchBruteForce, EqualsTheDefinitionOnAllTargetsForAllOptionsAndSizes) {
  for (const int width : {1, 31, 32, 33, 48, 64, 270}) {
    for (const auto& rows : {std::pair{1, 1}, {3, 7}, {9, 8}, {40, 65}, {70, 33}}) {
      const cv::Mat query = sparse(rows.first, width, 1);
      const cv::Mat train = sparse(rows.second, width, 2);
      BruteForceOptions options;
      for (const bool cross_check : {false, true}) {
        for (const float ratio : {1.0F, 0.9F}) {
          for (const int max_distance : {std::numeric_limits<int>::max(), width}) {
            options.cross_check = cross_check;
            options.ratio = ratio;
            options.max_distance = max_distance;
            const std::vector<Match> expected = by_hand(query, train, options);
            testing::for_each_target([&](const std::string& target) {
              EXPECT_TRUE(same(match(query, train, options), expected))
                  << target << " " << width << " " << query.rows << " " << train.rows;
            });
          }
        }
      }
    }
  }
}

TEST(MatchBruteForce, CrossesTheBordersOfItsBlocksOnAllTargets) {
  // Blocks hold 4096 rows; 8 bits make many ties within and between them.
  const cv::Mat query = noise(1, 4200, 1);
  const cv::Mat train = noise(1, 4111, 2);
  BruteForceOptions options;
  options.cross_check = true;
  const std::vector<Match> expected = by_hand(query, train, options);
  ASSERT_GT(expected.size(), 100U);
  testing::for_each_target([&](const std::string& target) {
    EXPECT_TRUE(same(match(query, train, options), expected)) << target;
  });
}

TEST(MatchBruteForce, AgreesWithOpenCvsMatcher) {
  const cv::Mat query = noise(32, 300, 1);
  const cv::Mat train = noise(32, 250, 2);
  std::vector<cv::DMatch> opencv;
  cv::BFMatcher(cv::NORM_HAMMING).match(query, train, opencv);
  const std::vector<Match> ours = match(query, train);
  ASSERT_EQ(ours.size(), opencv.size());
  for (std::size_t i = 0; i < ours.size(); ++i) {
    EXPECT_EQ(ours[i].distance, opencv[i].distance);
    EXPECT_EQ(ours[i].query, opencv[i].queryIdx);
  }
}

TEST(MatchBruteForce, FindsEveryDescriptorInAShuffledCopyOfItself) {
  const cv::Mat train = noise(32, 500, 3);
  cv::Mat query;
  cv::flip(train, query, 0);
  BruteForceOptions strict;
  strict.max_distance = 0;
  strict.ratio = 0.5F;
  strict.cross_check = true;
  const std::vector<Match> matches = match(query, train, strict);
  ASSERT_EQ(matches.size(), 500U);
  for (const Match& m : matches) EXPECT_EQ(m.train, 499 - m.query);
}

TEST(MatchBruteForce, RatioLetsALoneTrainDescriptorPassAndStopsTwoEqualOnes) {
  const cv::Mat query = noise(32, 1, 1);
  const cv::Mat one = noise(32, 1, 2);
  cv::Mat two;
  cv::vconcat(one, one, two);
  BruteForceOptions options;
  options.ratio = 0.8F;
  EXPECT_EQ(match(query, one, options).size(), 1U);
  EXPECT_TRUE(match(query, two, options).empty());
}

TEST(MatchBruteForce, OfAnEmptySetHasNoMatches) {
  const cv::Mat some = noise(32, 5, 1);
  EXPECT_TRUE(match(cv::Mat(), some).empty());
  EXPECT_TRUE(match(some, cv::Mat()).empty());
  EXPECT_TRUE(match(cv::Mat(), cv::Mat()).empty());
}

TEST(MatchBruteForce, TakesRowsWithGaps) {
  const cv::Mat wide = noise(50, 40, 1);
  const cv::Mat query = wide.colRange(3, 35);
  const cv::Mat train = wide.colRange(9, 41);
  EXPECT_TRUE(same(match(query, train), match(query.clone(), train.clone())));
}

TEST(MatchBruteForce, RefusesWidthsThatDifferAndLeavesTheOutputAlone) {
  const cv::Mat query = noise(32, 5, 1);
  const cv::Mat train = noise(33, 5, 1);
  std::vector<Match> matches(2);
  EXPECT_THROW(match_brute_force(view(query), view(train), {}, matches), InvalidArgument);
  const cv::Mat huge = cv::Mat::zeros(1, 200000, CV_8UC1);
  EXPECT_THROW(match_brute_force(view(huge), view(huge), {}, matches), InvalidArgument);
  EXPECT_EQ(matches.size(), 2U);
}

TEST(BruteForceOptions, MaxDistanceIsNotNegative) {
  BruteForceOptions options;
  options.max_distance = -1;
  EXPECT_THROW(options.validate(), InvalidArgument);
  std::vector<Match> matches(2);
  EXPECT_THROW(match_brute_force({}, {}, options, matches), InvalidArgument);
  EXPECT_EQ(matches.size(), 2U);
}

TEST(BruteForceOptions, RatioIsInZeroToOne) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (const float bad : {0.0F, -0.5F, 1.01F, nan}) {
    BruteForceOptions options;
    options.ratio = bad;
    EXPECT_THROW(options.validate(), InvalidArgument) << bad;
  }
}

}  // namespace
}  // namespace dynslam::features
