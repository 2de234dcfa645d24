// Files of other programs with something wrong in each of their fields.
#include <cstring>
#include <string>

#include <gtest/gtest.h>
#include <zlib.h>

#include "dynslam/loop/vocabulary_io.hpp"
#include "dynslam/loop/vocabulary_tree.hpp"

#include "loop/byte_source.hpp"
#include "vocabulary_testing.hpp"

namespace dynslam::loop {
namespace {

using testing::error_of;
using testing::random_tree;
using testing::read_file;
using testing::scratch;
using testing::write_file;
using Bytes = std::vector<std::uint8_t>;

std::string error_of_text(const std::string& text, const char* ending = ".txt") {
  const std::string path = scratch(ending);
  write_file(path, Bytes(text.begin(), text.end()));
  const std::string message = error_of<IoError>([&] { load_vocabulary(path); });
  EXPECT_EQ(message.rfind(path, 0), 0U) << message;
  return message;
}

void expect_error(const std::string& text, const std::string& message,
                  const char* ending = ".txt") {
  const std::string got = error_of_text(text, ending);
  EXPECT_NE(got.find(message), std::string::npos) << got << "; expected " << message;
}

Vocabulary vocabulary_of_text(const std::string& text, const char* ending = ".txt") {
  const std::string path = scratch(ending);
  write_file(path, Bytes(text.begin(), text.end()));
  const Vocabulary vocabulary = load_vocabulary(path);
  return vocabulary;
}

TEST(OrbVocText, MakesNoNodesOfBlankLines) {
  const std::string text = "2 1  0 0\n0 1 1 2  0.5\n\n0 1 3 4  0.25 \r\n \n\n";
  const Vocabulary vocabulary = vocabulary_of_text(text);
  EXPECT_EQ(vocabulary.nodes(), 3U);
  EXPECT_EQ(vocabulary.words(), 2U);
  EXPECT_EQ(vocabulary.descriptor_bytes(), 2);
  EXPECT_EQ(vocabulary.word_weight(1), 0.25);
}

TEST(OrbVocText, NamesTheLineAndWhatIsWrongThere) {
  const std::string head = "2 2  0 0\n";
  expect_error("21 2 0 0\n", "line 1: k is \"21\"");
  expect_error("2 11 0 0\n", "line 1: L is \"11\"");
  expect_error("2 2 6 0\n", "scoring is \"6\"");
  expect_error("2 2 0 4\n", "weighting is \"4\"");
  expect_error("2 2 0\n", "ends before weighting");
  expect_error("2 2 0 0 0\n", "more than four");
  expect_error(head, "number of nodes");
  expect_error(head + "1 1 5 5  1\n", "line 2: parent is \"1\"");
  expect_error(head + "-1 1 5 5  1\n", "parent is \"-1\"");
  expect_error(head + "0 2 5 5  1\n", "is leaf is \"2\"");
  expect_error(head + "0 1 256 5  1\n", "\"256\", expected 0 .. 255");
  expect_error(head + "0 1 5 5  nan\n", "weight is \"nan\"");
  expect_error(head + "0 1 5 5  -1\n", "weight is \"-1\"");
  expect_error(head + "0 1 5 5  1e999\n", "weight is");
  expect_error(head + "0 1 5\n", "1 numbers behind the first two");
  expect_error(head + "0 1 5 5  1\n0 1 5  1\n", "line 3: 2 numbers");
  expect_error(head + "0 1 5 5  1\n1 1 5 5  1\n", "is a word and has children");
  expect_error(head + "0 0 5 5  0\n", "is no word and has no children");
  expect_error(head + "0 1 5 x  1\n", "\"x\"");
  expect_error(head + "0 1 " + std::string(5000, '5'), "longer than");
  std::string wide = head + "0 1";
  for (int i = 0; i < 258; ++i) wide += " 1";
  expect_error(wide + "\n", "258 numbers");
  expect_error("1 3  0 0\n0 0 1  0\n1 0 1  0\n2 0 1  0\n3 1 1  1\n", "lies deeper than");
}

std::string yaml(
    const std::string& nodes, const std::string& words,
    const std::string& head = "k: 2\n   L: 1\n   scoringType: 0\n   weightingType: 0\n") {
  return "%YAML:1.0\n---\nvocabulary:\n   " + head + "   nodes:\n" + nodes + "   words:\n" + words;
}
const char kNodes[] =
    "      - { nodeId:1, parentId:0, weight:0.5,\n          descriptor:\"7 8 \" }\n"
    "      - { nodeId:2, parentId:0, weight:1., descriptor:\"9 200\" }\n";
const char kTwoWords[] = "      - { wordId:0, nodeId:1 }\n      - { wordId:1, nodeId:2 }\n";

TEST(DbowYaml, ReadsTheThreeWaysToWriteADescriptor) {
  EXPECT_EQ(vocabulary_of_text(yaml(kNodes, kTwoWords), ".yml").descriptor_bytes(), 2);
  const std::string counted =
      "      - { nodeId:1, parentId:0, weight:0.5, descriptor:\"0 2 7 8\" }\n"
      "      - { nodeId:2, parentId:0, weight:1., descriptor:\"0 2 9 200\" }\n";
  EXPECT_EQ(vocabulary_of_text(yaml(counted, kTwoWords), ".yml").descriptor_bytes(), 2);
  const std::string marked =
      "      - { nodeId:1, parentId:0, weight:0.5, descriptor:dbw3 0 2 7 8  }\n"
      "      - { nodeId:2, parentId:0, weight:1., descriptor:\"dbw3 0 2 9 200\" }\n";
  EXPECT_EQ(vocabulary_of_text(yaml(marked, kTwoWords), ".yml").descriptor_bytes(), 2);
  // Bytes that look like a count, in one of two descriptors.
  const std::string like =
      "      - { nodeId:1, parentId:0, weight:0.5, descriptor:\"0 2 7 8\" }\n"
      "      - { nodeId:2, parentId:0, weight:1., descriptor:\"1 2 9 200\" }\n";
  EXPECT_EQ(vocabulary_of_text(yaml(like, kTwoWords), ".yml").descriptor_bytes(), 4);
}

TEST(DbowYaml, NamesTheLineAndWhatIsWrongThere) {
  const auto node = [](const std::string& text) { return "      - { " + text + " }\n"; };
  const std::string good = node("nodeId:1, parentId:0, weight:0.5, descriptor:\"7 8\"");
  const auto with_node = [&](const std::string& text, const std::string& message) {
    expect_error(yaml(good + node(text), kTwoWords), message, ".yml");
  };
  with_node("nodeId:0, parentId:0, weight:1., descriptor:\"7 8\"", "nodeId is \"0\"");
  with_node("nodeId:1, parentId:0, weight:1., descriptor:\"7 8\"", "node 1 a second time");
  with_node("nodeId:7, parentId:0, weight:1., descriptor:\"7 8\"", "node 7 of 3");
  with_node("nodeId:2, parentId:7, weight:1., descriptor:\"7 8\"", "parent 7 of 3");
  with_node("nodeId:2, parentId:2, weight:1., descriptor:\"7 8\"", "not connected");
  with_node("nodeId:2, parentId:0, weight:.nan, descriptor:\"7 8\"", "weight is");
  with_node("nodeId:2, parentId:0, weight:-1., descriptor:\"7 8\"", "weight is");
  with_node("nodeId:2, parentId:0, weight:1., descriptor:\"7\"", "a descriptor of 1 bytes");
  with_node("nodeId:2, parentId:0, weight:1., descriptor:\"7 256\"", "0 .. 255");
  with_node("nodeId:2, parentId:0, weight:1., descriptor:\"dbw3 5 2 7 8\"", "not binary");
  with_node("nodeId:2, parentId:0, weight:1., descriptor:\"\"", "a descriptor of 0 bytes");
  with_node("nodeId:2, parentId:0, descriptor:\"7 8\"", "without nodeId");
  with_node("nodeId:2, parentId:0, weight:1., colour:3", "unknown key \"colour\"");
  expect_error(yaml(kNodes, "      - { wordId:0, nodeId:9 }\n"), "node 9 of 3", ".yml");
  expect_error(yaml(kNodes, "      - { wordId:0 }\n"), "without wordId or nodeId", ".yml");
  expect_error(yaml(kNodes, std::string(kTwoWords) + "      - { wordId:2, nodeId:2 }\n"),
               "node 2 is word 1 and word 2", ".yml");
  expect_error(yaml(kNodes, ""), "is no word and has no children", ".yml");
  expect_error(yaml(kNodes, kTwoWords, "k: 2\n   L: 1\n   scoringType: 0\n"), "weightingType",
               ".yml");
  expect_error(yaml(kNodes, kTwoWords, "k: 2\n   k: 2\n"), "a second time", ".yml");
  expect_error(yaml(kNodes, kTwoWords, "k: 99999999\n"), "k is", ".yml");
  expect_error(yaml(kNodes, kTwoWords, "depth: 3\n"), "unknown key \"depth\"", ".yml");
  expect_error("%YAML:1.0\n---\nbook: 3\n", "expected \"vocabulary\"", ".yml");
  expect_error("%YAML:1.0\n---\nvocabulary:\n   words:\n", "words before nodes", ".yml");
  expect_error(
      "%YAML:1.0\n---\nvocabulary:\n   k: 2\n   nodes:\n      - { nodeId:1, descriptor:\"" +
          std::string(9999, '7'),
      "characters", ".yml");
}

TEST(GzipBombs, StopBeforeTheyAreUnpacked) {
  const std::string path = scratch(".yml.gz");
  const auto gzip = gzopen(path.c_str(), "wb9");
  const std::string head = "%YAML:1.0\n---\nvocabulary:\n";
  gzwrite(gzip, head.data(), static_cast<unsigned>(head.size()));
  const std::string blanks(1U << 20, ' ');
  for (int mb = 0; mb < 64; ++mb)
    gzwrite(gzip, blanks.data(), static_cast<unsigned>(blanks.size()));
  gzclose(gzip);
  const std::string message = error_of<IoError>([&] { load_vocabulary(path); });
  EXPECT_NE(message.find("which no vocabulary does"), std::string::npos) << message;
}

/// A file and a place in it that takes another number.
class BinaryFile {
 public:
  BinaryFile(VocabularyFormat format, const char* ending) : path_(scratch(ending)) {
    save_vocabulary(make_vocabulary(random_tree(2, 2, 4, 3)), path_, format);
    good_ = read_file(path_);
  }

