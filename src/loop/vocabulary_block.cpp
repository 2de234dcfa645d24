#include "loop/vocabulary_block.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <new>
#include <utility>
#include <vector>

#include <hwy/base.h>

#include "dynslam/loop/vocabulary_tree.hpp"

#include "loop/walk_kernels.hpp"

namespace dynslam::loop::detail {
namespace {

std::string text(std::uint64_t value) { return std::to_string(value); }

std::string differs(const char* what, std::uint64_t got, std::uint64_t expected) {
  return std::string(what) + " is " + text(got) + ", expected " + text(expected);
}

std::uint64_t sum_of_header(BlockHeader header) {
  header.header_sum = 0;
  Checksum sum;
  sum.add(reinterpret_cast<const std::uint8_t*>(&header), sizeof(header));
  return sum.value();
}

/// Counts and offsets of a header that says it is one of ours.
std::optional<std::string> problem_of_header(const BlockHeader& header, std::size_t bytes) {
  const auto outside = [](const char* what, std::uint64_t got, std::uint64_t low,
                          std::uint64_t high) -> std::optional<std::string> {
    if (got >= low && got <= high) return std::nullopt;
    return std::string(what) + " is " + text(got) + ", expected " + text(low) + " .. " + text(high);
  };
  for (const auto& problem :
       {outside("k", header.k, 1, kMaxChildren), outside("levels", header.levels, 1, kMaxLevels),
        outside("descriptor_bytes", header.descriptor_bytes, 1, kMaxDescriptorBytes),
        outside("nodes", header.nodes, 2, kMaxNodes),
        outside("parents", header.parents, 1, header.nodes - 1),
        outside("words", header.words, 1, kLeafBit - 1),
        outside("weighting", header.weighting, 0, 3), outside("scoring", header.scoring, 0, 5),
        outside("single_precision", header.single_precision, 0, 1),
        outside("tree_bytes", header.tree_bytes, 1, bytes)}) {
    if (problem) return problem;
  }
  BlockHeader expected = header;
  lay_out(expected, header.ids_offset != 0);
  if (header.tree_offset != expected.tree_offset)
    return differs("tree_offset", header.tree_offset, expected.tree_offset);
  if (header.weights_offset != expected.weights_offset)
    return differs("weights_offset", header.weights_offset, expected.weights_offset);
  if (header.ids_offset != expected.ids_offset)
    return differs("ids_offset", header.ids_offset, expected.ids_offset);
  if (header.file_bytes != expected.file_bytes)
    return differs("file_bytes", header.file_bytes, expected.file_bytes);
  if (header.file_bytes != bytes) return differs("size of the file", bytes, header.file_bytes);
  return std::nullopt;
}

/// Walks through the blocks one after the other, as far as they were read.
class TreeCheck {
 public:
  explicit TreeCheck(const VocabularyBlock& block)
      : block_(block), begins_(block.header.tree_bytes / 8 / 64 + 1, 0) {}

  /// Looks at the blocks that begin before `limit` bytes of the tree.
  void advance(std::size_t limit) {
    while (at_ < limit && parent_ < block_.header.parents && !problem_) {
      if (!check_block()) problem_ = problem_of_block();
    }
  }

  std::optional<std::string> finish() {
    const BlockHeader& header = block_.header;
    advance(header.tree_bytes);
    if (problem_) return problem_;
    if (parent_ != header.parents) return differs("number of blocks", parent_, header.parents);
    if (at_ != header.tree_bytes) return differs("end of the last block", at_, header.tree_bytes);
    if (child_ != header.nodes) return differs("number of nodes", child_, header.nodes);
    if (links_.size() != header.parents - 1U)
      return differs("links to blocks", links_.size(), header.parents - 1U);
    if (depth() > header.levels) return differs("depth of the tree", depth(), header.levels);
    return std::nullopt;
  }

