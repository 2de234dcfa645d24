// How many neighbours of a match in the first image moved as it did.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "dynslam/core/span.hpp"
#include "dynslam/matching/detail/dominant_similarity.hpp"
#include "dynslam/matching/detail/lanes.hpp"
#include "dynslam/matching/pairs.hpp"
#include "dynslam/matching/workspace.hpp"

namespace dynslam::matching::detail {

/// What counts as moving alike.
struct SupportTolerance {
  float pixels;        ///< difference of displacements that is always allowed
  float slope;         ///< and this times the distance in the first image on top (in quadrature)
  float independence;  ///< neighbours nearer than this in either image are no evidence of their own
};

/// Range that holds the bulk of the values: from a sample of 64, widened by a quarter on each side,
/// so that a few absurd coordinates do not stretch the grid.
inline void bulk_range(Span<const float> values, float& low, float& high) {
  constexpr std::size_t kSample = 64;
  float sample[kSample];
  const std::size_t step = std::max<std::size_t>(1, values.size() / kSample);
  std::size_t count = 0;
  for (std::size_t i = 0; i < values.size() && count < kSample; i += step) {
    sample[count++] = values[i];
  }
  std::sort(sample, sample + count);
  const float p5 = sample[count / 20];
  const float p95 = sample[count - 1 - count / 20];
  low = p5 - 0.25F * (p95 - p5);
  high = p95 + 0.25F * (p95 - p5);
}

/// The matches sorted by the cell of a grid over the first image, and the support of each.
///
/// Support of i is the sum over matches j in the 3 x 3 cells around it of a weight that is 1 where
/// both moved alike and falls to 0 at the tolerance. With three matches a cell on average there are
/// about 26 candidates whatever the number of matches, so that the cost is O(N); where points crowd
/// the candidates are capped. Each pair is looked at once and counts for both.
class LocalSupport {
 public:
  LocalSupport(const PairsView& pairs, const SupportTolerance& tolerance,
               const Similarity& similarity, Workspace& workspace)
      : size_(pairs.size()),
        tolerance_(tolerance),
        ax_(workspace.take<float>(size_ + kPadding)),
        ay_(workspace.take<float>(size_ + kPadding)),
        bx_(workspace.take<float>(size_ + kPadding)),
        by_(workspace.take<float>(size_ + kPadding)),
        support_(workspace.take_filled<float>(size_ + kPadding, 0.0F)),
        source_(workspace.take<std::uint32_t>(size_)),
        cell_(workspace.take<std::uint32_t>(size_)) {
    sort_into_cells(pairs, similarity, workspace);
    count_pairs();
  }

  /// Support of the k-th match in grid order.
  Span<const float> support() const { return {support_.data(), size_}; }

  /// Number of matches with more than `minimum`.
  std::size_t count_above(float minimum) const {
    std::size_t count = 0;
    for (const float s : support()) count += s > minimum;
    return count;
  }

  /// Which match of the input is the k-th in grid order.
  Span<const std::uint32_t> source() const { return source_; }

  /// Mean of `value` (in grid order, padded by four finite numbers) over the neighbours that
  /// support k, weighted by how much they do; 0 if none does.
  float mean_over_supporters(std::size_t k, Span<const float> value) const {
    Float4 sum = Float4::Zero();
    Float4 weights = Float4::Zero();
    const std::size_t column = cell_[k] % columns_;
    const std::size_t row = cell_[k] / columns_;
    for (std::size_t r = row > 0 ? row - 1 : 0; r <= std::min(row + 1, rows_ - 1); ++r) {
      const std::size_t first = start_[r * columns_ + (column > 0 ? column - 1 : 0)];
      const std::size_t last = start_[r * columns_ + std::min(column + 1, columns_ - 1) + 1];
      weigh(k, first, last, [&](std::size_t j, const Float4& weight) {
        sum += weight * load(value.data() + j);
        weights += weight;
      });
    }
    const float total = weights.sum();
    return total > 0.0F ? sum.sum() / total : 0.0F;
  }

 private:
  static constexpr std::size_t kPadding = 8;
  static constexpr std::size_t kCap = 16;
  static constexpr float kMatchesPerCell = 3.0F;

