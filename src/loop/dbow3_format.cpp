// DBoW3's binary files, little endian: u64 magic, u8 packed, u32 nodes with the root; if packed a
// u32 number of chunks, 10000 bytes each, in QuickLZ packets. Content: i32 k, L, scoring,
// weighting; a record a node: u32 node, u32 parent, f64 weight, i32 columns, i32 rows, i32 type of
// OpenCV, the bytes; u32 words and as many pairs u32 word, u32 node.
#include <algorithm>
#include <string>

#include "dynslam/core/errors.hpp"

#include "loop/formats.hpp"
#include "loop/quicklz.hpp"
#include "loop/tree_problem.hpp"

namespace dynslam::loop::detail {
namespace {

constexpr std::size_t kChunk = 10000;
constexpr std::size_t kMaxChunk = 1U << 20;
constexpr std::int32_t kBytes8U = 0;  // CV_8U

/// The content of the chunks, one after the other.
class ChunkSource : public ByteSource {
 public:
  ChunkSource(ByteSource& packed, std::uint32_t chunks)
      : ByteSource(packed.path()), packed_(packed), left_(chunks) {}

  std::size_t read(std::uint8_t* to, std::size_t size) override {
    std::size_t got = 0;
    while (got < size) {
      if (at_ == chunk_.size()) {
        if (left_ == 0) break;
        --left_;
        next_chunk();
      }
      const std::size_t piece = std::min(size - got, chunk_.size() - at_);
      std::copy_n(chunk_.begin() + static_cast<std::ptrdiff_t>(at_), piece, to + got);
      got += piece;
      at_ += piece;
    }
    position += got;
    return got;
  }

 private:
  void next_chunk() {
    chunk_.clear();
    at_ = 0;
    packet_.resize(kLongQuickLzHeader);
    packed_.read_exactly(packet_.data(), packet_.size(), "the header of a QuickLZ packet");
    const auto header = read_quicklz_header(packet_);
    if (!header) packed_.fail("no header of a QuickLZ packet of level 1");
    if (header->unpacked_bytes > kMaxChunk || header->packet_bytes > 2 * kMaxChunk ||
        header->packet_bytes < kLongQuickLzHeader) {
      packed_.fail("a QuickLZ packet of " + std::to_string(header->packet_bytes) + " bytes for " +
                   std::to_string(header->unpacked_bytes) + ", expected at most " +
                   std::to_string(kMaxChunk));
    }
    packet_.resize(header->packet_bytes);
    packed_.read_exactly(packet_.data() + kLongQuickLzHeader, packet_.size() - kLongQuickLzHeader,
                         "a QuickLZ packet");
    if (!unpack_quicklz(packet_, chunk_)) packed_.fail("a damaged QuickLZ packet");
    if (chunk_.empty()) packed_.fail("an empty QuickLZ packet");
  }

  ByteSource& packed_;
  std::uint32_t left_;
  std::vector<std::uint8_t> packet_;
  std::vector<std::uint8_t> chunk_;
  std::size_t at_ = 0;
};

int number_within(ByteSource& source, const char* what, int low, int high) {
  const auto value = source.number<std::int32_t>(what);
  if (value < low || value > high) {
    source.fail(std::string(what) + " is " + std::to_string(value) + ", expected " +
                std::to_string(low) + " .. " + std::to_string(high));
  }
  return value;
}

VocabularyTree read_content(ByteSource& source, std::uint32_t nodes) {
  const int k = number_within(source, "k", 1, kMaxChildren);
  const int levels = number_within(source, "L", 1, kMaxLevels);
  const int scoring = number_within(source, "scoring", 0, 5);
  const int weighting = number_within(source, "weighting", 0, 3);
  std::optional<NodeTable> table;
  for (std::uint32_t i = 1; i < nodes; ++i) {
    const auto id = source.number<std::uint32_t>("the number of a node");
    const auto parent = source.number<std::uint32_t>("the parent of a node");
    const auto weight = source.number<double>("the weight of a node");
    const int bytes = number_within(source, "columns of a descriptor", 1, kMaxDescriptorBytes);
    number_within(source, "rows of a descriptor", 1, 1);
    number_within(source, "type of a descriptor (0 is binary)", kBytes8U, kBytes8U);
    if (!table) {
      const std::uint64_t record = 28 + static_cast<std::uint64_t>(bytes);
      if ((nodes - 1) * record - 28 > source.left())
        source.fail(std::to_string(nodes) + " nodes, the file ends before");
      table.emplace(source, bytes);
      if (source.left() != ~std::uint64_t{0}) table->reserve(nodes);
    }
    if (bytes != table->tree.descriptor_bytes) {
      source.fail("a descriptor of " + std::to_string(bytes) + " bytes among those of " +
                  std::to_string(table->tree.descriptor_bytes));
    }
    std::uint8_t* descriptor = table->add(id, parent, weight);
    source.read_exactly(descriptor, static_cast<std::size_t>(bytes), "a descriptor");
  }
  const auto words = source.number<std::uint32_t>("the number of words");
  if (words >= nodes) {
    source.fail(std::to_string(words) + " words in a tree of " + std::to_string(nodes) + " nodes");
  }
  for (std::uint32_t i = 0; i < words; ++i) {
    const auto word = source.number<std::uint32_t>("the number of a word");
    if (word >= words) {
      source.fail("word " + std::to_string(word) + " of " + std::to_string(words));
    }
    table->add_word(word, source.number<std::uint32_t>("the node of a word"));
  }
  std::uint8_t more = 0;
  if (source.read(&more, 1) != 0) source.fail("more bytes behind the last word");
  VocabularyTree tree = table->finish();
  tree.k = k;
  tree.levels = levels;
  tree.scoring = static_cast<Scoring>(scoring);
  tree.weighting = static_cast<Weighting>(weighting);
  return tree;
}

/// Collects content and hands it on, in packets if asked for.
class ContentSink {
 public:
  ContentSink(FileSink& sink, bool compressed) : sink_(sink), compressed_(compressed) {}

