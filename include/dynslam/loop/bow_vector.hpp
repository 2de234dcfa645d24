// Bag-of-words vectors, the direct index, and the scores between two vectors.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "dynslam/core/span.hpp"

namespace dynslam::loop {

/// Number of a word of a vocabulary, 0 .. words - 1.
using WordId = std::uint32_t;
/// Number of a node of the vocabulary's tree; 0 is the root.
using NodeId = std::uint32_t;

/// How two vectors are compared; numbered as in the files of DBoW2.
///
/// With sums over the words that both vectors have, unless it says otherwise:
enum class Scoring : std::uint8_t {
  kL1 = 0,               ///< 1 - |v - w|_1 / 2 = sum(|v_i| + |w_i| - |v_i - w_i|) / 2
  kL2 = 1,               ///< 1 - sqrt(1 - sum v_i w_i)
  kChiSquare = 2,        ///< 2 sum v_i w_i / (v_i + w_i)
  kKullbackLeibler = 3,  ///< sum over all of v: v_i log(v_i / w_i), w_i = 2^-52 where w has no i
  kBhattacharyya = 4,    ///< sum sqrt(v_i w_i)
  kDotProduct = 5,       ///< sum v_i w_i
};

/// What a vector is divided by before vectors are compared.
enum class Norm : std::uint8_t {
  kNone = 0,
  kL1 = 1,  ///< sum of absolute values
  kL2 = 2,  ///< root of the sum of squares
};

/// The norm that a score expects: L2 for kL2, none for kDotProduct, L1 for the rest.
Norm norm_of(Scoring scoring);

/// True if a higher score means more alike; only of kKullbackLeibler, a divergence, the lower one
/// does.
constexpr bool higher_is_better(Scoring scoring) { return scoring != Scoring::kKullbackLeibler; }

/// Sparse vector: which words an image has, ascending, each once, and how much of each.
///
/// Words and weights lie in two arrays of the same length. Reads from several threads are safe.
class BowVector {
 public:
  BowVector() = default;

  std::size_t size() const { return words_.size(); }
  bool empty() const { return words_.empty(); }
  Span<const WordId> words() const { return words_; }
  Span<const double> weights() const { return weights_; }
  WordId word(std::size_t i) const { return words_[i]; }
  double weight(std::size_t i) const { return weights_[i]; }

  /// Weight of a word, 0 if the vector does not have it. O(log size).
  double weight_of(WordId word) const;

  /// Forgets everything and keeps the memory.
  void clear();
  void reserve(std::size_t size);

  /// Appends a word. Throws InvalidArgument if `word` is not above the last one or the weight is
  /// not finite. Amortized O(1).
  void push_back(WordId word, double weight);

  /// Adds `weight` to a word, which is put where it belongs. Throws InvalidArgument if the weight
  /// is not finite. O(size).
  void add(WordId word, double weight);

  /// weight = function(weight), word by word in ascending order. O(size).
  template <typename Function>
  void transform_weights(Function function) {
    for (double& weight : weights_) weight = function(weight);
  }

  /// Divides all weights by the vector's norm; a vector whose norm is 0 stays as it is. O(size).
  void normalize(Norm norm);

  friend bool operator==(const BowVector& a, const BowVector& b) {
    return a.words_ == b.words_ && a.weights_ == b.weights_;
  }
  friend bool operator!=(const BowVector& a, const BowVector& b) { return !(a == b); }

 private:
  std::vector<WordId> words_;
  std::vector<double> weights_;
};

/// Direct index: which features of an image fell below which node of one level of the tree.
///
/// Features of two images that lie below the same node are the candidates of a match. Nodes are
/// ascending, the features of a node too.
class FeatureVector {
 public:
  FeatureVector() = default;

  /// Number of nodes.
  std::size_t size() const { return nodes_.size(); }
  bool empty() const { return nodes_.empty(); }
  Span<const NodeId> nodes() const { return nodes_; }
  NodeId node(std::size_t i) const { return nodes_[i]; }
  /// Rows of the descriptors below the node at position i.
  Span<const std::uint32_t> features(std::size_t i) const {
    return {features_.data() + begins_[i], begins_[i + 1] - begins_[i]};
  }
  /// Features below all nodes, node after node.
  Span<const std::uint32_t> all_features() const { return features_; }

  void clear();

  /// Rebuilds the index from nodes[f] = node of feature rows[f]. `rows` may be empty: then feature
  /// f is row f. Throws InvalidArgument if the sizes differ. O(n log n).
  void assign(Span<const NodeId> nodes, Span<const std::uint32_t> rows = {});

  friend bool operator==(const FeatureVector& a, const FeatureVector& b) {
    return a.nodes_ == b.nodes_ && a.begins_ == b.begins_ && a.features_ == b.features_;
  }
  friend bool operator!=(const FeatureVector& a, const FeatureVector& b) { return !(a == b); }

 private:
  std::vector<NodeId> nodes_;
  std::vector<std::uint32_t> begins_ = {0};  // size() + 1
  std::vector<std::uint32_t> features_;
};

// Scores. Both vectors are normalized as norm_of says; an empty vector scores 0. They read as the
// equations at Scoring, term by term in the order of the words, which is also the order of DBoW2:
// equal vectors give equal scores bit for bit. O(size of a + size of b), less where one vector is
// much shorter; no allocation; thread-safe.
// Source: Nister & Stewenius, CVPR 2006 (L1, L2); Galvez-Lopez & Tardos, T-RO 2012 (the others).

double l1_score(const BowVector& a, const BowVector& b);
double l2_score(const BowVector& a, const BowVector& b);
double chi_square_score(const BowVector& a, const BowVector& b);
double kullback_leibler_score(const BowVector& a, const BowVector& b);
double bhattacharyya_score(const BowVector& a, const BowVector& b);
double dot_product_score(const BowVector& a, const BowVector& b);

/// The score of that name.
double score(Scoring scoring, const BowVector& a, const BowVector& b);

}  // namespace dynslam::loop
