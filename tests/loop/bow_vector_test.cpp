#include "dynslam/loop/bow_vector.hpp"

#include <cmath>
#include <limits>
#include <map>
#include <random>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

namespace dynslam::loop {
namespace {

BowVector vector_of(const std::map<WordId, double>& weights, Norm norm = Norm::kNone) {
  BowVector v;
  for (const auto& [word, weight] : weights) v.push_back(word, weight);
  v.normalize(norm);
  return v;
}

std::map<WordId, double> random_weights(unsigned seed, WordId words, std::size_t count) {
  std::mt19937 random(seed);
  std::map<WordId, double> weights;
  while (weights.size() < count) weights[random() % words] = (random() % 1000 + 1) / 100.0;
  return weights;
}

/// The equations at Scoring, over all words.
double slow_score(Scoring scoring, const std::map<WordId, double>& a,
                  const std::map<WordId, double>& b, WordId words) {
  double sum = 0.0;
  for (WordId i = 0; i < words; ++i) {
    const double v = a.count(i) != 0 ? a.at(i) : 0.0;
    const double w = b.count(i) != 0 ? b.at(i) : 0.0;
    switch (scoring) {
      case Scoring::kL1:
        sum += std::abs(v - w) / 2.0;
        break;
      case Scoring::kL2:
      case Scoring::kDotProduct:
        sum += v * w;
        break;
      case Scoring::kChiSquare:
        if (v + w > 0.0) sum += 2.0 * v * w / (v + w);
        break;
      case Scoring::kKullbackLeibler:
        if (v > 0.0) sum += v * std::log(v / (w > 0.0 ? w : std::pow(2.0, -52)));
        break;
      case Scoring::kBhattacharyya:
        sum += std::sqrt(v * w);
        break;
    }
  }
  if (scoring == Scoring::kL1) return 1.0 - sum;
  if (scoring == Scoring::kL2) return 1.0 - std::sqrt(1.0 - sum);
  return sum;
}

std::map<WordId, double> map_of(const BowVector& v) {
  std::map<WordId, double> weights;
  for (std::size_t i = 0; i < v.size(); ++i) weights[v.word(i)] = v.weight(i);
  return weights;
}

class EveryScoring : public ::testing::TestWithParam<int> {
 protected:
  Scoring scoring() const { return static_cast<Scoring>(GetParam()); }
};

TEST_P(EveryScoring, IsItsEquation) {
  const WordId words = 400;
  for (unsigned seed = 0; seed < 20; ++seed) {
    // Vectors of the same and of very different density.
    const BowVector a = vector_of(random_weights(seed, words, 120), norm_of(scoring()));
    const BowVector b =
        vector_of(random_weights(seed + 100, words, seed % 2 == 0 ? 110 : 4), norm_of(scoring()));
    const double expected = slow_score(scoring(), map_of(a), map_of(b), words);
    EXPECT_NEAR(score(scoring(), a, b), expected, 1e-9 * (1.0 + std::abs(expected)));
  }
}

TEST_P(EveryScoring, OfAVectorWithItselfIsTheBest) {
  const BowVector a = vector_of(random_weights(1, 400, 50), norm_of(scoring()));
  const BowVector b = vector_of(random_weights(2, 400, 50), norm_of(scoring()));
  const double self = score(scoring(), a, a);
  const double other = score(scoring(), a, b);
  EXPECT_TRUE(higher_is_better(scoring()) ? self > other : self < other);
  if (scoring() == Scoring::kKullbackLeibler) {
    EXPECT_NEAR(self, 0.0, 1e-12);
  } else if (scoring() != Scoring::kDotProduct) {
    EXPECT_NEAR(self, 1.0, 1e-7);
  }
}

TEST_P(EveryScoring, WithAnEmptyVectorIsZero) {
  const BowVector a = vector_of({{1, 1.0}});
  EXPECT_EQ(score(scoring(), BowVector(), a), 0.0);
  EXPECT_EQ(score(scoring(), BowVector(), BowVector()), 0.0);
  if (scoring() != Scoring::kKullbackLeibler) {
    EXPECT_EQ(score(scoring(), a, BowVector()), 0.0);
  }
}

INSTANTIATE_TEST_SUITE_P(BowVector, EveryScoring, ::testing::Range(0, 6));

TEST(Score, RefusesANameThatIsNone) {
  EXPECT_THROW(score(static_cast<Scoring>(6), BowVector(), BowVector()), InvalidArgument);
}

TEST(BowVector, KeepsWordsAscending) {
  BowVector v;
  v.push_back(3, 1.0);
  EXPECT_THROW(v.push_back(3, 1.0), InvalidArgument);
  EXPECT_THROW(v.push_back(2, 1.0), InvalidArgument);
  EXPECT_THROW(v.push_back(4, std::numeric_limits<double>::quiet_NaN()), InvalidArgument);
  EXPECT_EQ(v.size(), 1U);
}

TEST(BowVector, AddsToAWordOrPutsItWhereItBelongs) {
  BowVector v = vector_of({{3, 1.0}, {7, 2.0}});
  v.add(5, 4.0);
  v.add(7, 0.5);
  v.add(1, 9.0);
  EXPECT_EQ(v, vector_of({{1, 9.0}, {3, 1.0}, {5, 4.0}, {7, 2.5}}));
  EXPECT_EQ(v.weight_of(5), 4.0);
  EXPECT_EQ(v.weight_of(6), 0.0);
  EXPECT_THROW(v.add(1, std::numeric_limits<double>::infinity()), InvalidArgument);
}

TEST(BowVector, NormalizesToOne) {
  EXPECT_EQ(vector_of({{0, 1.0}, {1, 3.0}}, Norm::kL1), vector_of({{0, 0.25}, {1, 0.75}}));
  EXPECT_EQ(vector_of({{0, 3.0}, {1, 4.0}}, Norm::kL2), vector_of({{0, 0.6}, {1, 0.8}}));
  EXPECT_EQ(vector_of({{0, 0.0}}, Norm::kL1), vector_of({{0, 0.0}}));
}

TEST(FeatureVector, GroupsFeaturesByNode) {
  for (const std::size_t count : {5U, 500U}) {
    std::mt19937 random(4);
    std::vector<NodeId> nodes;
    std::vector<std::uint32_t> rows;
    std::map<NodeId, std::vector<std::uint32_t>> expected;
    for (std::uint32_t i = 0; i < count; ++i) {
      nodes.push_back(random() % 40 * 50000);
      rows.push_back(2 * i + 1);
      expected[nodes.back()].push_back(rows.back());
    }
    FeatureVector direct;
    direct.assign(nodes, rows);
    ASSERT_EQ(direct.size(), expected.size());
    std::size_t n = 0;
    for (const auto& [node, features] : expected) {
      EXPECT_EQ(direct.node(n), node);
      const auto own = direct.features(n++);
      EXPECT_EQ(std::vector<std::uint32_t>(own.begin(), own.end()), features);
    }
    EXPECT_EQ(direct.all_features().size(), count);
  }
}

TEST(FeatureVector, WantsARowForEachNode) {
  FeatureVector direct;
  const std::vector<NodeId> nodes = {1, 2};
  const std::vector<std::uint32_t> rows = {1};
  EXPECT_THROW(direct.assign(nodes, rows), InvalidArgument);
  direct.assign({});
  EXPECT_TRUE(direct.empty());
}

}  // namespace
}  // namespace dynslam::loop
