// Files that DBoW2, DBoW3 and FBoW wrote, and the vectors that those programs compute with them
// (data/make_golden.sh): the same here, bit for bit.
#include <cstdlib>
#include <sstream>
#include <string>

#include <gtest/gtest.h>

#include "dynslam/loop/vocabulary_io.hpp"

#include "data/golden_features.hpp"
#include "loop/byte_source.hpp"
#include "vocabulary_testing.hpp"

namespace dynslam::loop {
namespace {

const std::string kData = DYNSLAM_TEST_DATA_DIR "/";

std::istringstream open_text(const std::string& name) {
  detail::FileSource source(kData + name, detail::FileSource::Unpack::kGzip);
  std::string text(1U << 20, '\0');
  text.resize(source.read(reinterpret_cast<std::uint8_t*>(text.data()), text.size()));
  EXPECT_GT(text.size(), 1000U);
  return std::istringstream(text);
}

std::string word_of(std::istream& in) {
  std::string text;
  in >> text;
  return text;
}
double number_of(std::istream& in) { return std::strtod(word_of(in).c_str(), nullptr); }

BowVector read_bow(std::istream& in) {
  EXPECT_EQ(word_of(in), "bow");
  std::size_t size = 0;
  in >> size;
  BowVector bow;
  for (std::size_t i = 0; i < size; ++i) {
    WordId word = 0;
    in >> word;
    bow.push_back(word, number_of(in));
  }
  return bow;
}

FeatureVector read_direct(std::istream& in) {
  EXPECT_EQ(word_of(in), "direct");
  std::size_t size = 0;
  in >> size;
  std::vector<NodeId> nodes;
  std::vector<std::uint32_t> rows;
  for (std::size_t i = 0; i < size; ++i) {
    NodeId node = 0;
    std::size_t features = 0;
    in >> node >> features;
    for (std::size_t f = 0; f < features; ++f) {
      nodes.push_back(node);
      rows.emplace_back();
      in >> rows.back();
    }
  }
  FeatureVector direct;
  direct.assign(nodes, rows);
  return direct;
}

testing::Descriptors image(std::size_t i) { return {golden::image(i), golden::kDescriptorBytes}; }

void expect_golden(const Vocabulary& loaded, const std::string& vectors, std::size_t rules) {
  std::istringstream in = open_text(vectors);
  const auto first = image(golden::kTrainingImages);
  const auto second = image(golden::kTrainingImages + 1);
  for (std::size_t rule = 0; rule < rules; ++rule) {
    ASSERT_EQ(word_of(in), "rules");
    int weighting = 0;
    int scoring = 0;
    in >> weighting >> scoring;
    const Vocabulary vocabulary =
        loaded.with(static_cast<Weighting>(weighting), static_cast<Scoring>(scoring));
    BowVector a;
    BowVector b;
    FeatureVector direct_a;
    FeatureVector direct_b;
    vocabulary.transform({first.view()}, 1, a, direct_a);
    vocabulary.transform({second.view()}, 2, b, direct_b);
    EXPECT_EQ(a, read_bow(in)) << weighting << ' ' << scoring;
    EXPECT_EQ(direct_a, read_direct(in));
    EXPECT_EQ(b, read_bow(in));
    EXPECT_EQ(direct_b, read_direct(in));
    ASSERT_EQ(word_of(in), "score");
    EXPECT_EQ(vocabulary.score(a, b), number_of(in)) << weighting << ' ' << scoring;
    EXPECT_EQ(vocabulary.score(b, a), number_of(in));
  }
}

TEST(Golden, VectorsAndScoresOfDBoW2AreOursForAllOfItsRules) {
  expect_golden(load_vocabulary(kData + "dbow2.yml.gz"), "dbow2_vectors.txt.gz", 24);
}

TEST(Golden, VectorsOfDBoW3AreOursFromAllOfItsFormats) {
  for (const char* name : {"dbow3.yml.gz", "dbow3.dbow3", "dbow3_packed.dbow3"}) {
    expect_golden(load_vocabulary(kData + name), "dbow3_vectors.txt.gz", 1);
  }
}

TEST(Golden, VectorsOfFBoWAreOurs) {
  const Vocabulary vocabulary = load_vocabulary(kData + "fbow.fbow");
  EXPECT_TRUE(vocabulary.single_precision());
  EXPECT_EQ(vocabulary.scoring(), Scoring::kL2);
  std::istringstream in = open_text("fbow_vectors.txt");
  for (const std::size_t i : {golden::kTrainingImages, golden::kTrainingImages + 1}) {
    EXPECT_EQ(vocabulary.transform({image(i).view()}), read_bow(in));
  }
}

}  // namespace
}  // namespace dynslam::loop
