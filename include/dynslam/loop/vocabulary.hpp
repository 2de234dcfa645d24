// Vocabulary tree over binary descriptors: which word a descriptor is.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "dynslam/core/image_view.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/loop/bow_vector.hpp"

namespace dynslam::loop {

/// What a word counts in a vector; numbered as in the files of DBoW2.
enum class Weighting : std::uint8_t {
  kTfIdf = 0,   ///< features of the word in the image times the word's idf
  kTf = 1,      ///< features of the word in the image
  kIdf = 2,     ///< the word's idf, however often it occurs
  kBinary = 3,  ///< 1
};

namespace detail {
struct VocabularyBlock;
}

/// Descriptors of an image on the way to words.
struct Features {
  /// One descriptor a row, as wide as the vocabulary's.
  DescriptorsView descriptors;
  /// One flag a row; 0 leaves the feature out, for example because it lies on a mover. Empty:
  /// every feature is kept.
  Span<const std::uint8_t> keep = {};
  /// One factor a row, in [0, 1], on what the feature counts: its static weight. A feature of
  /// weight 0 is left out. Empty: every feature counts 1.
  Span<const float> weights = {};
};

/// Memory that transforms reuse; one a thread. It may serve several vocabularies in turn.
class TransformWorkspace {
 public:
  TransformWorkspace();
  ~TransformWorkspace();
  TransformWorkspace(TransformWorkspace&&) noexcept;
  TransformWorkspace& operator=(TransformWorkspace&&) noexcept;

 private:
  friend class Vocabulary;
  struct State;
  std::unique_ptr<State> state_;
};

/// Tree of binary descriptors whose leaves are the words.
///
/// A descriptor walks down from the root, each time to the child at the least Hamming distance
/// (the first of equally near ones), until it arrives at a word. Words have a weight (idf); words
/// of weight 0 are stopped: they count nothing and are left out of all results.
///
/// Immutable: copies are cheap and share the memory, all const functions may be called from
/// several threads. Made by open_vocabulary and load_vocabulary (vocabulary_io.hpp), by
/// train_vocabulary (vocabulary_training.hpp), or from a VocabularyTree (vocabulary_tree.hpp).
class Vocabulary {
 public:
  /// No words; every other function but empty() and the counts throws InvalidArgument then.
  Vocabulary() = default;
  /// For the factories; `block` is complete and checked.
  explicit Vocabulary(std::shared_ptr<const detail::VocabularyBlock> block);

  bool empty() const { return block_ == nullptr; }
  /// Most children that a node may have.
  int k() const;
  /// Depth that the tree was built for; no word lies deeper below the root.
  int levels() const;
  /// Number of words; the numbers of words are below this. (Files of FBoW may leave numbers out.)
  std::size_t words() const;
  /// Number of nodes, with the root.
  std::size_t nodes() const;
  /// Length of a descriptor in bytes.
  int descriptor_bytes() const;
  Weighting weighting() const;
  Scoring scoring() const;
  /// Bytes that the vocabulary takes, in memory or mapped.
  std::size_t bytes() const;

  /// Vectors are summed and L2-normalized in single precision, as FBoW does it: true for a file
  /// that FBoW wrote.
  bool single_precision() const;

  /// Weight of a word: its idf, or 1 with the weightings without idf. Throws InvalidArgument if
  /// there is no such word. O(1).
  double word_weight(WordId word) const;

  /// The same tree with other rules for counting and comparing. Word weights stay as they are,
  /// vectors are in double precision. O(1), shares the memory.
  Vocabulary with(Weighting weighting, Scoring scoring) const;

  /// words[i] = word of descriptor i.
  ///
  /// Throws InvalidArgument if the descriptors are not descriptor_bytes() wide (unless there are
  /// none) or words.size() is not their number. O(n k levels), no allocation.
  void find_words(DescriptorsView descriptors, Span<WordId> words) const;

  /// Vector of an image, normalized as the scoring wants, and the direct index if asked for.
  ///
  /// v_i = sum of the weights of the features of word i, times word_weight(i), for kTfIdf and kTf,
  /// divided by the number of words of the vector where the scoring has no norm (as in DBoW2);
  /// for kIdf and kBinary the largest weight in place of the sum. Without weights and flags the
  /// vector is that of DBoW2 bit for bit.
  ///
  /// `direct`, unless null, becomes the index at the level `levels_up` above the words' level
  /// (levels() - levels_up; 0 and above: the root). Nodes are numbered as in the file that the
  /// vocabulary came from. A word that lies above that level stands for itself there.
  ///
  /// Features that are left out appear in neither. No features give empty results.
  ///
  /// Throws InvalidArgument if the descriptors are not descriptor_bytes() wide (unless there are
  /// none), if `keep` or `weights` is neither empty nor one a row, if a weight is not within
  /// [0, 1] (NaN is not), or if levels_up < 0; the outputs are then untouched.
  /// O(n k levels + n log n); allocates nothing once workspace and outputs have grown.
  void transform(const Features& features, BowVector& bow, FeatureVector* direct, int levels_up,
                 TransformWorkspace& workspace) const;
  BowVector transform(const Features& features) const;
  void transform(const Features& features, int levels_up, BowVector& bow,
                 FeatureVector& direct) const;

  /// score(scoring(), a, b).
  double score(const BowVector& a, const BowVector& b) const;

  /// For the writers and the tree; not part of the stable interface.
  const detail::VocabularyBlock& block() const;

 private:
  std::shared_ptr<const detail::VocabularyBlock> block_;
};

}  // namespace dynslam::loop
