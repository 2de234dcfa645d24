// Readers and writers of the formats, each a function of a source or a sink.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "dynslam/loop/vocabulary.hpp"
#include "dynslam/loop/vocabulary_tree.hpp"

#include "loop/byte_source.hpp"

namespace dynslam::loop::detail {

inline constexpr std::uint64_t kDbow3Magic = 88877711233ULL;
inline constexpr std::uint64_t kFbowMagic = 55824124ULL;

// Each reads a whole file from its first byte and throws IoError; what comes back is consistent in
// its sizes, the rest is looked at by problem_of_tree.
VocabularyTree read_text(ByteSource& source);
VocabularyTree read_yaml(ByteSource& source);
VocabularyTree read_dbow3(ByteSource& source);
VocabularyTree read_fbow(ByteSource& source);

// Each throws InvalidArgument if the format cannot hold the tree, before anything is written.
void write_text(const VocabularyTree& tree, FileSink& sink);
void write_yaml(const VocabularyTree& tree, FileSink& sink);
void write_dbow3(const VocabularyTree& tree, bool compressed, FileSink& sink);
void write_fbow(const VocabularyTree& tree, FileSink& sink);

/// Collects the nodes of a file that gives each a number, in any order.
class NodeTable {
 public:
  /// Starts with the root.
  NodeTable(ByteSource& source, int descriptor_bytes);
  void reserve(std::size_t nodes);
  /// Appends a node and returns the place of its descriptor, set to 0.
  std::uint8_t* add(NodeId id, NodeId parent, double weight);
  void add_word(WordId word, NodeId id);
  /// Puts rows in the place of numbers. Nodes that no word names and that have no children are an
  /// error of the tree, found later.
  VocabularyTree finish();

  VocabularyTree tree;

 private:
  void index();

  ByteSource& source_;
  std::vector<std::uint32_t> row_of_id_;
};

/// Words numbered 0 .. n - 1, a row each, or InvalidArgument: what the formats of DBoW want.
std::vector<std::uint32_t> rows_of_words(const VocabularyTree& tree, const char* format);

/// The shortest digits that read back as the same number.
void append_number(std::string& text, double value);

}  // namespace dynslam::loop::detail
