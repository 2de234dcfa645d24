// Training a vocabulary from descriptors.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>

#include "dynslam/core/image_view.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/loop/vocabulary.hpp"

namespace dynslam::loop {

struct TrainingOptions {
  /// Children of a node, 2 .. 255; DBoW2 and ORB-SLAM: 10.
  int k = 10;
  /// Levels below the root, 1 .. 20; ORB-SLAM: 6. A full tree has k^levels words.
  int levels = 6;
  Weighting weighting = Weighting::kTfIdf;
  Scoring scoring = Scoring::kL1;
  /// Rounds of assigning and averaging a node may take, at least 1 (engineering; most stop before).
  int max_rounds = 11;
  /// A node of fewer descriptors than this becomes a word although it is not at the last level, at
  /// least 2 (DBoW2: 2).
  int min_split = 2;
  /// Threads that work, at least 1. The result does not depend on them.
  int threads = 1;
  /// Start of the random numbers that seed the clusters.
  std::uint64_t seed = 0;
  /// Told how much is done, by the calling thread, a few hundred times; may be empty. What it
  /// throws ends the training and comes out of train_vocabulary.
  std::function<void(std::size_t done, std::size_t total)> progress;

  /// Throws InvalidArgument naming the first member that breaks its rule above.
  void validate() const;
};

/// Hierarchical k-majority over binary descriptors.
///
/// A node's descriptors fall into k clusters: seeds by k-means++ (the next one with a probability
/// proportional to the distance to the nearest seed so far, which for bits is the squared Euclidean
/// distance), then rounds of assigning each descriptor to the nearest centre in Hamming distance
/// and setting each bit of a centre to what the majority of its descriptors has (1 at a tie), until
/// nothing changes. A node of at most k different descriptors gets one child for each. Fewer words
/// than k^levels come out where descriptors are short: vocabulary.words() tells.
///
/// Words weigh idf = ln(N / N_i) for kTfIdf and kIdf, N images in all and N_i with the word (Sivic
/// & Zisserman, ICCV 2003), and 1 for the other weightings; a word that is in every image is
/// stopped. Weights are rounded to float, so that every file format holds them.
///
/// `image_ends`: where each image's rows end, ascending, the last one the number of rows. Empty:
/// all words weigh 1.
///
/// Throws InvalidArgument if an option breaks its rule, if there are fewer than 2 different
/// descriptors, if descriptors are longer than 256 bytes, if image_ends does not ascend to the
/// number of rows, or if it names one image alone (every weight would be 0).
/// O(n k levels rounds); allocates a copy of the descriptors and 8 bytes for each.
/// Source: k-means++ Arthur & Vassilvitskii, SODA 2007; k-majority Grana et al., 2013; the tree
/// Nister & Stewenius, CVPR 2006.
Vocabulary train_vocabulary(DescriptorsView descriptors, Span<const std::size_t> image_ends,
                            const TrainingOptions& options = {});

}  // namespace dynslam::loop
