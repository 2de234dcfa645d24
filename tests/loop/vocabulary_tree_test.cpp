#include "dynslam/loop/vocabulary_tree.hpp"

#include <algorithm>
#include <functional>
#include <limits>
#include <numeric>

#include <gtest/gtest.h>

#include "vocabulary_testing.hpp"

namespace dynslam::loop {
namespace {

using testing::error_of;
using testing::near_nodes;
using testing::random_tree;

void expect_same_results(const Vocabulary& a, const Vocabulary& b, DescriptorsView descriptors) {
  for (const int levels_up : {0, 1, 2}) {
    BowVector bow_a;
    BowVector bow_b;
    FeatureVector direct_a;
    FeatureVector direct_b;
    a.transform({descriptors}, levels_up, bow_a, direct_a);
    b.transform({descriptors}, levels_up, bow_b, direct_b);
    EXPECT_EQ(bow_a, bow_b);
    EXPECT_EQ(direct_a, direct_b);
  }
}

TEST(VocabularyTree, ComesOutOfAVocabularyAsItWentIn) {
  const VocabularyTree tree = random_tree(5, 4, 24, 1);
  const Vocabulary vocabulary = make_vocabulary(tree);
  const VocabularyTree out = tree_of(vocabulary);
  EXPECT_EQ(out.parents, tree.parents);
  EXPECT_EQ(out.words, tree.words);
  EXPECT_EQ(out.weights, tree.weights);
  EXPECT_TRUE(out.ids.empty());
  EXPECT_TRUE(std::equal(out.descriptors.begin() + 24, out.descriptors.end(),
                         tree.descriptors.begin() + 24));
  expect_same_results(vocabulary, make_vocabulary(out), near_nodes(tree, 50, 2).view());
}

TEST(VocabularyTree, KeepsIdsThatAreNotTheOrderOfItsNodes) {
  VocabularyTree tree = random_tree(4, 3, 32, 2);
  const auto descriptors = near_nodes(tree, 80, 3);
  const Vocabulary plain = make_vocabulary(tree);
  tree.ids.resize(tree.nodes());
  std::iota(tree.ids.begin(), tree.ids.end(), 0U);
  std::reverse(tree.ids.begin() + 1, tree.ids.end());
  const Vocabulary named = make_vocabulary(tree);
  EXPECT_EQ(named.transform({descriptors.view()}), plain.transform({descriptors.view()}));
  BowVector bow;
  FeatureVector direct;
  FeatureVector direct_plain;
  named.transform({descriptors.view()}, 1, bow, direct);
  plain.transform({descriptors.view()}, 1, bow, direct_plain);
  ASSERT_EQ(direct.size(), direct_plain.size());
  for (std::size_t i = 0; i < direct.size(); ++i) {
    EXPECT_EQ(direct.node(i), tree.ids[direct_plain.node(direct.size() - 1 - i)]);
  }
  expect_same_results(named, make_vocabulary(tree_of(named)), descriptors.view());
}

TEST(VocabularyTree, TakesParentsBehindTheirChildren) {
  // Rows in reverse: only the root stays first. Sibling order turns round, so no ties may decide.
  const VocabularyTree tree = random_tree(4, 3, 32, 4);
  VocabularyTree turned = tree;
  const auto moved = [&](std::size_t row) { return row == 0 ? 0 : tree.nodes() - row; };
  for (std::size_t row = 1; row < tree.nodes(); ++row) {
    const std::size_t to = moved(row);
    turned.parents[to] = static_cast<std::uint32_t>(moved(tree.parents[row]));
    turned.words[to] = tree.words[row];
    turned.weights[to] = tree.weights[row];
    std::copy_n(tree.descriptors.begin() + static_cast<std::ptrdiff_t>(row * 32), 32,
                turned.descriptors.begin() + static_cast<std::ptrdiff_t>(to * 32));
  }
  const auto descriptors = near_nodes(tree, 60, 5);
  const Vocabulary a = make_vocabulary(tree);
  const Vocabulary b = make_vocabulary(turned);
  std::vector<WordId> words_a(60);
  std::vector<WordId> words_b(60);
  a.find_words(descriptors.view(), words_a);
  b.find_words(descriptors.view(), words_b);
  int equal = 0;
  for (std::size_t i = 0; i < 60; ++i) equal += words_a[i] == words_b[i];
  EXPECT_GE(equal, 50);
  expect_same_results(b, make_vocabulary(tree_of(b)), descriptors.view());
}

TEST(VocabularyTree, TheFirstOfEquallyNearChildrenWins) {
  VocabularyTree tree = random_tree(3, 1, 8, 6);
  std::fill(tree.descriptors.begin(), tree.descriptors.end(), std::uint8_t{7});
  const std::vector<std::uint8_t> descriptor(8, 1);
  WordId word = 9;
  make_vocabulary(tree).find_words({descriptor.data(), 8, 1}, Span<WordId>(&word, 1));
  EXPECT_EQ(word, 0U);
}

TEST(VocabularyTree, WordsMayBeSharedAndLeftOutAndAreRenumberedOnDemand) {
  VocabularyTree tree = random_tree(3, 1, 8, 6);
  tree.words = {kNoWord, 4, 4, 1};
  tree.weights = {0.0, 2.0, 2.0, 3.0};
  const Vocabulary vocabulary = make_vocabulary(tree);
  EXPECT_EQ(vocabulary.words(), 5U);
  EXPECT_EQ(vocabulary.word_weight(4), 2.0);
  EXPECT_EQ(vocabulary.word_weight(0), 0.0);
  renumber_words(tree);
  EXPECT_EQ(tree.words, (std::vector<WordId>{kNoWord, 0, 1, 2}));
}

struct Problem {
  const char* message;
  std::function<void(VocabularyTree&)> cause;
};

TEST(VocabularyTree, NamesEveryProblem) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const VocabularyTree good = random_tree(3, 2, 8, 7);
  std::uint32_t parent = 0;  // a row with children
  std::uint32_t word = 0;    // a row that is one
  for (std::uint32_t row = 1; row < good.nodes(); ++row) {
    (good.words[row] == kNoWord ? parent : word) = row;
  }
  const std::vector<Problem> problems = {
      {"k is 0", [](auto& t) { t.k = 0; }},
      {"k is 65536", [](auto& t) { t.k = 65536; }},
      {"levels is 0", [](auto& t) { t.levels = 0; }},
      {"levels is 256", [](auto& t) { t.levels = 256; }},
      {"descriptor_bytes is 0", [](auto& t) { t.descriptor_bytes = 0; }},
      {"descriptor_bytes is 257", [](auto& t) { t.descriptor_bytes = 257; }},
      {"weighting is 4", [](auto& t) { t.weighting = static_cast<Weighting>(4); }},
      {"scoring is 6", [](auto& t) { t.scoring = static_cast<Scoring>(6); }},
      {"number of nodes is 0", [](auto& t) { t = VocabularyTree(); }},
      {"descriptors.size()", [](auto& t) { t.descriptors.pop_back(); }},
      {"words.size()", [](auto& t) { t.words.pop_back(); }},
      {"weights.size()", [](auto& t) { t.weights.pop_back(); }},
      {"ids.size()", [](auto& t) { t.ids.assign(2, 0); }},
      {"id of the root is 1",
       [](auto& t) {
         t.ids.resize(t.nodes());
         std::iota(t.ids.begin(), t.ids.end(), 0U);
         std::swap(t.ids[0], t.ids[1]);
       }},
      {"id 1 a second time",
       [](auto& t) {
         t.ids.resize(t.nodes());
         std::iota(t.ids.begin(), t.ids.end(), 0U);
         t.ids[2] = 1;
       }},
      {"nodes",
       [](auto& t) {
         t.ids.resize(t.nodes());
         std::iota(t.ids.begin(), t.ids.end(), 0U);
         t.ids[2] = static_cast<NodeId>(t.nodes());
       }},
      {"parent of the root", [](auto& t) { t.parents[0] = 1; }},
      {"parent 9999 of", [](auto& t) { t.parents[2] = 9999; }},
      {"children, expected at most", [](auto& t) { t.k = 1; }},
      {"lies deeper than", [](auto& t) { t.levels = 1; }},
      {"is a word and has children",
       [&](auto& t) {
         t.words[parent] = t.words[word];
         t.weights[parent] = t.weights[word];
       }},
      {"is no word and has no children", [&](auto& t) { t.words[word] = kNoWord; }},
      {"not connected with the root", [&](auto& t) { t.parents[parent] = parent; }},
      {"weight nan", [&](auto& t) { t.weights[word] = nan; }},
      {"weight -1", [&](auto& t) { t.weights[word] = -1.0; }},
      {"weight inf", [&](auto& t) { t.weights[word] = 1.0 / 0.0; }},
      {"expected 0 .. 1e12", [&](auto& t) { t.weights[word] = 2e12; }},
      {"word 4000000000 in a tree", [&](auto& t) { t.words[word] = 4000000000U; }},
      {"a second time, with another weight",
       [&](auto& t) {
         t.words[word] = 0;
         t.weights[word] = 1e6;
       }},
  };
  for (const Problem& problem : problems) {
    VocabularyTree tree = good;
    problem.cause(tree);
    const std::string message = error_of<InvalidArgument>([&] { make_vocabulary(tree); });
    EXPECT_NE(message.find(problem.message), std::string::npos)
        << "got \"" << message << "\", expected \"" << problem.message << '"';
  }
}

}  // namespace
}  // namespace dynslam::loop
