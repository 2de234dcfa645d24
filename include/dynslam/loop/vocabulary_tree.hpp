// A vocabulary as plain arrays: what readers, training and other makers of trees fill in.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "dynslam/loop/bow_vector.hpp"
#include "dynslam/loop/vocabulary.hpp"

namespace dynslam::loop {

/// Stands in VocabularyTree::words for a node that is no word.
inline constexpr WordId kNoWord = 0xFFFFFFFFU;

// Bounds that every vocabulary keeps, whatever file it comes from.
inline constexpr int kMaxChildren = 65535;          ///< of a node
inline constexpr int kMaxLevels = 255;              ///< of a tree
inline constexpr double kMaxWordWeight = 1e12;      ///< so that no sum overflows
inline constexpr int kMaxDescriptorBytes = 256;     ///< of a descriptor
inline constexpr std::size_t kMaxNodes = 1U << 30;  ///< of a tree

/// Editable form of a vocabulary. Row 0 is the root; the children of a node are the rows that name
/// it as parent, and of equally near children the one in the lower row wins.
struct VocabularyTree {
  /// Most children of a node, 1 .. kMaxChildren.
  int k = 10;
  /// Most steps from the root to a word, 1 .. kMaxLevels.
  int levels = 6;
  Weighting weighting = Weighting::kTfIdf;
  Scoring scoring = Scoring::kL1;
  /// Length of a descriptor, 1 .. kMaxDescriptorBytes.
  int descriptor_bytes = 32;
  /// Vectors are summed and normalized in single precision, as FBoW does it.
  bool single_precision = false;

  /// Row of each row's parent; that of the root is 0.
  std::vector<std::uint32_t> parents;
  /// descriptor_bytes a row; those of the root mean nothing.
  std::vector<std::uint8_t> descriptors;
  /// The word that a row is; kNoWord for a node with children. Two rows may be the same word if
  /// their weights are the same, and numbers may be left out: files of FBoW are like that.
  std::vector<WordId> words;
  /// Weight of the word that a row is, 0 .. kMaxWordWeight; means nothing for a node with children.
  std::vector<double> weights;
  /// What results call the node of a row: a permutation of 0 .. rows - 1 with 0 for the root.
  /// Empty: its row.
  std::vector<NodeId> ids;

  /// Number of nodes with the root.
  std::size_t nodes() const { return parents.size(); }
};

/// The vocabulary of a tree.
///
/// Throws InvalidArgument, naming the row, if the arrays do not fit together, a member breaks its
/// comment above, a node has more than k children, lies deeper than `levels` or is not connected
/// with the root (a cycle), or if a node is neither word nor parent, or both. O(nodes), allocates
/// the vocabulary and up to 20 bytes a node besides.
Vocabulary make_vocabulary(const VocabularyTree& tree);

/// The tree of a vocabulary: make_vocabulary(tree_of(v)) gives the same results as v, bit for bit.
/// O(nodes).
VocabularyTree tree_of(const Vocabulary& vocabulary);

/// Numbers the words 0, 1, 2 ... in the order of their rows, each row a word of its own: what files
/// of DBoW2 and DBoW3 want of a tree that came from FBoW with gaps. O(nodes).
void renumber_words(VocabularyTree& tree);

}  // namespace dynslam::loop
