// What the RANSAC searches share: samples, when to stop, and how surprising a model is.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "dynslam/loop/verification.hpp"

namespace dynslam::loop {

/// SplitMix64 (Steele et al. 2014): the same numbers on every machine.
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}
  std::uint32_t below(std::uint32_t n) {
    state_ += 0x9E3779B97F4A7C15ULL;
    std::uint64_t z = state_;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
    z ^= z >> 31;
    return static_cast<std::uint32_t>(((z >> 32) * n) >> 32);
  }

  /// K different numbers below n >= K.
  template <std::size_t K>
  std::array<std::uint32_t, K> sample(std::uint32_t n) {
    std::array<std::uint32_t, K> chosen;
    for (std::size_t i = 0; i < K;) {
      chosen[i] = below(n);
      if (std::find(chosen.begin(), chosen.begin() + static_cast<std::ptrdiff_t>(i), chosen[i]) ==
          chosen.begin() + static_cast<std::ptrdiff_t>(i))
        ++i;
    }
    return chosen;
  }

 private:
  std::uint64_t state_;
};

/// Samples of `size` to draw until one is free of outliers with the options' confidence.
inline int iterations_needed(std::size_t inliers, std::size_t matches, int size,
                             const RansacOptions& options) {
  const double good = std::pow(static_cast<double>(inliers) / static_cast<double>(matches), size);
  if (good >= 1.0) return 1;
  const double needed = std::log(1.0 - options.confidence) / std::log1p(-good);
  return needed < options.max_iterations ? std::max(1, static_cast<int>(std::ceil(needed)))
                                         : options.max_iterations;
}

/// Bounds that random matches are compared with.
struct NullModel {
  std::size_t sample = 0;    ///< matches that determine a model
  double solutions = 1.0;    ///< models of a sample
  double probability = 1.0;  ///< that a random match agrees with a model
};

/// -log10 of the number of false alarms: solutions (n - s) C(n, k) C(k, s) p^(k - s).
/// Source: Moisan & Stival, IJCV 2004.
inline double significance(std::size_t inliers, std::size_t matches, const NullModel& null) {
  if (inliers <= null.sample || matches <= null.sample) return 0.0;
  const auto log_choose = [](double n, double k) {
    return std::lgamma(n + 1.0) - std::lgamma(k + 1.0) - std::lgamma(n - k + 1.0);
  };
  const auto n = static_cast<double>(matches), k = static_cast<double>(inliers),
             s = static_cast<double>(null.sample);
  const double log_alarms = std::log(null.solutions * (n - s)) + log_choose(n, k) +
                            log_choose(k, s) +
                            (k - s) * std::log(std::clamp(null.probability, 1e-300, 1.0));
  return -log_alarms / std::log(10.0);
}

/// Number of different places, within a pixel or so, of the flagged columns. NaN is no place.
template <typename Points>
std::size_t different_places(const Points& pixels, const std::vector<std::uint8_t>& flags) {
  std::vector<std::uint64_t> cells;
  cells.reserve(flags.size());
  for (std::size_t i = 0; i < flags.size(); ++i) {
    if (flags[i] == 0) continue;
    const auto c = static_cast<Eigen::Index>(i);
    const auto cell = [&](double x) {
      return static_cast<std::uint32_t>(
          static_cast<std::int32_t>(std::floor(std::clamp(x * 0.5, -1e9, 1e9))));
    };
    cells.push_back(std::uint64_t{cell(pixels(0, c))} << 32 | cell(pixels(1, c)));
  }
  std::sort(cells.begin(), cells.end());
  return static_cast<std::size_t>(std::unique(cells.begin(), cells.end()) - cells.begin());
}

/// Fills in verdict, inliers and confidence from the counts of different places.
inline void judge(Verification& result, std::size_t matches, std::size_t inliers,
                  const NullModel& null, const RansacOptions& options) {
  result.inliers = inliers;
  const double surprise = significance(inliers, matches, null);
  const double least = std::max(options.min_significance, 1e-9);
  // Beside the significance the number of inliers counts: few of few may be surprising, too.
  const double by_number = static_cast<double>(inliers) / static_cast<double>(options.min_inliers);
  result.confidence = options.min_significance > 0.0
                          ? std::min(by_number, std::max(0.0, surprise / least))
                          : by_number;
  const bool enough = inliers >= options.min_inliers &&
                      (options.min_significance <= 0.0 || surprise >= options.min_significance);
  result.verdict = enough ? Verdict::kVerified : Verdict::kNoGeometry;
}

}  // namespace dynslam::loop
