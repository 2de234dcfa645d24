#include "dynslam/loop/vocabulary_io.hpp"

#include <cstring>
#include <functional>
#include <limits>
#include <numeric>

#include <gtest/gtest.h>
#include <zlib.h>

#include "dynslam/loop/vocabulary_training.hpp"
#include "dynslam/loop/vocabulary_tree.hpp"

#include "loop/formats.hpp"
#include "loop/vocabulary_block.hpp"
#include "vocabulary_testing.hpp"

namespace dynslam::loop {
namespace {

using testing::error_of;
using testing::load_bytes;
using testing::near_nodes;
using testing::random_tree;
using testing::read_file;
using testing::scratch;
using testing::write_file;
using Bytes = std::vector<std::uint8_t>;

struct Format {
  VocabularyFormat format;
  const char* ending;
};
constexpr Format kFormats[] = {
    {VocabularyFormat::kDynvoc, ".dynvoc"}, {VocabularyFormat::kText, ".txt"},
    {VocabularyFormat::kYaml, ".yml"},      {VocabularyFormat::kYamlGz, ".yml.gz"},
    {VocabularyFormat::kDbow3, ".dbow3"},   {VocabularyFormat::kDbow3Compressed, "z.dbow3"},
    {VocabularyFormat::kFbow, ".fbow"},
};

class EveryFormat : public ::testing::TestWithParam<Format> {
 protected:
  /// Same vectors, same direct index, same rules.
  void expect_round_trip(const VocabularyTree& tree, bool same_nodes = true) {
    const Vocabulary before = make_vocabulary(tree);
    const std::string path = scratch(GetParam().ending);
    save_vocabulary(before, path, GetParam().format);
    const Vocabulary after = load_vocabulary(path);
    EXPECT_EQ(after.k(), before.k());
    EXPECT_EQ(after.levels(), before.levels());
    EXPECT_EQ(after.words(), before.words());
    EXPECT_EQ(after.nodes(), before.nodes());
    EXPECT_EQ(after.weighting(), before.weighting());
    EXPECT_EQ(after.scoring(), before.scoring());
    const auto descriptors = near_nodes(tree, 120, 77);
    BowVector bow_before;
    BowVector bow_after;
    FeatureVector direct_before;
    FeatureVector direct_after;
    before.transform({descriptors.view()}, 1, bow_before, direct_before);
    after.transform({descriptors.view()}, 1, bow_after, direct_after);
    EXPECT_EQ(bow_before, bow_after);
    if (same_nodes) {
      EXPECT_EQ(direct_before, direct_after);
    }
  }
};

TEST_P(EveryFormat, GivesTheSameResultsBitForBit) {
  for (const int bytes : {32, 48, 61, 64, 5}) {
    VocabularyTree tree = random_tree(6, 3, bytes, 40);
    tree.scoring = Scoring::kChiSquare;
    tree.weighting = Weighting::kIdf;
    expect_round_trip(tree);
  }
}

TEST_P(EveryFormat, KeepsWeightsThatAreNoFloats) {
  VocabularyTree tree = random_tree(6, 3, 32, 41);
  for (std::size_t row = 0; row < tree.nodes(); ++row)
    tree.weights[row] = tree.weights[row] * (1.0 / 3.0) + 1e-9 * static_cast<double>(row);
  expect_round_trip(tree);
}

TEST_P(EveryFormat, KeepsTheNumbersOfNodes) {
  if (GetParam().format == VocabularyFormat::kFbow) return;  // it has none
  VocabularyTree tree = random_tree(3, 3, 16, 42);
  tree.ids.resize(tree.nodes());
  std::iota(tree.ids.begin(), tree.ids.end(), 0U);
  std::reverse(tree.ids.begin() + 1, tree.ids.end());
  // Lines number the nodes of ORBvoc.txt, and words have to ascend there.
  expect_round_trip(tree, GetParam().format != VocabularyFormat::kText);
}

TEST_P(EveryFormat, HoldsWhatTrainingMade) {
  const VocabularyTree from = random_tree(6, 4, 32, 43);
  const auto descriptors = near_nodes(from, 3000, 44);
  std::vector<std::size_t> ends;
  for (std::size_t end = 100; end <= 3000; end += 100) ends.push_back(end);
  TrainingOptions options;
  options.k = 8;
  options.levels = 3;
  expect_round_trip(tree_of(train_vocabulary(descriptors.view(), ends, options)));
}

TEST_P(EveryFormat, CutAnywhereIsAnError) {
  const std::string path = scratch(GetParam().ending);
  save_vocabulary(make_vocabulary(random_tree(2, 2, 4, 45)), path, GetParam().format);
  const Bytes whole = read_file(path);
  const bool text =
      GetParam().format == VocabularyFormat::kText || GetParam().format == VocabularyFormat::kYaml;
  for (std::size_t size = 0; size < whole.size(); ++size) {
    const Bytes cut(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size));
    if (text) {
      // Text cut at the end of a number or a line may say something else that is complete.
      try {
        load_bytes(GetParam().format, cut, path);
      } catch (const IoError&) {
      }
    } else {
      EXPECT_THROW(load_bytes(GetParam().format, cut, path), IoError) << size;
    }
  }
}

TEST_P(EveryFormat, FlippedBitsNeverLeadOutOfTheTree) {
  const std::string path = scratch(GetParam().ending);
  const VocabularyTree tree = random_tree(2, 2, 4, 46);
  save_vocabulary(make_vocabulary(tree), path, GetParam().format);
  const Bytes whole = read_file(path);
  const auto descriptors = near_nodes(tree, 8, 1);
  const std::size_t step = GetParam().format == VocabularyFormat::kYamlGz ? 11 : 3;
  std::size_t refused = 0;
  for (std::size_t bit = 0; bit < whole.size() * 8; bit += step) {
    Bytes flipped = whole;
    flipped[bit / 8] ^= static_cast<std::uint8_t>(1U << (bit % 8));
    try {
      const Vocabulary vocabulary = load_bytes(GetParam().format, flipped, path);
      if (vocabulary.descriptor_bytes() == 4) vocabulary.transform({descriptors.view()});
    } catch (const IoError& error) {
      EXPECT_NE(std::string(error.what()).find(path), std::string::npos);
      ++refused;
    }
  }
  EXPECT_GT(refused, 0U);
  if (GetParam().format == VocabularyFormat::kDynvoc) {
    EXPECT_EQ(refused, (whole.size() * 8 + step - 1) / step);  // checksums see every bit
  }
}

TEST_P(EveryFormat, WithSomethingBehindItIsAnError) {
  if (GetParam().format == VocabularyFormat::kYamlGz) return;  // gzip files may be joined
  const std::string path = scratch(GetParam().ending);
  save_vocabulary(make_vocabulary(random_tree(2, 2, 4, 45)), path, GetParam().format);
  Bytes longer = read_file(path);
  for (const char c : {'x', '1', '\n'}) longer.push_back(static_cast<std::uint8_t>(c));
  write_file(path, longer);
  EXPECT_THROW(load_vocabulary(path), IoError);
}

INSTANTIATE_TEST_SUITE_P(VocabularyIo, EveryFormat, ::testing::ValuesIn(kFormats));

TEST(VocabularyIo, TellsFormatsByTheirNames) {
  EXPECT_EQ(format_of_name("a/b.dynvoc"), VocabularyFormat::kDynvoc);
  EXPECT_EQ(format_of_name("ORBvoc.TXT"), VocabularyFormat::kText);
  EXPECT_EQ(format_of_name("v.yaml"), VocabularyFormat::kYaml);
  EXPECT_EQ(format_of_name("v.yml.gz"), VocabularyFormat::kYamlGz);
  EXPECT_EQ(format_of_name("v.dbow3"), VocabularyFormat::kDbow3);
  EXPECT_EQ(format_of_name("v.fbow"), VocabularyFormat::kFbow);
  EXPECT_THROW(format_of_name("v.bin"), InvalidArgument);
  EXPECT_THROW(format_of_name(".txt"), InvalidArgument);
}

TEST(VocabularyIo, NamesAFileThatCannotBeRead) {
  for (const auto& read : {open_vocabulary, load_vocabulary}) {
    EXPECT_NE(error_of<IoError>([&] { read("no/such/file"); }).find("no/such/file"),
              std::string::npos);
    EXPECT_THROW(read("."), IoError);
    write_file(scratch(".x"), {});
    EXPECT_NE(error_of<IoError>([&] { read(scratch(".x")); }).find("is empty"), std::string::npos);
    write_file(scratch(".x"), Bytes(3000, 0xEE));
    EXPECT_THROW(read(scratch(".x")), IoError);
  }
}

TEST(VocabularyIo, LeavesNothingBehindWhenItCannotWrite) {
  const Vocabulary vocabulary = make_vocabulary(random_tree(2, 2, 4, 45));
  EXPECT_THROW(save_vocabulary(vocabulary, "no/such/folder/v.dynvoc"), IoError);
  EXPECT_THROW(save_vocabulary(Vocabulary(), scratch(".dynvoc")), InvalidArgument);
  VocabularyTree gaps = random_tree(3, 1, 8, 6);
  gaps.words = {kNoWord, 7, 3, 1};
  const dynslam::testing::TempFolder folder;
  for (const char* ending : {"v.txt", "v.yml", "v.dbow3"}) {
    EXPECT_NE(error_of<InvalidArgument>([&] {
                save_vocabulary(make_vocabulary(gaps), folder.file(ending));
              }).find("renumber_words"),
              std::string::npos);
  }
  VocabularyTree wide = random_tree(21, 1, 8, 6);
  EXPECT_THROW(save_vocabulary(make_vocabulary(wide), folder.file("v.txt")), InvalidArgument);
  EXPECT_EQ(folder.entries(), 0U);
}

TEST(VocabularyIo, MappedFilesMayBeReplacedWhileInUse) {
  const std::string path = scratch(".dynvoc");
  const VocabularyTree tree = random_tree(5, 3, 32, 50);
  save_vocabulary(make_vocabulary(tree), path);
  const Vocabulary mapped = open_vocabulary(path);
  const auto descriptors = near_nodes(tree, 50, 51);
  const BowVector before = mapped.transform({descriptors.view()});
  save_vocabulary(make_vocabulary(random_tree(3, 2, 32, 52)), path);
  EXPECT_EQ(mapped.transform({descriptors.view()}), before);
  save_vocabulary(mapped.with(Weighting::kTf, Scoring::kL2), path);
  EXPECT_EQ(open_vocabulary(path).scoring(), Scoring::kL2);
  EXPECT_EQ(open_vocabulary(path).weighting(), Weighting::kTf);
}

// --- our own format, field by field, with sums that match ---------------------------------------

Bytes sealed(Bytes bytes) {
  detail::BlockHeader header;
  std::memcpy(&header, bytes.data(), sizeof(header));
  detail::seal(header, {bytes.data() + sizeof(header), bytes.size() - sizeof(header)});
  std::memcpy(bytes.data(), &header, sizeof(header));
  return bytes;
}

TEST(Dynvoc, NamesEveryFieldThatIsWrong) {
  const std::string path = scratch(".dynvoc");
  VocabularyTree tree = random_tree(3, 2, 8, 60);
  tree.ids.resize(tree.nodes());
  std::iota(tree.ids.begin(), tree.ids.end(), 0U);
  std::reverse(tree.ids.begin() + 1, tree.ids.end());
  save_vocabulary(make_vocabulary(tree), path);
  const Bytes good = read_file(path);
  detail::BlockHeader header;
  std::memcpy(&header, good.data(), sizeof(header));
  const auto expect = [&](const char* message, const Bytes& bytes, bool seal = true) {
    write_file(path, seal ? sealed(bytes) : bytes);
    const std::string got = error_of<IoError>([&] { open_vocabulary(path); });
    EXPECT_NE(got.find(message), std::string::npos) << got << "; expected " << message;
  };
  const auto with_header = [&](auto change) {
    Bytes bytes = good;
    detail::BlockHeader changed = header;
    change(changed);
    std::memcpy(bytes.data(), &changed, sizeof(changed));
    return bytes;
  };
  expect("is not a dynslam vocabulary", with_header([](auto& h) { h.magic[0] = 'x'; }));
  expect("other byte order", with_header([](auto& h) { h.byte_order = 0x04030201U; }));
  expect("version", with_header([](auto& h) { h.version = 9; }));
  expect("checksum of the header", with_header([](auto& h) { h.k = 4; }), false);
  expect("k is 0", with_header([](auto& h) { h.k = 0; }));
  expect("levels is 0", with_header([](auto& h) { h.levels = 0; }));
  expect("levels is 300", with_header([](auto& h) { h.levels = 300; }));
  expect("depth of the tree", with_header([](auto& h) { h.levels = 1; }));
  expect("descriptor_bytes is 300", with_header([](auto& h) { h.descriptor_bytes = 300; }));
  expect("nodes is 1,", with_header([](auto& h) { h.nodes = 1; }));
  expect("parents is 0", with_header([](auto& h) { h.parents = 0; }));
  expect("words is 0", with_header([](auto& h) { h.words = 0; }));
  expect("weighting is 4", with_header([](auto& h) { h.weighting = 4; }));
  expect("scoring is 6", with_header([](auto& h) { h.scoring = 6; }));
  expect("single_precision is 2", with_header([](auto& h) { h.single_precision = 2; }));
  expect("tree_bytes", with_header([](auto& h) { h.tree_bytes = ~std::uint64_t{0}; }));
  expect("tree_offset", with_header([](auto& h) { h.tree_offset += 64; }));
  expect("weights_offset", with_header([](auto& h) { h.weights_offset += 64; }));
  expect("ids_offset", with_header([](auto& h) { h.ids_offset += 64; }));
  expect("file_bytes", with_header([](auto& h) { h.file_bytes += 64; }));
  Bytes cut = good;
  cut.resize(cut.size() - 64);
  expect("size of the file", cut);

  const auto with_word = [&](std::size_t at, std::uint32_t value) {
    Bytes bytes = good;
    std::memcpy(bytes.data() + at, &value, sizeof(value));
    return bytes;
  };
  const std::size_t root = header.tree_offset;
  expect("checksum of the content", with_word(root, 1), false);
  expect("has 0 children", with_word(root, 0));
  expect("has 4 children", with_word(root, 4));
  expect("number of the first child is 2", with_word(root + 4, 2));
  expect("expected a later block", with_word(root + 8, 0));
  expect("expected a later block", with_word(root + 8, 0x7FFFFFFF));
  expect("word 5000 of", with_word(root + 8, 0x80000000U + 5000));
  std::uint32_t second = 0;
  std::memcpy(&second, good.data() + root + 12, sizeof(second));
  expect("another link leads to", with_word(root + 8, second));
  expect("no link leads here", with_word(root + 8, 0x80000000U));

  for (const double weight :
       {std::numeric_limits<double>::quiet_NaN(), -std::numeric_limits<double>::quiet_NaN(), -1.0,
        std::numeric_limits<double>::infinity()}) {
    Bytes bytes = good;
    std::memcpy(bytes.data() + header.weights_offset + 8, &weight, sizeof(weight));
    expect("weight of word 1", bytes);
  }
  expect("id of the root", with_word(header.ids_offset, 1));
  expect("id of node 2", with_word(header.ids_offset + 8, 5000));
  std::uint32_t first = 0;
  std::memcpy(&first, good.data() + header.ids_offset + 4, sizeof(first));
  expect("id of node 2", with_word(header.ids_offset + 8, first));
}

}  // namespace
}  // namespace dynslam::loop
