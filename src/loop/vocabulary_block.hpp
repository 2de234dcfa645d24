// How a vocabulary lies in memory and, the same bytes, in a .dynvoc file.
//
//   header     256 bytes
//   tree       one block a parent: u32 children, u32 number of the first child,
//              u32 link for every child, padding to 8 bytes, a descriptor for every child
//   weights    f64 for every word
//   ids        u32 for every node, or nothing: what results call the node of a number
//
// Sections start at multiples of 64 bytes, blocks at multiples of 8, descriptors are padded to 8.
// A link is 0x80000000 | word, or the place of the child's own block in the tree section in units
// of 8 bytes. The root's block comes first and a block comes after that of its parent, so that no
// walk can go in circles. Children are numbered 1, 2, ... in the order of the blocks; 0 is the
// root. A step of a walk touches one block: neighbouring cache lines, which are asked for as soon
// as the link is known.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "dynslam/core/span.hpp"
#include "dynslam/loop/vocabulary.hpp"

namespace dynslam::loop::detail {

inline constexpr char kBlockMagic[8] = {'d', 'y', 'n', 'v', 'o', 'c', '\r', '\n'};
inline constexpr std::uint32_t kBlockVersion = 1;
inline constexpr std::uint32_t kBlockByteOrder = 0x01020304U;
inline constexpr std::uint32_t kLeafBit = 0x80000000U;
inline constexpr std::size_t kBlockAlignment = 64;

struct BlockHeader {
  char magic[8];
  std::uint32_t byte_order;
  std::uint32_t version;
  std::uint64_t header_sum;  // of the header with this member 0
  std::uint64_t body_sum;    // of everything behind the header
  std::uint64_t file_bytes;
  std::uint64_t tree_offset;
  std::uint64_t tree_bytes;
  std::uint64_t weights_offset;
  std::uint64_t ids_offset;  // 0: there are none
  std::uint32_t k;
  std::uint32_t levels;
  std::uint32_t descriptor_bytes;
  std::uint32_t nodes;
  std::uint32_t parents;  // nodes with children: blocks of the tree
  std::uint32_t words;    // numbers of words are below this
  std::uint32_t weighting;
  std::uint32_t scoring;
  std::uint32_t single_precision;
  std::uint32_t reserved[37];
};
static_assert(sizeof(BlockHeader) == 256);

inline constexpr std::size_t padded(std::size_t bytes, std::size_t unit) {
  return (bytes + unit - 1) / unit * unit;
}
/// Bytes between the descriptors of a block.
inline constexpr std::size_t descriptor_stride(std::size_t bytes) { return padded(bytes, 8); }
/// Where the descriptors of a block begin.
inline constexpr std::size_t descriptors_offset(std::size_t children) {
  return 8 + padded(4 * children, 8);
}
inline constexpr std::size_t block_bytes(std::size_t children, std::size_t stride) {
  return descriptors_offset(children) + children * stride;
}

struct VocabularyBlock {
  BlockHeader header{};
  std::shared_ptr<const std::uint8_t> memory;  // header and sections

  const std::uint8_t* tree() const { return memory.get() + header.tree_offset; }
  const double* weights() const {
    return reinterpret_cast<const double*>(memory.get() + header.weights_offset);
  }
  /// Null: a node is called by its number.
  const NodeId* ids() const {
    if (header.ids_offset == 0) return nullptr;
    return reinterpret_cast<const NodeId*>(memory.get() + header.ids_offset);
  }
  std::size_t stride() const { return descriptor_stride(header.descriptor_bytes); }
};

/// Memory for a block of that size, aligned and set to 0.
std::shared_ptr<std::uint8_t> allocate_block(std::size_t bytes);

/// Offsets and size that follow from the header's counts and tree_bytes.
void lay_out(BlockHeader& header, bool with_ids);

/// Fills in the sums of a complete block.
void seal(BlockHeader& header, Span<const std::uint8_t> body);

/// What is wrong with a block that comes from outside: every count, sum, link and weight is looked
/// at. Nothing: it is safe to walk.
std::optional<std::string> problem_of(Span<const std::uint8_t> bytes);

}  // namespace dynslam::loop::detail
