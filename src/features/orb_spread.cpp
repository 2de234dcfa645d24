#include "features/orb_spread.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>

namespace dynslam::features::detail {

void MaskProbe::reset(MaskView mask, int margin) {
  mask_ = mask;
  margin_ = margin;
  if (mask.empty() || margin == 0) return;
  const std::size_t stride = static_cast<std::size_t>(mask.width) + 1;
  sums_.assign(stride * (static_cast<std::size_t>(mask.height) + 1), 0);
  for (int y = 0; y < mask.height; ++y) {
    const std::uint8_t* pixels = mask.row(y);
    const std::int32_t* above = sums_.data() + static_cast<std::size_t>(y) * stride;
    std::int32_t* sums = sums_.data() + static_cast<std::size_t>(y + 1) * stride;
    std::int32_t row_sum = 0;
    for (int x = 0; x < mask.width; ++x) {
      row_sum += pixels[x] != 0;
      sums[x + 1] = above[x + 1] + row_sum;
    }
  }
}

bool MaskProbe::is_set(int x, int y) const {
  if (margin_ == 0) return mask_(x, y) != 0;
  const std::ptrdiff_t stride = mask_.width + 1;
  const int left = std::max(x - margin_, 0);
  const int right = std::min(x + margin_, mask_.width - 1) + 1;
  const std::int32_t* top = sums_.data() + std::max(y - margin_, 0) * stride;
  const std::int32_t* bottom =
      sums_.data() + (std::min(y + margin_, mask_.height - 1) + 1) * stride;
  return bottom[right] - bottom[left] - top[right] + top[left] != 0;
}

int CornerChooser::drop_masked(const MaskProbe& mask, float scale, Corner* corners, int count) {
  const auto covered = [&](const Corner& corner) { return is_covered(mask, scale, corner); };
  return static_cast<int>(std::remove_if(corners, corners + count, covered) - corners);
}

int CornerChooser::drop_weak(int cell_size, int threshold, const PixelBlock& level, Corner* corners,
                             int count) {
  const int cells_in_row = (level.width - 1) / cell_size + 1;
  const int cell_rows = (level.height - 1) / cell_size + 1;
  columns_.resize(static_cast<std::size_t>(level.width));
  for (int x = 0; x < level.width; ++x) columns_[static_cast<std::size_t>(x)] = x / cell_size;
  cell_has_strong_.assign(
      static_cast<std::size_t>(cells_in_row) * static_cast<std::size_t>(cell_rows), 0);
  const auto cell_of = [&](const Corner& corner) -> std::uint8_t& {
    const std::ptrdiff_t row = corner.y / cell_size;
    return cell_has_strong_[static_cast<std::size_t>(row * cells_in_row + columns_[corner.x])];
  };
  for (int i = 0; i < count; ++i) {
    if (corners[i].score >= threshold) cell_of(corners[i]) = 1;
  }
  const auto weak = [&](const Corner& corner) {
    return corner.score < threshold && cell_of(corner) != 0;
  };
  return static_cast<int>(std::remove_if(corners, corners + count, weak) - corners);
}

namespace {

/// The lower 16 bits moved to the even places.
std::uint32_t spread_bits(std::uint32_t v) {
  v = (v | (v << 8)) & 0x00FF00FFU;
  v = (v | (v << 4)) & 0x0F0F0F0FU;
  v = (v | (v << 2)) & 0x33333333U;
  return (v | (v << 1)) & 0x55555555U;
}

/// Path to a pixel in the quadtree: two bits for each quartering, the first one highest.
std::uint32_t quadtree_path(const Corner& corner) {
  return spread_bits(corner.x) | (spread_bits(corner.y) << 1);
}

constexpr int kPathShift = 32;
constexpr int kDigitBits = 11;

std::uint32_t path_of(std::uint64_t entry) {
  return static_cast<std::uint32_t>(entry >> kPathShift);
}

}  // namespace

/// Orders the corners by their path: every square of the quadtree is then a range. Radix sort,
/// since thousands of corners are common and paths are short.
void CornerChooser::sort_by_place(const std::vector<Corner>& corners) {
  sorted_.resize(corners.size());
  scratch_.resize(corners.size());
  std::uint32_t all_bits = 0;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const std::uint32_t path = quadtree_path(corners[i]);
    all_bits |= path;
    sorted_[i] = (static_cast<std::uint64_t>(path) << kPathShift) | i;
  }
  for (int shift = 0; shift < 32 && (all_bits >> shift) != 0; shift += kDigitBits) {
    constexpr std::size_t digits = std::size_t{1} << kDigitBits;
    std::uint32_t starts[digits + 1] = {};
    const auto digit = [shift](std::uint64_t entry) {
      return (path_of(entry) >> shift) & (digits - 1);
    };
    for (const std::uint64_t entry : sorted_) ++starts[digit(entry) + 1];
    std::partial_sum(starts, starts + digits, starts);
    for (const std::uint64_t entry : sorted_) scratch_[starts[digit(entry)]++] = entry;
    sorted_.swap(scratch_);
  }
}