  void write(const void* bytes, std::size_t size) {
    const auto* at = static_cast<const std::uint8_t*>(bytes);
    waiting_.insert(waiting_.end(), at, at + size);
    while (waiting_.size() >= kChunk) flush(kChunk);
  }
  template <typename T>
  void number(T value) {
    write(&value, sizeof(value));
  }
  void finish() {
    if (!waiting_.empty()) flush(waiting_.size());
  }

 private:
  void flush(std::size_t size) {
    if (compressed_) {
      packet_.clear();
      pack_quicklz(Span<const std::uint8_t>(waiting_.data(), size), packet_);
      sink_.write(packet_.data(), packet_.size());
    } else {
      sink_.write(waiting_.data(), size);
    }
    waiting_.erase(waiting_.begin(), waiting_.begin() + static_cast<std::ptrdiff_t>(size));
  }

  FileSink& sink_;
  bool compressed_;
  std::vector<std::uint8_t> waiting_;
  std::vector<std::uint8_t> packet_;
};

}  // namespace

VocabularyTree read_dbow3(ByteSource& source) {
  if (source.number<std::uint64_t>("the magic number") != kDbow3Magic)
    source.fail("another magic number than that of DBoW3");
  const auto packed = source.number<std::uint8_t>("the flag of compression");
  if (packed > 1)
    source.fail("the flag of compression is " + std::to_string(packed) + ", expected 0 or 1");
  const auto nodes = source.number<std::uint32_t>("the number of nodes");
  if (nodes < 2 || nodes > kMaxNodes)
    source.fail(std::to_string(nodes) + " nodes, expected 2 .. " + std::to_string(kMaxNodes));
  if (packed == 0) return read_content(source, nodes);
  ChunkSource chunks(source, source.number<std::uint32_t>("the number of chunks"));
  VocabularyTree tree = read_content(chunks, nodes);
  std::uint8_t more = 0;
  if (source.read(&more, 1) != 0) source.fail("more bytes behind the last chunk");
  return tree;
}

void write_dbow3(const VocabularyTree& tree, bool compressed, FileSink& sink) {
  const std::vector<std::uint32_t> row_of_word = rows_of_words(tree, "DBoW3");
  const auto id = [&tree](std::uint32_t row) { return tree.ids.empty() ? row : tree.ids[row]; };
  const std::size_t bytes = static_cast<std::size_t>(tree.descriptor_bytes);
  const std::size_t total = 16 + (tree.nodes() - 1) * (28 + bytes) + 4 + 8 * row_of_word.size();
  sink.number(kDbow3Magic);
  sink.number(static_cast<std::uint8_t>(compressed ? 1 : 0));
  sink.number(static_cast<std::uint32_t>(tree.nodes()));
  if (compressed) sink.number(static_cast<std::uint32_t>((total + kChunk - 1) / kChunk));
  ContentSink content(sink, compressed);
  content.number(static_cast<std::int32_t>(tree.k));
  content.number(static_cast<std::int32_t>(tree.levels));
  content.number(static_cast<std::int32_t>(tree.scoring));
  content.number(static_cast<std::int32_t>(tree.weighting));
  for (std::uint32_t row = 1; row < tree.nodes(); ++row) {
    content.number(id(row));
    content.number(id(tree.parents[row]));
    content.number(tree.words[row] != kNoWord ? tree.weights[row] : 0.0);
    content.number(static_cast<std::int32_t>(bytes));
    content.number(std::int32_t{1});
    content.number(kBytes8U);
    content.write(tree.descriptors.data() + row * bytes, bytes);
  }
  content.number(static_cast<std::uint32_t>(row_of_word.size()));
  for (std::uint32_t word = 0; word < row_of_word.size(); ++word) {
    content.number(word);
    content.number(id(row_of_word[word]));
  }
  content.finish();
}

}  // namespace dynslam::loop::detail
