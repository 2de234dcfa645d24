// A vocabulary of the size of ORB-SLAM's, grown by perturbation: nobody may pass that one on.
#pragma once

#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "dynslam/loop/vocabulary_tree.hpp"

namespace dynslam::loop::benchmark_data {

/// k = 10, L = 6, about `words` words (up to a million): the children of a node are that node with
/// bits redrawn, fewer the deeper it lies. Idf between 5 and 10 as floats.
inline VocabularyTree grown_tree(std::size_t words, unsigned seed = 1) {
  constexpr std::size_t kBytes = 32;
  std::mt19937_64 random(seed);
  VocabularyTree tree;
  tree.k = 10;
  tree.levels = 6;
  const auto add = [&](std::uint32_t parent, int level) {
    const std::size_t from = parent * kBytes;
    tree.parents.push_back(parent);
    tree.words.push_back(kNoWord);
    tree.weights.push_back(0.0);
    for (std::size_t w = 0; w < kBytes; w += 8) {
      std::uint64_t noise = random();
      for (int halvings = 1; halvings < level && halvings < 4; ++halvings) noise &= random();
      for (std::size_t b = 0; b < 8; ++b) {
        const std::uint8_t before = level == 0 ? std::uint8_t{0} : tree.descriptors[from + w + b];
        tree.descriptors.push_back(static_cast<std::uint8_t>(before ^ (noise >> (8 * b))));
      }
    }
    return static_cast<std::uint32_t>(tree.nodes() - 1);
  };
  std::vector<std::uint32_t> level = {add(0, 0)};
  for (int depth = 1; depth < 6; ++depth) {
    std::vector<std::uint32_t> below;
    for (const std::uint32_t parent : level) {
      for (int c = 0; c < 10; ++c) below.push_back(add(parent, depth));
    }
    level.swap(below);
  }
  WordId word = 0;
  for (std::size_t i = 0; i < level.size(); ++i) {
    const std::size_t children = (i + 1) * words / level.size() - i * words / level.size();
    for (std::size_t c = 0; c < children; ++c) {
      const std::uint32_t row = add(level[i], 6);
      tree.words[row] = word++;
      tree.weights[row] = static_cast<double>(5.0F + static_cast<float>(random() % 5000) / 1000.0F);
    }
  }
  return tree;
}

/// Descriptors like those of images of that vocabulary: random words, an eighth of their bits
/// redrawn.
inline std::vector<std::uint8_t> image_of(const VocabularyTree& tree, std::size_t count,
                                          unsigned seed) {
  constexpr std::size_t kBytes = 32;
  std::mt19937_64 random(seed);
  std::vector<std::uint8_t> bytes;
  bytes.reserve(count * kBytes);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t row = tree.nodes() - 1 - random() % (tree.nodes() / 2);
    for (std::size_t b = 0; b < kBytes; ++b) {
      const std::uint64_t noise = random() & random() & random();
      bytes.push_back(static_cast<std::uint8_t>(tree.descriptors[row * kBytes + b] ^ noise));
    }
  }
  return bytes;
}

}  // namespace dynslam::loop::benchmark_data
