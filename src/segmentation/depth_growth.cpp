#include <algorithm>
#include <cmath>
#include <cstring>

#include <opencv2/core.hpp>

#include "segmentation/depth_window.hpp"

namespace dynslam::segmentation {
namespace {

constexpr int kMinPartCells = 12;  // of a part behind something; fewer say nothing

// Sets `bit` in the states of cells in the band that face the camera. Without branches, so that it
// is vectorized.
void mark_row(const std::uint8_t* facing, const float* z, const DepthBand& band, std::uint8_t bit,
              int width, std::uint8_t* states) {
  const float low = band.low;
  const float high = band.high;
  for (int x = 0; x < width; ++x) {
    const int in_band = (z[x] >= low ? bit : 0) & (z[x] <= high ? bit : 0);
    const int rest = states[x] & ~bit;
    states[x] = static_cast<std::uint8_t>(rest | (facing[x] != 0 ? in_band : 0));
  }
}

// Not 0 for the cells with the bit `in` beside one with the bit `grows` and not `in`. Without
// branches, so that it is vectorized.
void rim_of_row(const std::uint8_t* states, int stride, std::uint8_t in, std::uint8_t grows,
                int width, std::uint8_t* on_rim) {
  const std::uint8_t* above = states - stride;
  const std::uint8_t* below = states + stride;
  const auto may_grow = [in, grows](std::uint8_t state) {
    return static_cast<std::uint8_t>((state & (in | grows)) == grows ? 1 : 0);
  };
  for (int x = 0; x < width; ++x) {
    const std::uint8_t beside =
        may_grow(states[x - 1]) | may_grow(states[x + 1]) | may_grow(above[x]) | may_grow(below[x]);
    on_rim[x] = (states[x] & in) != 0 ? beside : std::uint8_t{0};
  }
}

// Not 0 for the cells without depth and without any of the bits `known`. Without branches, so that
// it is vectorized.
void holes_of_row(const std::uint8_t* states, const float* z, int known, int width,
                  std::uint8_t* is_hole) {
  for (int x = 0; x < width; ++x) {
    const int open = (states[x] & known) == 0 ? 1 : 0;
    is_hole[x] = static_cast<std::uint8_t>(measured(z[x]) ? 0 : open);
  }
}

// Calls `work` with the places of what is not 0, which is little, in order.
template <typename Work>
void for_each_set(const std::vector<std::uint8_t>& flags, const Work& work) {
  constexpr std::size_t kWord = sizeof(std::uint64_t);
  for (std::size_t begin = 0; begin < flags.size(); begin += kWord) {
    const std::size_t count = std::min(kWord, flags.size() - begin);
    std::uint64_t word = 0;
    std::memcpy(&word, flags.data() + begin, count);
    if (word == 0) continue;
    for (std::size_t i = begin; i < begin + count; ++i) {
      if (flags[i] != 0) work(i);
    }
  }
}

// Every value twice.
void double_row(const std::uint8_t* values, int width, std::uint8_t* out) {
  for (int x = 0; x < width / 2; ++x) out[2 * x] = out[2 * x + 1] = values[x];
  if (width % 2 != 0) out[width - 1] = values[width / 2];
}

}  // namespace

// Marks what the instance may grow over: its depths, where the surface is not steep.
void DepthWindow::mark_growable(const std::vector<std::uint8_t>& facing) {
  for (int y = 0; y < depth_.height; ++y) {
    const auto row = static_cast<std::ptrdiff_t>(y0_ + y) * half_->width + x0_;
    mark_row(facing.data() + row, &depth_.z[depth_.cell_of(0, y)], band_, kGrows, depth_.width,
             &state(depth_.cell_of(0, y)));
  }
}

bool DepthWindow::continues(int cell, int from) const {
  return (state(cell) & (kGrows | kIn | kVisited)) == kGrows && is_near(cell) &&
         continuous(cell, from);
}

// Gathers the region outside the mask that starts at `start` in the queue, and in `rim` its cells
// next to the mask; how many of its cells are at an open side of the window.
int DepthWindow::flood_beside(int start, std::vector<int>& rim) {
  queue_.assign(1, start);
  rim.clear();
  state(start) |= kVisited;
  int sides = 0;
  for (std::size_t next = 0; next < queue_.size(); ++next) {
    const int cell = queue_[next];
    sides += state(cell) & kSide ? 1 : 0;
    bool touches = false;
    for (const int other : depth_.neighbours(cell)) {
      touches |= (state(other) & kIn) != 0;
      if (!continues(other, cell)) continue;
      state(other) |= kVisited;
      queue_.push_back(other);
    }
    if (touches) rim.push_back(cell);
  }
  return sides;
}

void DepthWindow::grow_beside_the_mask() { grow(half_->facing); }

void DepthWindow::grow_up_and_down(double max_growth, const std::vector<std::uint8_t>& where) {
  near_begin_ = depth_.begin();
  near_end_ = depth_.end();
  options_.max_growth = max_growth;
  grow(where);
}

void DepthWindow::grow(const std::vector<std::uint8_t>& where) {
  // Every region outside the mask that continues it is judged as a whole: what is large or goes on
  // beyond the window is something that the thing stands at. Of such a region only the rim next to
  // the mask is taken.
  mark_growable(where);
  std::vector<int> seeds, rim, accepted;
  find_rim(seeds);
  for (const int seed : seeds) {
    for (const int start : depth_.neighbours(seed)) {
      if (!continues(start, seed)) continue;
      const int sides = flood_beside(start, rim);
      const bool whole =
          sides <= 2 && static_cast<double>(queue_.size()) <= options_.max_growth * mask_cells_;
      const std::vector<int>& taken = whole ? queue_ : rim;
      accepted.insert(accepted.end(), taken.begin(), taken.end());
    }
  }
  for (const int cell : accepted) state(cell) |= kIn;
  clear_visited();
}

// Gathers the cells of the instance next to others that it may grow over.
void DepthWindow::find_rim(std::vector<int>& rim) const {
  std::vector<std::uint8_t> on_rim(static_cast<std::size_t>(depth_.width));
  for (int y = 0; y < depth_.height; ++y) {
    const int first = depth_.cell_of(0, y);
    rim_of_row(&state_[static_cast<std::size_t>(first)], depth_.stride, kIn, kGrows, depth_.width,
               on_rim.data());
    for_each_set(on_rim, [&](std::size_t x) { rim.push_back(first + static_cast<int>(x)); });
  }
}

bool DepthWindow::hidden_from_the_mask(const std::vector<int>& component) const {
  // Up or down from the component's cells to the first cell of the instance: most of what lies
  // between must be nearer than the instance, or unknown.
  int nearer = 0;
  int between = 0;
  int reached = 0;
  int tried = 0;
  for (std::size_t i = 0; i < component.size(); i += 1 + component.size() / 64) {
    ++tried;
    for (const int step : {-depth_.stride, depth_.stride}) {
      int hits_nearer = 0, hits = 0;
      int cell = component[i] + step;
      for (; !(state(cell) & (kWall | kIn)); cell += step) {
        if (state(cell) & kVisited) continue;  // the component itself
        ++hits;
        hits_nearer += depth_.at(cell) < band_.low ? 1 : 0;
      }
      if (state(cell) & kWall) continue;
      ++reached;
      nearer += hits_nearer;
      between += hits;
      break;
    }
  }
  return 2 * reached >= tried && between > 0 && nearer >= 0.7 * between;
}

// Gathers the region of `start` in the queue; whether it is clear of the instance and of the open
// sides of the window.
bool DepthWindow::flood_apart(int start) {
  queue_.assign(1, start);
  state(start) |= kSeen;
  bool apart = true;
  for (std::size_t next = 0; next < queue_.size(); ++next) {
    const int cell = queue_[next];
    if (state(cell) & kSide) apart = false;
    for (const int other : depth_.neighbours(cell)) {
      const std::uint8_t there = state(other);
      if (!(there & kIn) && ((there & (kGrows | kSeen)) != kGrows)) continue;
      if (!continuous(other, cell)) continue;
      if (there & kIn) {
        apart = false;
      } else {
        state(other) |= kSeen;
        queue_.push_back(other);
      }
    }
  }
  return apart;
}

void DepthWindow::add_parts_behind() {
  if (options_.reach <= 0.0) return;
  mark_growable(half_->facing);
  std::vector<int> accepted;
  for (int start = depth_.begin(); start < depth_.end(); ++start) {
    if ((state(start) & (kGrows | kSeen | kIn)) != kGrows) continue;
    // What touches the instance was judged before.
    if (!flood_apart(start) || queue_.size() < static_cast<std::size_t>(kMinPartCells) ||
        static_cast<double>(queue_.size()) > mask_cells_) {
      continue;
    }
    for (const int cell : queue_) state(cell) |= kVisited;
    if (hidden_from_the_mask(queue_)) {
      accepted.insert(accepted.end(), queue_.begin(), queue_.end());
    }
    for (const int cell : queue_) state(cell) &= static_cast<std::uint8_t>(~kVisited);
  }
  for (const int cell : accepted) state(cell) |= kIn;
}

void DepthWindow::fill_holes() {
  // Cells without depth that the instance all but surrounds.
  std::vector<std::uint8_t> is_hole(static_cast<std::size_t>(depth_.width));
  for (int y = 0; y < depth_.height; ++y) {
    const int first = depth_.cell_of(0, y);
    holes_of_row(&state_[static_cast<std::size_t>(first)],
                 &depth_.z[static_cast<std::size_t>(first)], kIn | kVisited, depth_.width,
                 is_hole.data());
    for_each_set(is_hole, [&](std::size_t x) {
      const int start = first + static_cast<int>(x);
      if (!(state(start) & (kIn | kVisited))) fill_hole(start);
    });
  }
  clear_visited();
}

// The cells without depth that are connected with `start`.
void DepthWindow::fill_hole(int start) {
  queue_.assign(1, start);
  state(start) |= kVisited;
  int inside = 0;
  int outside = 0;
  for (std::size_t next = 0; next < queue_.size(); ++next) {
    for (const int other : depth_.neighbours(queue_[next])) {
      if (state(other) & kIn) {
        ++inside;
      } else if (measured(depth_.at(other)) || (state(other) & kWall)) {
        ++outside;
      } else if (!(state(other) & kVisited)) {
        state(other) |= kVisited;
        queue_.push_back(other);
      }
    }
  }
  if (inside < 4 * outside) return;
  for (const int cell : queue_) state(cell) |= kIn;
}

// The smallest window of cells that holds the instance; empty if it has none.
cv::Rect DepthWindow::extent() const {
  int left = depth_.width, right = -1, top = depth_.height, bottom = -1;
  for (int y = 0; y < depth_.height; ++y) {
    const std::uint8_t* states = &state_[static_cast<std::size_t>(depth_.cell_of(0, y))];
    int first = 0;
    while (first < depth_.width && !(states[first] & kIn)) ++first;
    if (first == depth_.width) continue;
    int last = depth_.width - 1;
    while (!(states[last] & kIn)) --last;
    left = std::min(left, first);
    right = std::max(right, last);
    top = std::min(top, y);
    bottom = y;
  }
  return right < 0 ? cv::Rect() : cv::Rect(left, top, right - left + 1, bottom - top + 1);
}

// What is to be done with the pixels of a row's cells from `left` on: all of a cell is the
// instance's (255) or none (0); `by_depth`: not 0 where each pixel's own depth decides.
void DepthWindow::choose_brushes(int left, int y, std::vector<std::uint8_t>& full,
                                 std::vector<std::uint8_t>& by_depth) const {
  const int first = depth_.cell_of(left, y);
  const std::uint8_t* here = state_.data() + first;
  const std::uint8_t* above = here - depth_.stride;
  const std::uint8_t* below = here + depth_.stride;
  const float* z = depth_.z.data() + first;
  const auto width = static_cast<int>(full.size());
  std::uint8_t* whole = full.data();
  std::uint8_t* border = by_depth.data();
  for (int x = 0; x < width; ++x) {
    const int around = here[x - 1] & here[x + 1] & above[x] & below[x] & kIn;
    const int inner = measured(z[x]) ? around : kIn;
    const int in = here[x] & kIn;
    whole[x] = static_cast<std::uint8_t>((in & inner) != 0 ? 255 : 0);
    border[x] = static_cast<std::uint8_t>(in & ~inner);
  }
}

void DepthWindow::write(DepthView depth, Instance& instance) const {
  const cv::Rect cells = extent();
  if (cells.empty()) return;
  const cv::Rect box =
      cv::Rect(2 * (x0_ + cells.x), 2 * (y0_ + cells.y), 2 * cells.width, 2 * cells.height) &
      cv::Rect(0, 0, depth.width, depth.height);
  cv::Mat mask(box.size(), CV_8UC1);
  std::vector<std::uint8_t> full(static_cast<std::size_t>(cells.width)), by_depth(full.size());
  for (int v = 0; v < box.height; ++v) {
    const int y = cells.y + v / 2;
    if (v % 2 == 0) choose_brushes(cells.x, y, full, by_depth);
    std::uint8_t* out = mask.ptr(v);
    double_row(full.data(), box.width, out);
    // At the border the pixel's own depth decides, if it has one.
    const float* own = depth.row(box.y + v) + box.x;
    const float* z = depth_.z.data() + depth_.cell_of(cells.x, y);
    for_each_set(by_depth, [&](std::size_t x) {
      const int right = std::min(2 * static_cast<int>(x) + 2, box.width);
      for (int u = 2 * static_cast<int>(x); u < right; ++u) {
        out[u] = !measured(own[u]) || step_.joins(own[u], z[x]) ? 255 : 0;
      }
    });
  }
  instance.box = box;
  instance.mask = mask;
}

}  // namespace dynslam::segmentation
