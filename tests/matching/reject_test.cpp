#include "dynslam/matching/reject.hpp"

#include <array>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/points.hpp"
#include "dynslam/matching/chain.hpp"
#include "dynslam/matching/named_rule.hpp"

#include "matching/synthetic_pairs.hpp"

namespace {

namespace dm = dynslam::matching;
using Flags = std::vector<std::uint8_t>;
using Weights = std::vector<float>;

synthetic::Pairs some_pairs(bool angles = false) {
  synthetic::Setup setup;
  setup.matches = 300;
  setup.camera.translation << -0.2, 0.0, 0.05;
  setup.angles = angles;
  return synthetic::make_pairs(setup);
}

/// A host's own types, as the documentation tells users to adapt them.
struct HostFeature {
  int id;
  double u, v;
};
struct HostMatch {
  unsigned first, second;
};

TEST(Reject, GivesTheSameAnswerForEveryWayToHoldMatches) {
  const synthetic::Pairs pairs = some_pairs();
  const std::size_t n = pairs.matches.size();
  dm::Workspace workspace;
  Flags expected(n), keep(n);
  Weights expected_weight(n), weight(n);
  dm::reject(dm::DefaultRule(), pairs.matches, pairs.points1, pairs.points2, expected,
             expected_weight, workspace);
  std::vector<std::pair<int, int>> index_pairs;
  std::vector<std::array<int, 2>> index_arrays;
  std::vector<int> matches12;
  for (const dynslam::Match& match : pairs.matches) {
    index_pairs.emplace_back(match.query, match.train);
    index_arrays.push_back({match.query, match.train});
    matches12.push_back(match.train);
  }
  const auto check = [&](const auto& matches, const auto& a, const auto& b) {
    dm::reject(dm::DefaultRule(), matches, a, b, keep, weight, workspace);
    EXPECT_EQ(keep, expected);
    EXPECT_EQ(weight, expected_weight);
  };
  check(index_pairs, pairs.points1, pairs.points2);
  check(index_arrays, pairs.points1, pairs.points2);
  check(matches12, pairs.points1, pairs.points2);
  check(dynslam::Span<const dynslam::Match>(pairs.matches), pairs.points1, pairs.points2);

  std::vector<Eigen::Vector2f> vectors1, vectors2;
  for (std::size_t i = 0; i < n; ++i) {
    vectors1.emplace_back(pairs.points1[i].x, pairs.points1[i].y);
    vectors2.emplace_back(pairs.points2[i].x, pairs.points2[i].y);
  }
  check(index_pairs, vectors1, vectors2);
  check(index_pairs, dynslam::StridedSpan<const Eigen::Vector2f>(vectors1), vectors2);
  check(index_pairs, dynslam::as_points<float>(vectors1),
        dynslam::Points2f(dynslam::as_points<float>(vectors2)));
}

TEST(Reject, LeavesEntriesWithoutMatchAtZero) {
  synthetic::Pairs pairs = some_pairs();
  std::vector<int> matches12;
  for (const dynslam::Match& match : pairs.matches) matches12.push_back(match.train);
  matches12[3] = matches12[7] = -1;
  Flags keep(matches12.size(), 9);
  Weights weight(matches12.size(), 9.0F);
  dm::Workspace workspace;
  const dm::Rejection summary =
      dm::reject(dm::NullRule(), matches12, pairs.points1, pairs.points2, keep, weight, workspace);
  EXPECT_EQ(summary.matches, matches12.size() - 2);
  EXPECT_EQ(keep[3], 0);
  EXPECT_EQ(weight[7], 0.0F);
  EXPECT_EQ(keep[4], 1);
}

TEST(Reject, NeverKeepsPointsThatAreNotFiniteOrAbsurdlyFar) {
  const float inf = std::numeric_limits<float>::infinity();
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), inf, -inf, 1e30F, -3e38F}) {
    for (const auto name : dm::kRuleNames) {
      synthetic::Pairs pairs = some_pairs(true);
      pairs.points1[5].x = bad;
      pairs.points2[50].y = bad;
      Flags keep(pairs.matches.size());
      Weights weight(pairs.matches.size());
      dm::Workspace workspace;
      const auto summary = dm::reject(dm::make_rule(name), pairs.matches, pairs.points1,
                                      pairs.points2, keep, weight, workspace);
      EXPECT_EQ(keep[5] + keep[50], 0) << name << ' ' << bad;
      EXPECT_EQ(weight[5] + weight[50], 0.0F) << name << ' ' << bad;
      EXPECT_EQ(summary.usable, pairs.matches.size() - 2);
      for (const float w : weight) ASSERT_TRUE(w >= 0.0F && w <= 1.0F) << name << ' ' << w;
    }
  }
}

