#include "dynslam/evaluation/association.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <tuple>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

#include "evaluation/support.hpp"

namespace dynslam::evaluation {
namespace {

using Pairs = std::vector<PosePair>;

Trajectory at(const std::vector<double>& times) {
  Trajectory t;
  for (const double time : times) t.push_back({time, {}});
  return t;
}

// The rule itself: all neighbours in the common order of time, closest first.
Pairs brute_force(const Trajectory& truth, const Trajectory& estimate, double limit) {
  std::vector<std::tuple<double, int, std::size_t>> order;  // time, truth before estimate, index
  for (std::size_t i = 0; i < truth.size(); ++i) order.emplace_back(truth[i].timestamp, 0, i);
  for (std::size_t j = 0; j < estimate.size(); ++j) order.emplace_back(estimate[j].timestamp, 1, j);
  std::sort(order.begin(), order.end());
  std::vector<std::tuple<double, std::size_t>> gaps;
  for (std::size_t g = 0; g + 1 < order.size(); ++g) {
    const double gap = std::get<0>(order[g + 1]) - std::get<0>(order[g]);
    if (std::get<1>(order[g]) != std::get<1>(order[g + 1]) && gap <= limit)
      gaps.emplace_back(gap, g);
  }
  std::sort(gaps.begin(), gaps.end());
  std::set<std::size_t> used;
  Pairs pairs;
  for (const auto& [gap, g] : gaps) {
    if (used.count(g) || used.count(g + 1)) continue;
    used.insert({g, g + 1});
    const bool first_is_truth = std::get<1>(order[g]) == 0;
    const std::size_t a = std::get<2>(order[g]), b = std::get<2>(order[g + 1]);
    pairs.push_back(first_is_truth ? PosePair{a, b} : PosePair{b, a});
  }
  std::sort(pairs.begin(), pairs.end(),
            [](const PosePair& a, const PosePair& b) { return a.truth < b.truth; });
  return pairs;
}

TEST(Association, AgreesWithBruteForceOnRandomTimes) {
  std::mt19937 random(3);
  std::uniform_int_distribution<int> count(0, 60), tick(0, 400);
  for (int round = 0; round < 500; ++round) {
    std::set<double> a, b;
    // Every second round on a grid, where many distances are equal.
    const double grid = round % 2 ? 0.0078125 : 0.0078125 + 1e-5 * (round % 7);
    for (int i = count(random); i > 0; --i) a.insert(tick(random) * 0.0078125);
    for (int i = count(random); i > 0; --i) b.insert(tick(random) * grid);
    const Trajectory truth = at({a.begin(), a.end()}), estimate = at({b.begin(), b.end()});
    EXPECT_EQ(associate(truth, estimate), brute_force(truth, estimate, 0.02 + 1e-9)) << round;
  }
}

TEST(Association, IsOneToOneAndInOrderOfTime) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> time(0.0, 1.0);
  std::set<double> a, b;
  for (int i = 0; i < 200; ++i) a.insert(time(random)), b.insert(time(random));
  const Pairs pairs = associate(at({a.begin(), a.end()}), at({b.begin(), b.end()}));
  ASSERT_GT(pairs.size(), 50u);
  for (std::size_t k = 1; k < pairs.size(); ++k) {
    EXPECT_LT(pairs[k - 1].truth, pairs[k].truth);
    EXPECT_LT(pairs[k - 1].estimate, pairs[k].estimate);
  }
}

TEST(Association, GivesTheLoserItsSecondChoice) {
  // 0.010 is nearest to both; the closer one at 0.009 gets it and 0.012 keeps 0.025.
  EXPECT_EQ(associate(at({0.010, 0.025}), at({0.009, 0.012})), (Pairs{{0, 0}, {1, 1}}));
}

TEST(Association, TakesTheEarlierOfTwoEquallyCloseOnes) {
  EXPECT_EQ(associate(at({0.0, 0.03125}), at({0.015625})), (Pairs{{0, 0}}));
}

TEST(Association, IncludesTheLimitItself) {
  EXPECT_EQ(associate(at({1311868164.34}), at({1311868164.36})).size(), 1u);
  EXPECT_TRUE(associate(at({1.0}), at({1.0201})).empty());
}

TEST(Association, AddsTheOffsetToTheEstimate) {
  AssociationOptions options;
  options.offset = 5.0;
  EXPECT_EQ(associate(at({5.0, 6.0}), at({1.0}), options), (Pairs{{1, 0}}));
}

TEST(Association, OfNothingIsEmpty) {
  EXPECT_TRUE(associate({}, {}).empty());
  EXPECT_TRUE(associate(at({1.0}), {}).empty());
  EXPECT_TRUE(associate({}, at({1.0})).empty());
}

TEST(Association, RefusesTimestampsThatDoNotIncrease) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(associate(at({1.0, 1.0}), at({1.0})), InvalidArgument);
  EXPECT_THROW(associate(at({1.0}), at({2.0, 1.0})), InvalidArgument);
  EXPECT_THROW(associate(at({nan}), at({1.0})), InvalidArgument);
}

TEST(Association, ChecksItsOptions) {
  AssociationOptions options;
  options.max_difference = -1.0;
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = {};
  options.offset = std::numeric_limits<double>::infinity();
  EXPECT_THROW(associate({}, {}, options), InvalidArgument);
}

}  // namespace
}  // namespace dynslam::evaluation
