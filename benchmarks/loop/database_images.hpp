// Vectors of images as a large vocabulary gives them, for the benchmarks of the database.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <random>

#include "dynslam/loop/bow_vector.hpp"

namespace dynslam::loop::benchmark_data {

inline constexpr std::size_t kDatabaseWords = 862840;  // as many as DBoW2 was measured with
inline constexpr std::size_t kDatabaseFeatures = 1000;

/// Image `i` of a walk: three quarters of its features are new or drawn from all words, common ones
/// more often than rare ones, and a quarter it shares with the image before. Normalized by L1.
inline BowVector walk_image(std::uint64_t i) {
  const auto draw = [](std::mt19937_64& random, std::size_t count, std::map<WordId, double>& bow) {
    for (std::size_t f = 0; f < count; ++f) {
      // A tenth of the words gets a third of the features, like real ones (idf from 3 to 9).
      const double u = static_cast<double>(random() >> 11) * 0x1p-53;
      const double place = std::pow(u, 2.0);
      const auto rank = static_cast<std::uint64_t>(place * double(kDatabaseWords));
      // Ranks are spread over the numbers: neighbours in rank are not neighbours in memory.
      const auto word = static_cast<WordId>((rank * 514229) % kDatabaseWords);
      bow[word] += 3.0 + 6.0 * place;
    }
  };
  std::map<WordId, double> words;
  std::mt19937_64 own(2 * i + 1), before(2 * i), next(2 * i + 2);
  draw(own, kDatabaseFeatures / 2, words);
  draw(before, kDatabaseFeatures / 4, words);
  draw(next, kDatabaseFeatures / 4, words);
  BowVector bow;
  for (const auto& [word, weight] : words) bow.push_back(word, weight);
  bow.normalize(Norm::kL1);
  return bow;
}

}  // namespace dynslam::loop::benchmark_data