 private:
  /// Takes a block if all is well with it. Runs for every parent of the tree: no texts here.
  bool check_block() {
    const BlockHeader& header = block_.header;
    if (at_ + 8 > header.tree_bytes || (at_ > 0 && !is_begin(at_ / 8))) return false;
    const std::uint32_t children = word_at(at_);
    if (children < 1 || children > header.k || children > header.nodes - child_) return false;
    const std::size_t size = block_bytes(children, block_.stride());
    if (size > header.tree_bytes - at_ || word_at(at_ + 4) != child_) return false;
    // Most blocks are words alone. The upper bit comes up where that is not so, or a word too high.
    std::uint32_t upper = 0;
    for (std::uint32_t i = 0; i < children; ++i) {
      const std::uint32_t word = link(i) - kLeafBit;
      upper |= word | (header.words - 1 - word);
    }
    if ((upper & kLeafBit) != 0) {
      for (std::uint32_t i = 0; i < children; ++i) {
        if (!take_link(link(i))) return false;
      }
    }
    child_ += children;
    at_ += size;
    ++parent_;
    return true;
  }

  bool take_link(std::uint32_t to) {
    if ((to & kLeafBit) != 0) return (to & ~kLeafBit) < block_.header.words;
    if (to <= at_ / 8 || to >= block_.header.tree_bytes / 8 || is_begin(to)) return false;
    begins_[to / 64] |= std::uint64_t{1} << (to % 64);
    links_.emplace_back(to, parent_);
    return true;
  }

  /// Most steps from the root to a node.
  std::uint32_t depth() const {
    // The bits before that of a block tell which one it is; all but the first have a bit.
    std::vector<std::uint32_t> before(begins_.size());
    std::uint32_t bits = 1;
    for (std::size_t i = 0; i < begins_.size(); ++i) {
      before[i] = bits;
      bits += static_cast<std::uint32_t>(hwy::PopCount(begins_[i]));
    }
    std::vector<std::uint32_t> depths(block_.header.parents, 1);
    std::uint32_t deepest = 1;
    for (const auto& [to, from] : links_) {  // parents before their children
      const std::uint64_t lower = begins_[to / 64] & ((std::uint64_t{1} << (to % 64)) - 1);
      const std::uint32_t child =
          before[to / 64] + static_cast<std::uint32_t>(hwy::PopCount(lower));
      depths[child] = depths[from] + 1;
      deepest = std::max(deepest, depths[child]);
    }
    return deepest;
  }

  /// What check_block did not like; it stopped where it was.
  std::string problem_of_block() const {
    const BlockHeader& header = block_.header;
    const std::string where = "block at " + text(at_) + " of the tree: ";
    if (at_ + 8 > header.tree_bytes) return where + "lies behind the end of the tree";
    if (at_ > 0 && !is_begin(at_ / 8)) return where + "no link leads here";
    const std::uint32_t children = word_at(at_);
    if (children < 1 || children > header.k)
      return where + "has " + text(children) + " children, expected 1 .. " + text(header.k);
    if (children > header.nodes - child_) return where + "has more children than there are nodes";
    if (block_bytes(children, block_.stride()) > header.tree_bytes - at_)
      return where + "reaches behind the end of the tree";
    if (word_at(at_ + 4) != child_)
      return where + differs("number of the first child", word_at(at_ + 4), child_);
    for (std::uint32_t i = 0; i < children; ++i) {
      const std::uint32_t to = link(i);
      if ((to & kLeafBit) != 0 && (to & ~kLeafBit) >= header.words)
        return where + "word " + text(to & ~kLeafBit) + " of " + text(header.words);
      if ((to & kLeafBit) == 0 && (to <= at_ / 8 || to >= header.tree_bytes / 8))
        return where + "links to " + text(std::uint64_t{to} * 8) + ", expected a later block";
    }
    return where + "links to a block that another link leads to";
  }

  bool is_begin(std::size_t unit) const { return (begins_[unit / 64] >> (unit % 64) & 1) != 0; }
  std::uint32_t link(std::uint32_t i) const { return word_at(at_ + 8 + 4 * std::size_t{i}); }
  std::uint32_t word_at(std::size_t at) const {
    std::uint32_t word;
    std::memcpy(&word, block_.tree() + at, sizeof(word));
    return word;
  }