TEST(Reject, TakesNoneOneAndTwoMatches) {
  for (const auto name : dm::kRuleNames) {
    for (std::size_t n = 0; n <= 2; ++n) {
      synthetic::Pairs pairs = some_pairs(true);
      pairs.matches.resize(n);
      Flags keep(n);
      Weights weight(n);
      dm::Workspace workspace;
      const auto summary = dm::reject(dm::make_rule(name), pairs.matches, pairs.points1,
                                      pairs.points2, keep, weight, workspace);
      EXPECT_EQ(summary.usable, n) << name;
      EXPECT_LE(summary.kept, n) << name;
      if (n > 0 && name == "default") {
        EXPECT_EQ(summary.kept, 0U);
      }
    }
  }
}

TEST(Reject, WorksWithoutWeights) {
  const synthetic::Pairs pairs = some_pairs();
  Flags keep(pairs.matches.size()), with(pairs.matches.size());
  Weights weight(pairs.matches.size());
  dm::Workspace workspace;
  dm::reject(dm::DefaultRule(), pairs.matches, pairs.points1, pairs.points2, keep, {}, workspace);
  dm::reject(dm::DefaultRule(), pairs.matches, pairs.points1, pairs.points2, with, weight,
             workspace);
  EXPECT_EQ(keep, with);
}

template <typename Call>
std::string message_of(Call call) {
  try {
    call();
  } catch (const dynslam::InvalidArgument& error) {
    return error.what();
  }
  return "no error";
}

TEST(Reject, RefusesOutputsOfTheWrongSizeAndLeavesThemAlone) {
  const synthetic::Pairs pairs = some_pairs();
  Flags keep(pairs.matches.size() - 1, 7);
  Weights weight(3, 7.0F);
  dm::Workspace workspace;
  EXPECT_NE(message_of([&] {
              dm::reject(dm::NullRule(), pairs.matches, pairs.points1, pairs.points2, keep, {},
                         workspace);
            }).find("size of keep"),
            std::string::npos);
  keep.resize(pairs.matches.size(), 7);
  EXPECT_NE(message_of([&] {
              dm::reject(dm::NullRule(), pairs.matches, pairs.points1, pairs.points2, keep, weight,
                         workspace);
            }).find("size of weight"),
            std::string::npos);
  EXPECT_EQ(keep, Flags(pairs.matches.size(), 7));
  EXPECT_EQ(weight, Weights(3, 7.0F));
}

TEST(Reject, RefusesAMatchThatPointsOutsideAndLeavesTheOutputsAlone) {
  synthetic::Pairs pairs = some_pairs();
  Flags keep(pairs.matches.size(), 7);
  dm::Workspace workspace;
  const auto call = [&] {
    dm::reject(dm::DefaultRule(), pairs.matches, pairs.points1, pairs.points2, keep, {}, workspace);
  };
  pairs.matches[200].query = 300;
  EXPECT_NE(message_of(call).find("query index of a match: got 300"), std::string::npos);
  pairs.matches[200].query = 0;
  pairs.matches[200].train = 1000;
  EXPECT_NE(message_of(call).find("train index of a match: got 1000"), std::string::npos);
  EXPECT_EQ(keep, Flags(pairs.matches.size(), 7));
}

TEST(RejectPairs, IsRejectWithMatchingIndices) {
  const synthetic::Pairs pairs = some_pairs(true);
  Flags keep(pairs.matches.size()), expected(pairs.matches.size());
  dm::Workspace workspace;
  std::vector<int> identity(pairs.matches.size());
  for (std::size_t i = 0; i < identity.size(); ++i) identity[i] = static_cast<int>(i);
  dm::reject(dm::DefaultRule(), identity, pairs.points1, pairs.points2, expected, {}, workspace);
  dm::reject_pairs(dm::DefaultRule(), pairs.points1, pairs.points2, keep, {}, workspace);
  EXPECT_EQ(keep, expected);
}

TEST(RejectPairs, RefusesListsOfDifferentLength) {
  synthetic::Pairs pairs = some_pairs();
  pairs.points2.pop_back();
  Flags keep(pairs.points1.size());
  dm::Workspace workspace;
  EXPECT_THROW(dm::reject_pairs(dm::NullRule(), pairs.points1, pairs.points2, keep, {}, workspace),
               dynslam::InvalidArgument);
}

TEST(Workspace, GivesBackWhatAFrameTook) {
  dm::Workspace workspace(10);
  const std::size_t capacity = workspace.capacity();
  for (int i = 0; i < 1000; ++i) {
    const dm::Workspace::Frame frame(workspace);
    const auto floats = workspace.take_filled<float>(1000, 2.0F);
    const auto bytes = workspace.take_filled<std::uint8_t>(77, 3);
    ASSERT_EQ(reinterpret_cast<std::uintptr_t>(bytes.data()) % 64, 0U);
    ASSERT_EQ(floats[999], 2.0F);
  }
  EXPECT_EQ(workspace.capacity(), capacity);
}

