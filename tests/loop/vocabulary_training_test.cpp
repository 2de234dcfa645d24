#include "dynslam/loop/vocabulary_training.hpp"

#include <cmath>
#include <random>
#include <set>
#include <stdexcept>

#include <gtest/gtest.h>

#include "dynslam/loop/vocabulary_tree.hpp"

#include "loop/majority.hpp"
#include "vocabulary_testing.hpp"

namespace dynslam::loop {
namespace {

using testing::Descriptors;
using testing::error_of;

/// `count` descriptors around `centres` random ones, few bits off.
Descriptors clusters(std::size_t centres, std::size_t count, int width, unsigned seed) {
  std::mt19937 random(seed);
  Descriptors result;
  result.width = width;
  std::vector<std::uint8_t> middle(centres * static_cast<std::size_t>(width));
  for (auto& byte : middle) byte = static_cast<std::uint8_t>(random());
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t b = 0; b < static_cast<std::size_t>(width); ++b) {
      const unsigned noise = random() & random() & random() & random() & random();
      result.bytes.push_back(static_cast<std::uint8_t>(
          middle[i % centres * static_cast<std::size_t>(width) + b] ^ noise));
    }
  }
  return result;
}

TrainingOptions small(int k, int levels) {
  TrainingOptions options;
  options.k = k;
  options.levels = levels;
  return options;
}

TEST(Training, FindsClustersThatAreThere) {
  const Descriptors descriptors = clusters(8, 800, 32, 1);
  const Vocabulary vocabulary = train_vocabulary(descriptors.view(), {}, small(8, 1));
  EXPECT_EQ(vocabulary.words(), 8U);
  std::vector<WordId> words(800);
  vocabulary.find_words(descriptors.view(), words);
  std::set<WordId> used;
  std::size_t pure = 0;
  for (std::size_t i = 0; i < 800; ++i) {
    used.insert(words[i]);
    pure += words[i] == words[i % 8];
  }
  // k-means++ may seed two clusters as one; most are found.
  EXPECT_GE(used.size(), 7U);
  EXPECT_GE(pure, 650U);
}

TEST(Training, GivesTheSameVocabularyOnAnyNumberOfThreads) {
  const Descriptors descriptors = clusters(300, 140000, 16, 2);
  TrainingOptions options = small(6, 3);
  options.max_rounds = 4;
  options.seed = 5;
  const VocabularyTree one = tree_of(train_vocabulary(descriptors.view(), {}, options));
  options.threads = 3;
  const VocabularyTree three = tree_of(train_vocabulary(descriptors.view(), {}, options));
  EXPECT_EQ(one.descriptors, three.descriptors);
  EXPECT_EQ(one.parents, three.parents);
  options.seed = 6;
  const VocabularyTree other = tree_of(train_vocabulary(descriptors.view(), {}, options));
  EXPECT_NE(one.descriptors, other.descriptors);
}

TEST(Training, WeighsWordsByTheImagesThatHaveThem) {
  const Descriptors descriptors = clusters(40, 600, 32, 3);
  std::vector<std::size_t> ends;
  for (std::size_t end = 50; end <= 600; end += 50) ends.push_back(end);
  const Vocabulary vocabulary = train_vocabulary(descriptors.view(), ends, small(5, 3));
  std::vector<WordId> words(600);
  vocabulary.find_words(descriptors.view(), words);
  for (WordId word = 0; word < vocabulary.words(); ++word) {
    std::set<std::size_t> images;
    for (std::size_t i = 0; i < 600; ++i) {
      if (words[i] == word) images.insert(i / 50);
    }
    const double count = std::max<double>(static_cast<double>(images.size()), 1.0);
    EXPECT_EQ(vocabulary.word_weight(word),
              static_cast<double>(static_cast<float>(std::log(12.0 / count))));
  }
  TrainingOptions binary = small(5, 3);
  binary.weighting = Weighting::kBinary;
  EXPECT_EQ(train_vocabulary(descriptors.view(), ends, binary).word_weight(0), 1.0);
  EXPECT_EQ(train_vocabulary(descriptors.view(), {}, small(5, 3)).word_weight(0), 1.0);
}

TEST(Training, GivesEachOfFewDescriptorsAWordOfItsOwn) {
  const Descriptors descriptors = clusters(5, 5, 32, 4);
  const Vocabulary vocabulary = train_vocabulary(descriptors.view(), {}, small(10, 6));
  EXPECT_EQ(vocabulary.words(), 5U);
  std::vector<WordId> words(5);
  vocabulary.find_words(descriptors.view(), words);
  EXPECT_EQ(std::set<WordId>(words.begin(), words.end()).size(), 5U);
}

