// Roll and zoom between two images, from the key points' own angles and sizes or from pairs of
// matches.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "dynslam/matching/pairs.hpp"

namespace dynslam::matching::detail {

/// Roll and zoom of the second image against the first.
struct Similarity {
  float cosine = 1.0F;    ///< times zoom
  float sine = 0.0F;      ///< times zoom
  bool doubtful = false;  ///< not from the key points: compare it with the identity
};

/// Votes for roll and zoom, at most `kCapacity`.
struct SimilarityVotes {
  static constexpr std::size_t kCapacity = 512;

  void push(float turn, float zoom) {
    if (!(turn >= 0.0F && turn <= 360.0F)) return;
    turns[size] = turn;
    zooms[size] = zoom;
    ++size;
  }

  float turns[kCapacity];  // degrees in [0, 360]
  float zooms[kCapacity];  // 0 where not known
  std::size_t size = 0;
};

/// A vote a match, by its key points.
inline void vote_by_keypoints(const PairsView& pairs, SimilarityVotes& votes) {
  const std::size_t step = (pairs.size() + votes.kCapacity - 1) / votes.kCapacity;
  for (std::size_t i = 0; i < pairs.size(); i += step) {
    votes.push(pairs.rotation[i], pairs.zoom.empty() ? 0.0F : pairs.zoom[i]);
  }
}

/// A vote a pair of matches, by how the line between their points turns and stretches. Two right
/// matches vote for the truth wherever they lie.
inline void vote_by_lines(const PairsView& pairs, SimilarityVotes& votes) {
  const std::size_t n = pairs.size();
  for (const std::size_t offset : {n / 2, n / 3}) {
    const std::size_t step = std::max<std::size_t>(1, 2 * n / votes.kCapacity);
    for (std::size_t i = 0; i < n && votes.size < votes.kCapacity; i += step) {
      const std::size_t j = (i + offset) % n;
      const float ax = pairs.x1[j] - pairs.x1[i];
      const float ay = pairs.y1[j] - pairs.y1[i];
      const float bx = pairs.x2[j] - pairs.x2[i];
      const float by = pairs.y2[j] - pairs.y2[i];
      const float a2 = ax * ax + ay * ay;
      const float b2 = bx * bx + by * by;
      if (!(a2 > 0.0F && b2 > 0.0F)) continue;
      const float turn = std::atan2(ax * by - ay * bx, ax * bx + ay * by) * 57.29578F;
      votes.push(turn < 0.0F ? turn + 360.0F : turn, std::sqrt(b2 / a2));
    }
  }
}

/// The most frequent roll and the median zoom of the votes for it; identity where none stands out.
/// O(1): at most 512 votes.
inline Similarity dominant_similarity(const PairsView& pairs) {
  constexpr int kBins = 36;
  constexpr float kWidth = 360.0F / kBins;
  Similarity result;
  if (pairs.size() < 3) return result;
  SimilarityVotes votes;
  if (!pairs.rotation.empty()) vote_by_keypoints(pairs, votes);
  const bool by_lines = votes.size == 0;
  if (by_lines) vote_by_lines(pairs, votes);
  if (votes.size == 0) return result;
  int counts[kBins + 1] = {};
  for (std::size_t i = 0; i < votes.size; ++i) {
    ++counts[static_cast<int>(votes.turns[i] * (1.0F / kWidth))];
  }
  counts[0] += counts[kBins];  // 360 degrees, by rounding
  int best = 0;
  int best_count = 0;
  for (int k = 0; k < kBins; ++k) {
    const int window = counts[(k + kBins - 1) % kBins] + counts[k] + counts[(k + 1) % kBins];
    if (window > best_count) {
      best = k;
      best_count = window;
    }
  }
  // Evenly spread votes put a twelfth into three of 36 bins: four sigma above that is no chance.
  const float total = static_cast<float>(votes.size);
  constexpr float kChance = 3.0F / kBins;
  const float least = kChance * total + 4.0F * std::sqrt(kChance * (1.0F - kChance) * total);
  if (static_cast<float>(best_count) < least) return result;
  // Medians, since the window holds votes by chance as well.
  const float centre = (static_cast<float>(best) + 0.5F) * kWidth;
  SimilarityVotes window;
  std::size_t zooms = 0;
  for (std::size_t i = 0; i < votes.size; ++i) {
    float offset = votes.turns[i] - centre;
    if (offset > 180.0F) offset -= 360.0F;
    if (offset < -180.0F) offset += 360.0F;
    if (std::abs(offset) > 1.5F * kWidth) continue;
    window.turns[window.size++] = offset;
    if (votes.zooms[i] > 0.0F) window.zooms[zooms++] = votes.zooms[i];
  }
  const auto median = [](float* values, std::size_t size, float otherwise) {
    if (size == 0) return otherwise;
    std::nth_element(values, values + size / 2, values + size);
    return values[size / 2];
  };
  const float turn = (centre + median(window.turns, window.size, 0.0F)) * 0.017453293F;
  const float middle = median(window.zooms, zooms, 1.0F);
  // Key point sizes come in steps of an octave, so their median does too: the mean around it is
  // finer. Halving and doubling cancel in this mean, as they do in that of log(zoom).
  float sum = 0.0F;
  float count = 0.0F;
  for (std::size_t i = 0; i < zooms; ++i) {
    const float ratio = window.zooms[i] / middle;
    if (ratio < 0.66F || ratio > 1.5F) continue;
    sum += (ratio - 1.0F) / (ratio + 1.0F);
    count += 1.0F;
  }
  const float mean = sum / std::max(count, 1.0F);
  const float zoom = std::min(std::max(middle * (1.0F + mean) / (1.0F - mean), 0.125F), 8.0F);
  result.doubtful = by_lines;
  result.cosine = zoom * std::cos(turn);
  result.sine = zoom * std::sin(turn);
  return result;
}

}  // namespace dynslam::matching::detail