TEST(Workspace, KeepsWhatWasTakenWhereItIsWhileItGrows) {
  dm::Workspace workspace;
  const dm::Workspace::Frame frame(workspace);
  const auto first = workspace.take_filled<int>(100, 42);
  for (int i = 0; i < 20; ++i) workspace.take_filled<double>(50000, 1.0);
  for (const int value : first) ASSERT_EQ(value, 42);
}

TEST(Chain, KeepsWhatEveryRuleKeepsAndMultipliesWeights) {
  const synthetic::Pairs pairs = some_pairs(true);
  const std::size_t n = pairs.matches.size();
  Flags first(n), keep(n);
  Weights first_weight(n), weight(n);
  dm::Workspace workspace;
  const dm::RotationConsistency rotation;
  dm::reject(rotation, pairs.matches, pairs.points1, pairs.points2, first, first_weight, workspace);
  std::vector<dynslam::Match> left;
  for (std::size_t i = 0; i < n; ++i) {
    if (first[i] != 0) left.push_back(pairs.matches[i]);
  }
  Flags second(left.size());
  Weights second_weight(left.size());
  dm::reject(dm::DefaultRule(), left, pairs.points1, pairs.points2, second, second_weight,
             workspace);
  dm::reject(dm::chain(rotation, dm::DefaultRule()), pairs.matches, pairs.points1, pairs.points2,
             keep, weight, workspace);
  std::size_t k = 0;
  for (std::size_t i = 0; i < n; ++i) {
    ASSERT_EQ(keep[i], first[i] != 0 ? second[k] : 0);
    ASSERT_FLOAT_EQ(weight[i],
                    first[i] != 0 ? first_weight[i] * second_weight[k] : first_weight[i]);
    k += first[i] != 0;
  }
}

TEST(Chain, OfNothingKeepsEverything) {
  const synthetic::Pairs pairs = some_pairs();
  Flags keep(pairs.matches.size());
  dm::Workspace workspace;
  dm::reject(dm::chain(), pairs.matches, pairs.points1, pairs.points2, keep, {}, workspace);
  EXPECT_EQ(keep, Flags(pairs.matches.size(), 1));
}

TEST(EraseRejected, KeepsTheOrderOfTheRest) {
  std::vector<int> matches = {10, 11, 12, 13};
  dm::erase_rejected(matches, Flags{1, 0, 0, 1});
  EXPECT_EQ(matches, (std::vector<int>{10, 13}));
  EXPECT_THROW(dm::erase_rejected(matches, Flags{1}), dynslam::InvalidArgument);
}

TEST(ClearRejected, WritesMinusOneAndCountsTheRest) {
  std::vector<int> matches12 = {4, -1, 2, 0};
  EXPECT_EQ(dm::clear_rejected(matches12, Flags{1, 0, 0, 1}), 2);
  EXPECT_EQ(matches12, (std::vector<int>{4, -1, -1, 0}));
  EXPECT_THROW(dm::clear_rejected(matches12, Flags{1}), dynslam::InvalidArgument);
}

TEST(ProsacOrder, PutsTheMostTrustedFirstAndKeepsTies) {
  const Weights weight = {0.2F, 0.9F, 0.2F, 1.0F};
  std::vector<std::int32_t> order(4);
  dm::prosac_order(weight, order);
  EXPECT_EQ(order, (std::vector<std::int32_t>{3, 1, 0, 2}));
  EXPECT_THROW(dm::prosac_order(weight, dynslam::Span<std::int32_t>(order.data(), 3)),
               dynslam::InvalidArgument);
}

}  // namespace

namespace dynslam::matching {

template <>
struct KeypointTraits<HostFeature> {
  static Keypoint get(const HostFeature& feature) {
    Keypoint keypoint;
    keypoint.x = static_cast<float>(feature.u);
    keypoint.y = static_cast<float>(feature.v);
    return keypoint;
  }
};

template <>
struct MatchTraits<HostMatch> {
  static Match get(const HostMatch& match, std::size_t) {
    return {static_cast<std::int32_t>(match.first), static_cast<std::int32_t>(match.second), 0.0F};
  }
};

}  // namespace dynslam::matching

namespace {

TEST(Traits, AdaptAHostsOwnTypes) {
  const std::vector<HostFeature> features1 = {{1, 0, 0}, {2, 5, 5}};
  const std::vector<HostFeature> features2 = {{8, 3, 0}, {9, 5, 9}};
  const std::vector<HostMatch> matches = {{0, 1}, {1, 0}};
  Flags keep(2);
  dm::Workspace workspace;
  const auto summary =
      dm::reject(dm::NullRule(), matches, features1, features2, keep, {}, workspace);
  EXPECT_EQ(summary.kept, 2U);
}

}  // namespace