TEST(Training, MakesOneWordOfEqualDescriptors) {
  Descriptors descriptors = clusters(3, 3, 32, 5);
  const auto three = descriptors.bytes;
  for (int copy = 0; copy < 50; ++copy)
    descriptors.bytes.insert(descriptors.bytes.end(), three.begin(), three.end());
  EXPECT_EQ(train_vocabulary(descriptors.view(), {}, small(10, 6)).words(), 3U);
}

TEST(Training, StopsSplittingSmallNodes) {
  const Descriptors descriptors = clusters(200, 1000, 32, 6);
  TrainingOptions options = small(4, 6);
  const std::size_t all = train_vocabulary(descriptors.view(), {}, options).words();
  options.min_split = 40;
  const std::size_t few = train_vocabulary(descriptors.view(), {}, options).words();
  EXPECT_LT(few * 3, all);
}

TEST(Training, TellsItsProgressAndCanBeStopped) {
  const Descriptors descriptors = clusters(100, 3000, 32, 7);
  TrainingOptions options = small(5, 4);
  std::size_t calls = 0;
  std::size_t last = 0;
  options.progress = [&](std::size_t done, std::size_t total) {
    EXPECT_GE(done, last);
    EXPECT_LE(done, total);
    EXPECT_EQ(total, 12000U);
    last = done;
    ++calls;
  };
  train_vocabulary(descriptors.view(), {}, options);
  EXPECT_GT(calls, 3U);
  options.threads = 2;
  options.progress = [](std::size_t, std::size_t) { throw std::runtime_error("enough"); };
  EXPECT_THROW(train_vocabulary(descriptors.view(), {}, options), std::runtime_error);
}

TEST(Training, RefusesWhatItCannotTrainOn) {
  const Descriptors good = clusters(5, 50, 32, 8);
  Descriptors equal;
  equal.bytes.assign(320, 1);
  Descriptors wide;
  wide.width = 257;
  wide.bytes.assign(257 * 2, 1);
  EXPECT_THROW(train_vocabulary({}, {}), InvalidArgument);
  EXPECT_THROW(train_vocabulary(equal.view(), {}), InvalidArgument);
  EXPECT_THROW(train_vocabulary(wide.view(), {}), InvalidArgument);
  for (const std::vector<std::size_t>& ends :
       {std::vector<std::size_t>{50}, {30, 20, 50}, {20, 49}, {20, 51}}) {
    EXPECT_THROW(train_vocabulary(good.view(), ends), InvalidArgument);
  }
}

TEST(TrainingOptions, AreCheckedByName) {
  const auto message = [](auto change) {
    TrainingOptions options;
    change(options);
    return error_of<InvalidArgument>([&] { options.validate(); });
  };
  EXPECT_NE(message([](auto& o) { o.k = 1; }).find("k: got 1"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.k = 256; }).find("k: got 256"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.levels = 0; }).find("levels"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.levels = 21; }).find("levels"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.weighting = static_cast<Weighting>(4); }).find("weighting"),
            std::string::npos);
  EXPECT_NE(message([](auto& o) { o.scoring = static_cast<Scoring>(6); }).find("scoring"),
            std::string::npos);
  EXPECT_NE(message([](auto& o) { o.max_rounds = 0; }).find("max_rounds"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.min_split = 1; }).find("min_split"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.threads = 0; }).find("threads"), std::string::npos);
  TrainingOptions().validate();
}

TEST(BitCounter, SetsTheBitsThatMostHave) {
  std::mt19937_64 random(9);
  for (const std::size_t words : {1U, 3U, 4U}) {
    for (const std::size_t count : {1U, 2U, 255U, 256U, 1000U}) {
      detail::BitCounter counter(words);
      detail::BitCounter other(words);
      std::vector<std::size_t> counts(words * 64, 0);
      for (std::size_t i = 0; i < count; ++i) {
        std::vector<std::uint64_t> descriptor(words);
        for (auto& word : descriptor) word = random();
        (i % 3 == 0 ? other : counter).add(descriptor.data());
        for (std::size_t b = 0; b < counts.size(); ++b)
          counts[b] += descriptor[b / 64] >> (b % 64) & 1;
      }
      counter.add(other);
      EXPECT_EQ(counter.added(), count);
      std::vector<std::uint64_t> majority(words);
      counter.majority(majority.data());
      for (std::size_t b = 0; b < counts.size(); ++b) {
        EXPECT_EQ(majority[b / 64] >> (b % 64) & 1, 2 * counts[b] >= count ? 1U : 0U);
      }
    }
  }
}

}  // namespace
}  // namespace dynslam::loop