/// Quarters a node by the two bits of the path at 2 `shift`; appends the parts to `leaves_` (single
/// corners) or `next_`. Returns how many parts hold corners.
int CornerChooser::split(const Node& node, int shift) {
  int parts = 0;
  const auto begin = sorted_.begin();
  std::int32_t first = node.first;
  while (first < node.last) {
    // The quarter of the first corner left ends where a path leaves its prefix.
    const std::uint32_t prefix = path_of(sorted_[static_cast<std::size_t>(first)]) >> (2 * shift);
    const auto after = std::partition_point(
        begin + first, begin + node.last,
        [&](std::uint64_t entry) { return (path_of(entry) >> (2 * shift)) <= prefix; });
    const std::int32_t last = static_cast<std::int32_t>(after - begin);
    (last - first == 1 ? leaves_ : next_).push_back({first, last});
    first = last;
    ++parts;
  }
  return parts;
}

/// Leaves `leaves_` and `open_` with `target` nodes, or up to two more.
void CornerChooser::grow_tree(int target) {
  const std::int32_t count = static_cast<std::int32_t>(sorted_.size());
  // Lists that change places have to be of one size, or each has to grow in its turn.
  for (std::vector<Node>* nodes : {&leaves_, &open_, &next_}) {
    nodes->reserve(static_cast<std::size_t>(target) + 4);
  }
  leaves_.clear();
  open_.assign(1, {0, count});
  int nodes = 1;
  for (int shift = 15; shift >= 0 && nodes < target; --shift) {
    const int open = static_cast<int>(open_.size());
    if (nodes + 3 * open > target) {
      std::sort(open_.begin(), open_.end(), [](const Node& a, const Node& b) {
        const std::int32_t size_a = a.last - a.first;
        const std::int32_t size_b = b.last - b.first;
        return size_a != size_b ? size_a > size_b : a.first < b.first;
      });
    }
    next_.clear();
    for (const Node& node : open_) {
      if (nodes < target) {
        nodes += split(node, shift) - 1;
      } else {
        next_.push_back(node);
      }
    }
    open_.swap(next_);
  }
}

int CornerChooser::score_at(const std::vector<Corner>& corners, std::int32_t i) const {
  return corners[static_cast<std::uint32_t>(sorted_[static_cast<std::size_t>(i)])].score;
}

std::int32_t CornerChooser::strongest(const Node& node, const std::vector<Corner>& corners) const {
  std::int32_t best = node.first;
  for (std::int32_t i = node.first + 1; i < node.last; ++i) {
    if (score_at(corners, i) > score_at(corners, best)) best = i;
  }
  return best;
}