  template <typename T>
  void expect(std::size_t at, T value, const std::string& message) {
    Bytes bytes = good_;
    std::memcpy(bytes.data() + at, &value, sizeof(value));
    write_file(path_, bytes);
    const std::string got = error_of<IoError>([&] { load_vocabulary(path_); });
    EXPECT_NE(got.find(message), std::string::npos) << got << "; expected " << message;
  }

 private:
  std::string path_;
  Bytes good_;
};

TEST(Dbow3Binary, NamesTheByteAndWhatIsWrongThere) {
  BinaryFile file(VocabularyFormat::kDbow3, ".dbow3");
  constexpr std::size_t kNode = 29;  // the first record
  file.expect(8, std::uint8_t{2}, "flag of compression is 2");
  file.expect(9, std::uint32_t{1}, "1 nodes");
  file.expect(9, std::uint32_t{0xFFFFFFFF}, "4294967295 nodes");
  file.expect(9, std::uint32_t{1000000}, "the file ends before");
  file.expect(13, std::int32_t{0}, "k is 0");
  file.expect(13, std::int32_t{-5}, "k is -5");
  file.expect(17, std::int32_t{0}, "L is 0");
  file.expect(21, std::int32_t{6}, "scoring is 6");
  file.expect(25, std::int32_t{4}, "weighting is 4");
  file.expect(kNode, std::uint32_t{77}, "node 77 of");
  file.expect(kNode, std::uint32_t{2}, "node 2 a second time");
  file.expect(kNode + 4, std::uint32_t{77}, "parent 77 of");
  file.expect(kNode + 8, std::numeric_limits<double>::quiet_NaN(), "weight nan");
  file.expect(kNode + 16, std::int32_t{0x7FFFFFFF}, "columns of a descriptor is 2147483647");
  file.expect(kNode + 20, std::int32_t{2}, "rows of a descriptor is 2");
  file.expect(kNode + 24, std::int32_t{5}, "type of a descriptor");
}

TEST(Dbow3Packed, NamesADamagedPacket) {
  BinaryFile file(VocabularyFormat::kDbow3Compressed, ".dbow3");
  file.expect(17, std::uint8_t{0x00}, "no header of a QuickLZ packet");
  file.expect(18, std::uint32_t{0xFFFFFFF0}, "a QuickLZ packet of 4294967280 bytes");
  file.expect(22, std::uint32_t{0xFFFFFFF0}, "a QuickLZ packet of");
  file.expect(22, std::uint32_t{50}, "a damaged QuickLZ packet");
  file.expect(13, std::uint32_t{0}, "the file ends within");
}

TEST(FbowFile, NamesTheByteAndWhatIsWrongThere) {
  BinaryFile file(VocabularyFormat::kFbow, ".fbow");
  constexpr std::size_t kParameters = 8;
  constexpr std::size_t kBlocks = 128;
  file.expect(kParameters + 56, std::uint32_t{0}, "number of blocks is 0");
  file.expect(kParameters + 56, std::uint32_t{0x3FFFFFFF}, "size of all blocks");
  file.expect(kParameters + 64, std::uint64_t{1}, "size of a descriptor with padding");
  file.expect(kParameters + 64, ~std::uint64_t{0}, "size of a descriptor with padding");
  file.expect(kParameters + 72, std::uint64_t{8}, "size of a block");
  file.expect(kParameters + 72, ~std::uint64_t{0}, "size of a block");
  file.expect(kParameters + 80, std::uint64_t{0}, "offset of the descriptors");
  file.expect(kParameters + 88, std::uint64_t{8}, "offset of the children");
  file.expect(kParameters + 96, std::uint64_t{1}, "size of all blocks");
  file.expect(kParameters + 104, std::int32_t{5}, "type of the descriptors");
  file.expect(kParameters + 108, std::int32_t{-1}, "size of a descriptor");
  file.expect(kParameters + 112, std::uint32_t{0}, "k is 0");
  file.expect(kParameters + 112, std::uint32_t{65535}, "offset of the children");
  file.expect(kBlocks, std::uint16_t{0}, "block 0: 0 children");
  file.expect(kBlocks, std::uint16_t{3}, "block 0: 3 children");
  const std::size_t child = kBlocks + 8 + 2 * 8;
  file.expect(child, std::uint32_t{0}, "child 0 has block 0");
  file.expect(child, std::uint32_t{77}, "child 0 has block 77");
  constexpr std::size_t kBlockBytes = 8 + 2 * 8 + 2 * 8;
  file.expect(child + kBlockBytes, std::uint32_t{0xFFFFFFF0}, "word 2147483632 in a tree");
}

}  // namespace
}  // namespace dynslam::loop
