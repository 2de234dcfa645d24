#include "dynslam/loop/vocabulary.hpp"

#include <cmath>
#include <limits>
#include <map>

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include "vocabulary_testing.hpp"

namespace dynslam::loop {
namespace {

using testing::Descriptors;
using testing::error_of;
using testing::near_nodes;
using testing::random_tree;
using testing::slow_walk;

class EveryLength : public ::testing::TestWithParam<int> {};

TEST_P(EveryLength, FindsTheWordsOfTheSlowWalkOnEveryTarget) {
  const VocabularyTree tree = random_tree(6, 4, GetParam(), 11);
  const Vocabulary vocabulary = make_vocabulary(tree);
  const Descriptors descriptors = near_nodes(tree, 101, 12);
  std::vector<WordId> expected;
  for (int i = 0; i < 101; ++i) {
    expected.push_back(slow_walk(tree, descriptors.view().row(i)).word);
  }
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    std::vector<WordId> words(101);
    vocabulary.find_words(descriptors.view(), words);
    EXPECT_EQ(words, expected) << hwy::TargetName(target);
  }
  hwy::SetSupportedTargetsForTest(0);
}

INSTANTIATE_TEST_SUITE_P(Vocabulary, EveryLength,
                         ::testing::Values(1, 5, 8, 16, 31, 32, 33, 48, 61, 64, 128, 255, 256));

TEST(Vocabulary, KnowsItsTree) {
  VocabularyTree tree = random_tree(5, 3, 32, 1);
  tree.scoring = Scoring::kBhattacharyya;
  tree.weighting = Weighting::kTf;
  const Vocabulary vocabulary = make_vocabulary(tree);
  EXPECT_EQ(vocabulary.k(), 5);
  EXPECT_EQ(vocabulary.levels(), 3);
  EXPECT_EQ(vocabulary.descriptor_bytes(), 32);
  EXPECT_EQ(vocabulary.nodes(), tree.nodes());
  EXPECT_EQ(vocabulary.scoring(), Scoring::kBhattacharyya);
  EXPECT_EQ(vocabulary.weighting(), Weighting::kTf);
  EXPECT_FALSE(vocabulary.single_precision());
  std::size_t words = 0;
  for (std::size_t row = 1; row < tree.nodes(); ++row) {
    if (tree.words[row] == kNoWord) continue;
    EXPECT_EQ(vocabulary.word_weight(tree.words[row]), tree.weights[row]);
    ++words;
  }
  EXPECT_EQ(vocabulary.words(), words);
  EXPECT_THROW(vocabulary.word_weight(static_cast<WordId>(words)), InvalidArgument);
}

TEST(Vocabulary, CountsWordsByTheirWeightsAndNormalizes) {
  const VocabularyTree tree = random_tree(6, 3, 32, 2);
  const Vocabulary vocabulary = make_vocabulary(tree);
  const Descriptors descriptors = near_nodes(tree, 200, 3);
  std::map<WordId, double> sums;
  double total = 0.0;
  for (int i = 0; i < 200; ++i) {
    const WordId word = slow_walk(tree, descriptors.view().row(i)).word;
    sums[word] += vocabulary.word_weight(word);
    total += vocabulary.word_weight(word);
  }
  const BowVector bow = vocabulary.transform({descriptors.view()});
  ASSERT_EQ(bow.size(), sums.size());
  for (std::size_t i = 0; i < bow.size(); ++i) {
    EXPECT_NEAR(bow.weight(i), sums[bow.word(i)] / total, 1e-12);
  }
  EXPECT_EQ(vocabulary.score(bow, bow), l1_score(bow, bow));
}

TEST(Vocabulary, GivesTheDirectIndexAtEveryLevel) {
  const VocabularyTree tree = random_tree(5, 4, 32, 4);
  const Vocabulary vocabulary = make_vocabulary(tree);
  const Descriptors descriptors = near_nodes(tree, 150, 5);
  for (int levels_up = 0; levels_up <= 6; ++levels_up) {
    std::map<NodeId, std::vector<std::uint32_t>> expected;
    for (std::uint32_t i = 0; i < 150; ++i) {
      const auto arrival = slow_walk(tree, descriptors.view().row(static_cast<int>(i)));
      const int level = std::min<int>(4 - levels_up, static_cast<int>(arrival.path.size()));
      expected[level <= 0 ? 0 : arrival.path[static_cast<std::size_t>(level - 1)]].push_back(i);
    }
    BowVector bow;
    FeatureVector direct;
    vocabulary.transform({descriptors.view()}, levels_up, bow, direct);
    ASSERT_EQ(direct.size(), expected.size()) << levels_up;
    std::size_t n = 0;
    for (const auto& [node, features] : expected) {
      EXPECT_EQ(direct.node(n), node);
      const auto own = direct.features(n++);
      EXPECT_EQ(std::vector<std::uint32_t>(own.begin(), own.end()), features);
    }
  }
}

TEST(Vocabulary, LeavesMaskedFeaturesOut) {
  const VocabularyTree tree = random_tree(6, 3, 32, 6);
  const Vocabulary vocabulary = make_vocabulary(tree);
  const Descriptors all = near_nodes(tree, 100, 7);
  std::vector<std::uint8_t> keep(100);
  std::vector<float> weights(100);
  Descriptors kept;
  for (std::size_t i = 0; i < 100; ++i) {
    keep[i] = i % 3 == 0 ? 255 : 0;
    weights[i] = keep[i] != 0 ? 1.0F : 0.0F;
    if (keep[i] != 0)
      kept.bytes.insert(kept.bytes.end(), all.view().row(static_cast<int>(i)),
                        all.view().row(static_cast<int>(i)) + 32);
  }
  const BowVector expected = vocabulary.transform({kept.view()});
  BowVector bow;
  FeatureVector direct;
  vocabulary.transform({all.view(), keep}, 1, bow, direct);
  EXPECT_EQ(bow, expected);
  for (const std::uint32_t feature : direct.all_features()) EXPECT_EQ(feature % 3, 0U);
  EXPECT_EQ(direct.all_features().size(), 34U);
  EXPECT_EQ(vocabulary.transform({all.view(), {}, weights}), expected);
}

TEST(Vocabulary, LowersTheCountOfAWordByStaticWeights) {
  VocabularyTree tree = random_tree(4, 1, 8, 8);
  tree.scoring = Scoring::kDotProduct;  // no norm, but divided by the number of words
  const Vocabulary vocabulary = make_vocabulary(tree);
  Descriptors one;
  one.width = 8;
  for (int copy = 0; copy < 3; ++copy)
    one.bytes.insert(one.bytes.end(), tree.descriptors.begin() + 8, tree.descriptors.begin() + 16);
  const std::vector<float> weights = {1.0F, 0.5F, 0.25F};
  const BowVector bow = vocabulary.transform({one.view(), {}, weights});
  ASSERT_EQ(bow.size(), 1U);
  EXPECT_DOUBLE_EQ(bow.weight(0), 1.75 * vocabulary.word_weight(bow.word(0)));
  const BowVector idf =
      vocabulary.with(Weighting::kIdf, Scoring::kDotProduct).transform({one.view(), {}, weights});
  EXPECT_DOUBLE_EQ(idf.weight(0), vocabulary.word_weight(bow.word(0)));
}

TEST(Vocabulary, LeavesStoppedWordsOut) {
  VocabularyTree tree = random_tree(4, 2, 32, 9);
  for (std::size_t row = 1; row < tree.nodes(); ++row) {
    if (tree.words[row] != kNoWord && tree.words[row] % 2 == 0) tree.weights[row] = 0.0;
  }
  const Vocabulary vocabulary = make_vocabulary(tree);
  const Descriptors descriptors = near_nodes(tree, 100, 10);
  BowVector bow;
  FeatureVector direct;
  vocabulary.transform({descriptors.view()}, 0, bow, direct);
  std::size_t expected = 0;
  for (int i = 0; i < 100; ++i) expected += slow_walk(tree, descriptors.view().row(i)).word % 2;
  for (const WordId word : bow.words()) EXPECT_EQ(word % 2, 1U);
  EXPECT_EQ(direct.all_features().size(), expected);
}

TEST(Vocabulary, OfNoFeaturesGivesEmptyResults) {
  const Vocabulary vocabulary = make_vocabulary(random_tree(4, 2, 32, 9));
  BowVector bow;
  bow.push_back(1, 1.0);
  FeatureVector direct;
  vocabulary.transform({}, 0, bow, direct);
  EXPECT_TRUE(bow.empty());
  EXPECT_TRUE(direct.empty());
  vocabulary.find_words({}, {});
}

TEST(Vocabulary, TakesRowsWithGaps) {
  const VocabularyTree tree = random_tree(6, 3, 32, 20);
  const Vocabulary vocabulary = make_vocabulary(tree);
  const Descriptors dense = near_nodes(tree, 40, 21);
  std::vector<std::uint8_t> wide(40 * 50 + 1, 0xAA);
  for (int i = 0; i < 40; ++i)
    std::copy_n(dense.view().row(i), 32, wide.begin() + 1 + std::ptrdiff_t{50} * i);
  const DescriptorsView gaps(wide.data() + 1, 32, 40, 50);
  EXPECT_EQ(vocabulary.transform({gaps}), vocabulary.transform({dense.view()}));
}

TEST(Vocabulary, GivesTheSameWithOneWorkspaceForAll) {
  TransformWorkspace workspace;
  for (const int bytes : {32, 61, 8}) {
    const VocabularyTree tree = random_tree(5, 3, bytes, 30);
    const Vocabulary vocabulary = make_vocabulary(tree);
    for (const std::size_t count : {100U, 1U, 300U, 0U}) {
      const Descriptors descriptors = near_nodes(tree, count, 31);
      BowVector bow;
      FeatureVector direct;
      vocabulary.transform({descriptors.view()}, bow, &direct, 1, workspace);
      BowVector bow2;
      FeatureVector direct2;
      vocabulary.transform({descriptors.view()}, 1, bow2, direct2);
      EXPECT_EQ(bow, bow2);
      EXPECT_EQ(direct, direct2);
    }
  }
}

TEST(Vocabulary, NamesWhatIsWrongWithTheFeaturesAndLeavesOutputsAlone) {
  const VocabularyTree tree = random_tree(4, 2, 32, 9);
  const Vocabulary vocabulary = make_vocabulary(tree);
  const Descriptors good = near_nodes(tree, 3, 1);
  Descriptors narrow = good;
  narrow.width = 16;
  const std::vector<std::uint8_t> keep(2, 1);
  const std::vector<float> weights(2, 1.0F);
  const std::vector<float> bad = {1.0F, std::numeric_limits<float>::quiet_NaN(), 0.5F};
  const std::vector<float> high = {1.0F, 1.5F, 0.5F};
  BowVector bow;
  bow.push_back(7, 1.0);
  FeatureVector direct;
  TransformWorkspace workspace;
  const auto message = [&](const Features& features, int levels_up) {
    return error_of<InvalidArgument>(
        [&] { vocabulary.transform(features, bow, &direct, levels_up, workspace); });
  };
  EXPECT_NE(message({narrow.view()}, 0).find("descriptors.width: got 16"), std::string::npos);
  EXPECT_NE(message({good.view(), keep}, 0).find("keep.size(): got 2"), std::string::npos);
  EXPECT_NE(message({good.view(), {}, weights}, 0).find("weights.size()"), std::string::npos);
  EXPECT_NE(message({good.view(), {}, bad}, 0).find("weights[i]: got nan"), std::string::npos);
  EXPECT_NE(message({good.view(), {}, high}, 0).find("weights[i]: got 1.5"), std::string::npos);
  EXPECT_NE(message({good.view()}, -1).find("levels_up"), std::string::npos);
  EXPECT_EQ(bow.size(), 1U);
  std::vector<WordId> words(2);
  EXPECT_THROW(vocabulary.find_words(good.view(), words), InvalidArgument);
  EXPECT_THROW(vocabulary.find_words(narrow.view(), words), InvalidArgument);
}

TEST(Vocabulary, ThatIsEmptySaysSo) {
  const Vocabulary none;
  EXPECT_TRUE(none.empty());
  EXPECT_EQ(none.words(), 0U);
  EXPECT_EQ(none.bytes(), 0U);
  EXPECT_THROW(none.transform({}), InvalidArgument);
  EXPECT_THROW(none.scoring(), InvalidArgument);
  EXPECT_THROW(none.word_weight(0), InvalidArgument);
}

}  // namespace
}  // namespace dynslam::loop