  const VocabularyBlock& block_;
  std::vector<std::uint64_t> begins_;  // a bit for every place where a block may begin
  std::optional<std::string> problem_;
  std::size_t at_ = 0;                                          // of the next block
  std::uint32_t parent_ = 0;                                    // blocks so far
  std::uint32_t child_ = 1;                                     // number of the next child
  std::vector<std::pair<std::uint32_t, std::uint32_t>> links_;  // to a place, from a block
};

std::optional<std::string> problem_of_ids(const VocabularyBlock& block) {
  const NodeId* ids = block.ids();
  if (ids == nullptr) return std::nullopt;
  const std::uint32_t nodes = block.header.nodes;
  std::vector<bool> seen(nodes, false);
  if (ids[0] != 0) return differs("id of the root", ids[0], 0);
  for (std::uint32_t i = 0; i < nodes; ++i) {
    if (ids[i] >= nodes || seen[ids[i]])
      return "id of node " + text(i) + " is " + text(ids[i]) + ", expected another number below " +
             text(nodes);
    seen[ids[i]] = true;
  }
  return std::nullopt;
}

}  // namespace

std::shared_ptr<std::uint8_t> allocate_block(std::size_t bytes) {
  void* memory = std::aligned_alloc(kBlockAlignment, padded(bytes, kBlockAlignment));
  if (memory == nullptr) throw std::bad_alloc();
  std::memset(memory, 0, padded(bytes, kBlockAlignment));
  return {static_cast<std::uint8_t*>(memory), [](std::uint8_t* p) { std::free(p); }};
}

void lay_out(BlockHeader& header, bool with_ids) {
  header.tree_offset = sizeof(BlockHeader);
  header.weights_offset = padded(header.tree_offset + header.tree_bytes, kBlockAlignment);
  std::uint64_t end =
      padded(header.weights_offset + sizeof(double) * std::uint64_t{header.words}, kBlockAlignment);
  header.ids_offset = with_ids ? end : 0;
  if (with_ids) end = padded(end + sizeof(NodeId) * std::uint64_t{header.nodes}, kBlockAlignment);
  header.file_bytes = end;
}

void seal(BlockHeader& header, Span<const std::uint8_t> body) {
  Checksum sum;
  sum.add(body.data(), body.size());
  header.body_sum = sum.value();
  header.header_sum = sum_of_header(header);
}

namespace {

std::optional<std::string> problem_of_weights(const VocabularyBlock& block) {
  const double* weights = block.weights();
  if (all_weights_valid(weights, block.header.words)) return std::nullopt;
  for (std::uint32_t w = 0; w < block.header.words; ++w) {
    if (weights[w] >= 0.0 && weights[w] <= kMaxWordWeight && !std::signbit(weights[w])) continue;
    return "weight of word " + text(w) + " is " + std::to_string(weights[w]) +
           ", expected 0 .. 1e12";
  }
  return std::nullopt;
}

/// One pass over the bytes: a piece is summed, then its blocks are looked at while it is in the
/// cache.
std::optional<std::string> problem_of_body(const VocabularyBlock& block) {
  constexpr std::size_t kPiece = 1U << 14;
  const BlockHeader& header = block.header;
  const std::uint8_t* body = block.memory.get() + sizeof(BlockHeader);
  const std::size_t size = header.file_bytes - sizeof(BlockHeader);
  Checksum sum;
  TreeCheck tree(block);
  for (std::size_t at = 0; at < size; at += kPiece) {
    const std::size_t piece = std::min(kPiece, size - at);
    sum.add(body + at, piece);
    if (at < header.tree_bytes) tree.advance(at + piece);
  }
  if (sum.value() != header.body_sum) return "checksum of the content does not match";
  if (auto problem = tree.finish()) return problem;
  if (auto problem = problem_of_weights(block)) return problem;
  return problem_of_ids(block);
}

}  // namespace

std::optional<std::string> problem_of(Span<const std::uint8_t> bytes) {
  VocabularyBlock block;
  if (bytes.size() < sizeof(BlockHeader))
    return "has " + text(bytes.size()) + " bytes, the header alone has " +
           text(sizeof(BlockHeader));
  BlockHeader& header = block.header;
  std::memcpy(&header, bytes.data(), sizeof(header));
  if (std::memcmp(header.magic, kBlockMagic, sizeof(kBlockMagic)) != 0)
    return "is not a dynslam vocabulary (its first bytes are others)";
  if (header.byte_order != kBlockByteOrder)
    return "was written on a machine of the other byte order";
  if (header.version != kBlockVersion)
    return differs("version of the format", header.version, kBlockVersion);
  if (header.header_sum != sum_of_header(header)) return "checksum of the header does not match";
  if (auto problem = problem_of_header(header, bytes.size())) return "header: " + *problem;
  block.memory = {std::shared_ptr<void>(), bytes.data()};  // a view for the time of the check
  return problem_of_body(block);
}

}  // namespace dynslam::loop::detail
