// The simple rules: histograms of displacement length and of key point rotation, and none at all.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/matching/pairs.hpp"
#include "dynslam/matching/workspace.hpp"

namespace dynslam::matching {

/// Keeps every match with weight 1 (NaN and infinite points never get as far as a rule).
struct NullRule {
  void operator()(const PairsView&, Span<std::uint8_t> keep, Span<float> weight, Workspace&) const {
    std::fill(keep.begin(), keep.end(), std::uint8_t{1});
    std::fill(weight.begin(), weight.end(), 1.0F);
  }
};

namespace detail {

/// Histogram of displacement lengths d_i = |p_i - q_i| (P-Mixed 3.2): gamma = ceil(sqrt N),
/// L = (dmax - dmin) / gamma, bin k = floor((d - dmin) / L), k = 0 .. gamma (the last bin holds
/// dmax alone, the paper's intervals being half open). All displacements equal (L = 0): one bin.
struct DisplacementHistogram {
  DisplacementHistogram(const PairsView& pairs, Workspace& workspace)
      : bin_of(workspace.take<std::uint32_t>(pairs.size())) {
    const std::size_t n = pairs.size();
    const auto length = workspace.take<double>(n);
    double low = std::numeric_limits<double>::infinity();
    double high = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      const double dx = static_cast<double>(pairs.x1[i]) - static_cast<double>(pairs.x2[i]);
      const double dy = static_cast<double>(pairs.y1[i]) - static_cast<double>(pairs.y2[i]);
      length[i] = std::sqrt(dx * dx + dy * dy);
      low = std::min(low, length[i]);
      high = std::max(high, length[i]);
    }
    const auto gamma = static_cast<std::size_t>(std::ceil(std::sqrt(static_cast<double>(n))));
    counts = workspace.take_filled<std::uint32_t>(gamma + 1, 0);
    const double width = (high - low) / static_cast<double>(std::max<std::size_t>(gamma, 1));
    const double origin = low < width ? 0.0 : low;
    for (std::size_t i = 0; i < n; ++i) {
      const double k = width > 0.0 ? (length[i] - origin) / width : 0.0;
      bin_of[i] = static_cast<std::uint32_t>(std::min(k, static_cast<double>(gamma)));
      ++counts[bin_of[i]];
    }
    mode =
        static_cast<std::size_t>(std::max_element(counts.begin(), counts.end()) - counts.begin());
  }

  double peak() const { return counts[mode]; }

  Span<std::uint32_t> bin_of;  // bin of each pair
  Span<std::uint32_t> counts;  // pairs in each bin
  std::size_t mode = 0;        // first bin with the largest count
};

/// Keeps the pairs in kept bins; the weight is the bin's count over that of the mode.
inline void keep_bins(const DisplacementHistogram& histogram, Span<const std::uint8_t> kept_bin,
                      Span<std::uint8_t> keep, Span<float> weight) {
  for (std::size_t i = 0; i < keep.size(); ++i) {
    const std::uint32_t k = histogram.bin_of[i];
    keep[i] = kept_bin[k];
    weight[i] = static_cast<float>(histogram.counts[k] / histogram.peak());
  }
}

inline double checked_fraction(double tau, const char* function) {
  require(tau > 0.0 && tau <= 1.0, function, "tau", tau, "a fraction in (0, 1]");
  return tau;
}

}  // namespace detail

/// Keeps the bins of the displacement histogram with at least `tau` times the count of the fullest.
///
/// Weight: the bin's count over that of the fullest. One match, or all displacements equal: all are
/// kept. Throws InvalidArgument unless 0 < tau <= 1. Cost O(N).
class FractionOfMode {
 public:
  explicit FractionOfMode(double tau = 0.3)
      : tau_(detail::checked_fraction(tau, "FractionOfMode")) {}

  void operator()(const PairsView& pairs, Span<std::uint8_t> keep, Span<float> weight,
                  Workspace& workspace) const {
    if (pairs.empty()) return;
    const detail::DisplacementHistogram histogram(pairs, workspace);
    const auto kept_bin = workspace.take<std::uint8_t>(histogram.counts.size());
    for (std::size_t k = 0; k < kept_bin.size(); ++k) {
      kept_bin[k] = histogram.counts[k] >= tau_ * histogram.peak() ? 1 : 0;
    }
    detail::keep_bins(histogram, kept_bin, keep, weight);
  }

 private:
  double tau_;
};

/// P-Mixed 3.2 to the letter: keeps the bins with `p_k >= Pc = max_k p_k`, that is the modal bin,
/// and those as full.
///
/// Loses good matches as soon as the camera turns or moves forward, and keeps wrong ones that
/// happen to be as long: it is here as the paper's baseline.
class ModalBin {
 public:
  void operator()(const PairsView& pairs, Span<std::uint8_t> keep, Span<float> weight,
                  Workspace& workspace) const {
    FractionOfMode(1.0)(pairs, keep, weight, workspace);
  }
};