  void sort_into_cells(const PairsView& pairs, const Similarity& similarity, Workspace& workspace) {
    const auto x = workspace.take<float>(size_);
    const auto y = workspace.take<float>(size_);
    for (std::size_t i = 0; i < size_; ++i) {
      x[i] = similarity.cosine * pairs.x1[i] - similarity.sine * pairs.y1[i];
      y[i] = similarity.sine * pairs.x1[i] + similarity.cosine * pairs.y1[i];
    }
    float left, right, top, bottom;
    bulk_range(x, left, right);
    bulk_range(y, top, bottom);
    const float width = right - left;
    const float height = bottom - top;
    const float per_match = kMatchesPerCell / static_cast<float>(size_);
    // The second term bounds the number of cells when the points lie on a line.
    const float side = std::max(
        {std::sqrt(width * height * per_match), std::max(width, height) * per_match, 1e-3F});
    columns_ = static_cast<std::size_t>(width / side) + 1;
    rows_ = static_cast<std::size_t>(height / side) + 1;
    start_ = workspace.take_filled<std::uint32_t>(columns_ * rows_ + 1, 0);
    const auto cell = workspace.take<std::uint32_t>(size_);
    const auto index = [&](float value, float low, std::size_t count) {
      const float k = std::max(0.0F, (value - low) / side);
      return std::min(static_cast<std::size_t>(k), count - 1);
    };
    for (std::size_t i = 0; i < size_; ++i) {
      cell[i] = static_cast<std::uint32_t>(index(y[i], top, rows_) * columns_ +
                                           index(x[i], left, columns_));
      ++start_[cell[i] + 1];
    }
    for (std::size_t c = 0; c < columns_ * rows_; ++c) start_[c + 1] += start_[c];
    const auto next = workspace.take<std::uint32_t>(columns_ * rows_);
    std::copy(start_.begin(), start_.begin() + next.size(), next.begin());
    for (std::size_t i = 0; i < size_; ++i) {
      const std::size_t k = next[cell[i]]++;
      source_[k] = static_cast<std::uint32_t>(i);
      cell_[k] = cell[i];
      ax_[k] = x[i];
      ay_[k] = y[i];
      bx_[k] = pairs.x2[i];
      by_[k] = pairs.y2[i];
    }
    for (std::size_t k = size_; k < size_ + kPadding; ++k) ax_[k] = ay_[k] = bx_[k] = by_[k] = 0;
  }

  /// Each pair once: the later matches of the own cell, the next cell, and three cells below.
  void count_pairs() {
    for (std::size_t row = 0; row < rows_; ++row) {
      for (std::size_t column = 0; column < columns_; ++column) count_cell(row, column);
    }
  }

  void count_cell(std::size_t row, std::size_t column) {
    const std::size_t cell = row * columns_ + column;
    const std::size_t right = std::min(column + 1, columns_ - 1);
    const std::size_t last = start_[row * columns_ + right + 1];
    std::size_t first_below = 0;
    std::size_t last_below = 0;
    if (row + 1 < rows_) {
      const std::size_t below = (row + 1) * columns_;
      first_below = start_[below + (column > 0 ? column - 1 : 0)];
      last_below = start_[below + right + 1];
    }
    for (std::size_t k = start_[cell]; k < start_[cell + 1]; ++k) {
      Float4 sum = Float4::Zero();
      const auto add = [&](std::size_t j, const Float4& weight) {
        sum += weight;
        store(load(support_.data() + j) + weight, support_.data() + j);
      };
      weigh(k, k + 1, last, add);
      weigh(k, first_below, last_below, add);
      support_[k] += sum.sum();
    }
  }

  /// Calls `visit(j, weights)` for the pairs (k, j) .. (k, j + 3), j from `first` on in steps of
  /// four; weights of pairs beyond `last` or beyond the cap are 0.
  template <typename Visit>
  void weigh(std::size_t k, std::size_t first, std::size_t last, Visit visit) const {
    const float t2 = tolerance_.pixels * tolerance_.pixels;
    const float s2 = tolerance_.slope * tolerance_.slope;
    const float d2 = 1.0F / (tolerance_.independence * tolerance_.independence);
    const float ak = ax_[k], bk = ay_[k], ck = bx_[k], dk = by_[k];
    last = std::min(last, first + kCap);
    for (std::size_t j = first; j < last; j += 4) {
      const Float4 ax = load(ax_.data() + j) - ak;
      const Float4 ay = load(ay_.data() + j) - bk;
      const Float4 bx = load(bx_.data() + j) - ck;
      const Float4 by = load(by_.data() + j) - dk;
      const Float4 ex = bx - ax;
      const Float4 ey = by - ay;
      const Float4 a2 = ax * ax + ay * ay;
      const Float4 b2 = bx * bx + by * by;
      const Float4 alike = (1.0F - (ex * ex + ey * ey) / (t2 + s2 * a2)).max(0.0F);
      const Float4 apart = a2.min(b2) * d2;
      visit(j, alike * (apart * apart).min(1.0F) * first_lanes(last - j));
    }
  }

  std::size_t size_;
  SupportTolerance tolerance_;
  Span<float> ax_, ay_;  // first image, turned and zoomed onto the second
  Span<float> bx_, by_;  // second image
  Span<float> support_;
  Span<std::uint32_t> source_;
  Span<std::uint32_t> cell_;
  Span<std::uint32_t> start_;  // first match of each cell in grid order
  std::size_t columns_ = 0;
  std::size_t rows_ = 0;
};

}  // namespace dynslam::matching::detail
