// Bag-of-words vectors for the tests of database and detector.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <random>

#include "dynslam/loop/bow_vector.hpp"

namespace dynslam::loop {

/// About `draws` words, low numbers often and high ones rarely, weights of common words low.
inline BowVector random_bow(std::uint64_t seed, std::size_t draws, std::size_t words, Norm norm) {
  std::mt19937_64 random(seed * 7919);
  std::map<WordId, double> counts;
  for (std::size_t i = 0; i < draws; ++i) {
    const double u = static_cast<double>(random() >> 11) * 0x1p-53;
    const auto word = static_cast<WordId>(u * u * static_cast<double>(words));
    counts[word] += 1.0 + 3.0 * u;
  }
  BowVector bow;
  for (const auto& [word, weight] : counts) bow.push_back(word, weight);
  bow.normalize(norm);
  return bow;
}

}  // namespace dynslam::loop
