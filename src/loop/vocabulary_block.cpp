#include "loop/vocabulary_block.hpp"

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <new>
#include <vector>

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
  return checksum(reinterpret_cast<const std::uint8_t*>(&header), sizeof(header));
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

/// Walks through the blocks one after the other.
class TreeCheck {
 public:
  explicit TreeCheck(const VocabularyBlock& block)
      : block_(block), begins_(block.header.tree_bytes / 8 / 64 + 1, 0) {}

  std::optional<std::string> operator()() {
    const BlockHeader& header = block_.header;
    std::size_t at = 0;
    std::uint32_t next_child = 1;
    for (std::uint32_t parent = 0; parent < header.parents; ++parent) {
      if (at + 8 > header.tree_bytes) return where(at) + "lies behind the end of the tree";
      if (at > 0 && !is_begin(at / 8)) return where(at) + "no link leads here";
      const std::uint32_t children = word_at(at);
      if (children < 1 || children > header.k)
        return where(at) + "has " + text(children) + " children, expected 1 .. " + text(header.k);
      const std::size_t size = block_bytes(children, block_.stride());
      if (size > header.tree_bytes - at) return where(at) + "reaches behind the end of the tree";
      if (word_at(at + 4) != next_child)
        return where(at) + differs("number of the first child", word_at(at + 4), next_child);
      next_child += children;
      if (next_child > header.nodes) return where(at) + "has more children than there are nodes";
      if (auto problem = check_links(at, children)) return problem;
      at += size;
    }
    if (at != header.tree_bytes) return differs("end of the last block", at, header.tree_bytes);
    if (next_child != header.nodes) return differs("number of nodes", next_child, header.nodes);
    if (links_ != header.parents - 1U)
      return differs("links to blocks", links_, header.parents - 1U);
    return std::nullopt;
  }

 private:
  std::optional<std::string> check_links(std::size_t at, std::uint32_t children) {
    const std::size_t tree_units = block_.header.tree_bytes / 8;
    for (std::uint32_t i = 0; i < children; ++i) {
      const std::uint32_t link = word_at(at + 8 + 4 * std::size_t{i});
      if ((link & kLeafBit) != 0) {
        if ((link & ~kLeafBit) < block_.header.words) continue;
        return where(at) + "word " + text(link & ~kLeafBit) + " of " + text(block_.header.words);
      }
      if (link <= at / 8 || link >= tree_units)
        return where(at) + "links to " + text(std::uint64_t{link} * 8) + ", expected a later block";
      if (is_begin(link)) return where(at) + "a second link to " + text(std::uint64_t{link} * 8);
      begins_[link / 64] |= std::uint64_t{1} << (link % 64);
      ++links_;
    }
    return std::nullopt;
  }

  bool is_begin(std::size_t unit) const { return (begins_[unit / 64] >> (unit % 64) & 1) != 0; }
  std::uint32_t word_at(std::size_t at) const {
    std::uint32_t word;
    std::memcpy(&word, block_.tree() + at, sizeof(word));
    return word;
  }
  static std::string where(std::size_t at) { return "block at " + text(at) + " of the tree: "; }

  const VocabularyBlock& block_;
  std::vector<std::uint64_t> begins_;  // a bit for every place where a block may begin
  std::uint32_t links_ = 0;
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
  header.body_sum = checksum(body.data(), body.size());
  header.header_sum = sum_of_header(header);
}

std::optional<std::string> problem_of_body(const VocabularyBlock& block) {
  if (auto problem = TreeCheck(block)()) return problem;
  const double* weights = block.weights();
  if (!all_weights_valid(weights, block.header.words)) {
    for (std::uint32_t w = 0; w < block.header.words; ++w) {
      if (std::isfinite(weights[w]) && weights[w] >= 0.0) continue;
      return "weight of word " + text(w) + " is " + std::to_string(weights[w]) +
             ", expected a finite number >= 0";
    }
  }
  return problem_of_ids(block);
}

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
  if (header.body_sum != checksum(bytes.data() + sizeof(header), bytes.size() - sizeof(header)))
    return "checksum of the content does not match";
  block.memory = {std::shared_ptr<void>(), bytes.data()};  // a view for the time of the check
  return problem_of_body(block);
}

}  // namespace dynslam::loop::detail