/// Keeps the run of neighbouring bins around the mode that hold at least `tau` times its count.
///
/// Weight and degenerate cases as `FractionOfMode`. Throws InvalidArgument unless 0 < tau <= 1.
class ContiguousMode {
 public:
  explicit ContiguousMode(double tau = 0.15)
      : tau_(detail::checked_fraction(tau, "ContiguousMode")) {}

  void operator()(const PairsView& pairs, Span<std::uint8_t> keep, Span<float> weight,
                  Workspace& workspace) const {
    if (pairs.empty()) return;
    const detail::DisplacementHistogram histogram(pairs, workspace);
    const auto kept_bin = workspace.take_filled<std::uint8_t>(histogram.counts.size(), 0);
    const auto full = [&](std::size_t k) { return histogram.counts[k] >= tau_ * histogram.peak(); };
    for (std::size_t k = histogram.mode; k < kept_bin.size() && full(k); ++k) kept_bin[k] = 1;
    for (std::size_t k = histogram.mode; k > 0 && full(k - 1); --k) kept_bin[k - 1] = 1;
    detail::keep_bins(histogram, kept_bin, keep, weight);
  }

 private:
  double tau_;
};

/// Options of `RotationConsistency`.
struct RotationConsistencyOptions {
  int bins = 30;               ///< bins over 360 degrees, 3 to 360. Engineering.
  int kept_peaks = 3;          ///< fullest bins that are kept, 1 to `bins`. Engineering.
  double minimum_share = 0.1;  ///< a kept bin holds at least this share of the fullest one's count,
                               ///< in [0, 1]. Engineering.

  /// Throws InvalidArgument naming the member.
  void validate() const {
    require(bins >= 3 && bins <= 360, "RotationConsistencyOptions", "bins", bins, "3 to 360");
    require(kept_peaks >= 1 && kept_peaks <= bins, "RotationConsistencyOptions", "kept_peaks",
            kept_peaks, "1 to the number of bins");
    require(minimum_share >= 0.0 && minimum_share <= 1.0, "RotationConsistencyOptions",
            "minimum_share", minimum_share, "a fraction in [0, 1]");
  }
};

/// Keeps the matches whose key points turn alike: histogram of angle 2 minus angle 1, fullest bins.
///
/// A static scene turns as a whole in the image, by the camera's roll. Weight: the bin's count over
/// that of the fullest. Matches without both angles are kept with weight 1, since nothing speaks
/// against them; so are all if the host has no angles. Cost O(N).
class RotationConsistency {
 public:
  RotationConsistency() = default;
  explicit RotationConsistency(const RotationConsistencyOptions& options) : options_(options) {
    options_.validate();
  }

  void operator()(const PairsView& pairs, Span<std::uint8_t> keep, Span<float> weight,
                  Workspace& workspace) const {
    std::fill(keep.begin(), keep.end(), std::uint8_t{1});
    std::fill(weight.begin(), weight.end(), 1.0F);
    if (pairs.rotation.empty()) return;
    const auto counts =
        workspace.take_filled<std::uint32_t>(static_cast<std::size_t>(options_.bins), 0);
    for (const float turn : pairs.rotation) {
      if (turn == turn) ++counts[bin(turn)];
    }
    const auto sorted = workspace.take<std::uint32_t>(counts.size());
    std::copy(counts.begin(), counts.end(), sorted.begin());
    std::sort(sorted.begin(), sorted.end(), std::greater<>());
    if (sorted[0] == 0) return;
    const double peak = sorted[0];
    const double least =
        std::max({static_cast<double>(sorted[peaks() - 1]), options_.minimum_share * peak, 1.0});
    for (std::size_t i = 0; i < pairs.size(); ++i) {
      const float turn = pairs.rotation[i];
      if (turn != turn) continue;
      const double count = counts[bin(turn)];
      keep[i] = count >= least ? 1 : 0;
      weight[i] = static_cast<float>(count / peak);
    }
  }

 private:
  std::size_t peaks() const { return static_cast<std::size_t>(options_.kept_peaks); }

  /// Bins are centred on multiples of their width: no turn at all lies in the middle of the first.
  std::size_t bin(float turn) const {
    const auto count = static_cast<std::size_t>(options_.bins);
    const float k = turn * static_cast<float>(options_.bins) / 360.0F + 0.5F;
    return static_cast<std::size_t>(k) % count;
  }

  RotationConsistencyOptions options_;
};

}  // namespace dynslam::matching