/// Marks one corner of each square of the quadtree, `count` at most.
void CornerChooser::pick_evenly(const std::vector<Corner>& corners, int count) {
  grow_tree(count);
  picks_.clear();
  for (const Node& leaf : leaves_) picks_.push_back(leaf.first);
  for (const Node& node : open_) picks_.push_back(strongest(node, corners));
  // The last split may have made more nodes than asked for: the weakest go.
  if (picks_.size() > static_cast<std::size_t>(count)) {
    const auto stronger = [&](std::int32_t a, std::int32_t b) {
      const int score_a = score_at(corners, a);
      const int score_b = score_at(corners, b);
      return score_a != score_b ? score_a > score_b : a < b;
    };
    std::nth_element(picks_.begin(), picks_.begin() + (count - 1), picks_.end(), stronger);
    picks_.resize(static_cast<std::size_t>(count));
  }
  for (const std::int32_t pick : picks_) picked_[static_cast<std::size_t>(pick)] = 1;
}

/// Marks the `count` strongest of the corners that are not marked yet, of equally strong ones the
/// first.
void CornerChooser::pick_strongest(const std::vector<Corner>& corners, int count) {
  const std::int32_t size = static_cast<std::int32_t>(sorted_.size());
  int with_score[256] = {};
  for (std::int32_t i = 0; i < size; ++i) {
    if (picked_[static_cast<std::size_t>(i)] == 0) ++with_score[score_at(corners, i)];
  }
  // All above the score `lowest` are taken, and `rest` of those that have it.
  int lowest = 255;
  int rest = count;
  while (lowest > 0 && with_score[lowest] <= rest) rest -= with_score[lowest--];
  for (std::int32_t i = 0; i < size; ++i) {
    if (picked_[static_cast<std::size_t>(i)] != 0) continue;
    const int score = score_at(corners, i);
    if (score > lowest || (score == lowest && rest-- > 0)) picked_[static_cast<std::size_t>(i)] = 1;
  }
}

int CornerChooser::spread(const std::vector<Corner>& corners, int target, float even_share,
                          std::vector<Corner>& chosen) {
  if (target <= 0 || corners.empty()) return 0;
  if (corners.size() <= static_cast<std::size_t>(target)) {
    chosen.insert(chosen.end(), corners.begin(), corners.end());
    return static_cast<int>(corners.size());
  }
  const std::size_t before = chosen.size();
  sort_by_place(corners);
  picked_.assign(corners.size(), 0);
  const int evenly = static_cast<int>(std::lround(static_cast<float>(target) * even_share));
  if (evenly > 0) pick_evenly(corners, evenly);
  const int picked = evenly > 0 ? static_cast<int>(picks_.size()) : 0;
  if (picked < target) pick_strongest(corners, target - picked);
  for (std::size_t i = 0; i < sorted_.size(); ++i) {
    if (picked_[i] != 0) chosen.push_back(corners[static_cast<std::uint32_t>(sorted_[i])]);
  }
  return static_cast<int>(chosen.size() - before);
}

void divide_budget(const std::vector<int>& shares, const std::vector<int>& available,
                   int max_features, std::vector<int>& take) {
  take.assign(shares.size(), 0);
  int left = max_features;
  for (std::size_t i = 0; i < shares.size(); ++i) {
    take[i] = std::min(shares[i], available[i]);
    left -= take[i];
  }
  while (left > 0) {
    std::int64_t share_sum = 0;
    for (std::size_t i = 0; i < shares.size(); ++i) {
      if (take[i] < available[i]) share_sum += std::int64_t{shares[i]} + 1;
    }
    if (share_sum == 0) return;
    const int to_divide = left;
    for (std::size_t i = 0; i < shares.size() && left > 0; ++i) {
      if (take[i] == available[i]) continue;
      const std::int64_t part = std::int64_t{to_divide} * (std::int64_t{shares[i]} + 1) / share_sum;
      const int more = std::min(
          {static_cast<int>(std::max<std::int64_t>(part, 1)), available[i] - take[i], left});
      take[i] += more;
      left -= more;
    }
  }
}

}  // namespace dynslam::features::detail
