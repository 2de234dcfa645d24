// The fundamental matrix that most of a nearly clean set of matches agrees on.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>

#include "dynslam/matching/detail/epipolar_fit.hpp"

namespace dynslam::matching::detail {

struct SearchOptions {
  float limit;             ///< Sampson distance at which a match counts as wrong, fit coordinates
  int maximum_hypotheses;  ///< samples drawn at most
  std::uint32_t seed;
};

inline constexpr std::size_t kSampleSize = 8;

/// A hypothesis and its truncated cost.
struct Candidate {
  Matrix3d f = Matrix3d::Zero();
  float cost = std::numeric_limits<float>::infinity();

  bool exists() const { return cost < std::numeric_limits<float>::infinity(); }
};

/// Draws eight-point samples, one from each eighth of the points' order (grid order, so that a
/// sample is spread over the image), and keeps the best three. Stops when a sample without a wrong
/// match has been drawn with a probability of 99 %, by the share that agrees with the best.
template <std::size_t kCount>
void sample_hypotheses(const FitPoints& points, const SearchOptions& options,
                       Candidate (&best)[kCount]) {
  constexpr int kMinimumHypotheses = 8;
  float total = 0.0F;
  for (std::size_t i = 0; i < points.size; ++i) total += points.weight[i];
  std::uint32_t state = (options.seed * 2654435761U + 12345U) | 1U;
  for (int h = 1; h <= options.maximum_hypotheses; ++h) {
    std::size_t index[kSampleSize];
    for (std::size_t q = 0; q < kSampleSize; ++q) {
      const std::size_t first = q * points.size / kSampleSize;
      const std::size_t last = (q + 1) * points.size / kSampleSize;
      state ^= state << 13;
      state ^= state >> 17;
      state ^= state << 5;
      index[q] = first + static_cast<std::size_t>((std::uint64_t{state} * (last - first)) >> 32);
    }
    Candidate candidate;
    if (!fit_eight(points, index, candidate.f)) continue;
    candidate.cost = truncated_cost(candidate.f, points, options.limit);
    for (Candidate& place : best) {
      if (candidate.cost < place.cost) std::swap(candidate, place);
    }
    const float share = std::max(0.0F, 1.0F - best[0].cost / total);
    const float share2 = share * share;
    const float all_right = share2 * share2 * share2 * share2;  // eight times
    if (h >= kMinimumHypotheses && static_cast<float>(h) * all_right > 4.6F) break;
  }
}

/// Refines the best three hypotheses and gives the best of these. False if there is none (fewer
/// than eight points, or all samples degenerate). O(points x hypotheses), no allocation.
inline bool search_geometry(const FitPoints& points, const SearchOptions& options, Matrix3d& f) {
  if (points.size < kSampleSize) return false;
  Candidate candidates[3];
  sample_hypotheses(points, options, candidates);
  Candidate best;
  for (Candidate& candidate : candidates) {
    if (!candidate.exists()) continue;
    for (const float relaxed : {2.0F, 1.0F, 1.0F}) {
      refine(candidate.f, points, relaxed * options.limit);
    }
    candidate.cost = truncated_cost(candidate.f, points, options.limit);
    if (candidate.cost < best.cost) best = candidate;
  }
  if (best.exists()) f = best.f;
  return best.exists();
}

}  // namespace dynslam::matching::detail
