#include "segmentation/depth_window.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <opencv2/core.hpp>

namespace dynslam::segmentation {
namespace {

// Histogram of depth in steps of 3 %, from 0.1 m on.
constexpr double kBinRatio = 1.03;
constexpr int kBins = 256;
constexpr float kNearest = 0.1F;
constexpr int kMinCells = 12;  // fewer say nothing

int bin_of(float z) {
  static const double scale = 1.0 / std::log(kBinRatio);
  const double bin = std::log(static_cast<double>(std::max(z, kNearest) / kNearest)) * scale;
  return std::min(static_cast<int>(bin), kBins - 1);
}
float bin_edge(int bin) {
  return kNearest * static_cast<float>(std::pow(kBinRatio, static_cast<double>(bin)));
}

}  // namespace

void DepthWindow::place(const HalfDepth& half, const DepthRefinementOptions& options,
                        const Instance& instance) {
  half_ = &half;
  options_ = options;
  const cv::Rect& box = instance.box;
  const double margin = options.side_margin * std::min(box.width, box.height);
  const double reach = std::max(options.reach * box.height, margin);
  x0_ = std::max(static_cast<int>((box.x - margin) / 2), 0);
  const int x1 = std::min(static_cast<int>((box.br().x + margin) / 2) + 1, half.width);
  y0_ = std::max(static_cast<int>((box.y - reach) / 2), 0);
  const int y1 = std::min(static_cast<int>((box.br().y + reach) / 2) + 1, half.height);
  near_top_ = std::max(static_cast<int>((box.y - margin) / 2), 0) - y0_;
  near_bottom_ = std::min(static_cast<int>((box.br().y + margin) / 2) + 1, half.height) - y0_;
  width_ = x1 - x0_;
  height_ = y1 - y0_;
  open_left_ = x0_ > 0;
  open_right_ = x1 < half.width;
  const auto count = static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_);
  state_.assign(count, 0);
  z_.resize(count);
  for (int y = 0; y < height_; ++y) {
    const float* row = half.z.data() + static_cast<std::ptrdiff_t>(y0_ + y) * half.width + x0_;
    std::copy(row, row + width_, z_.data() + static_cast<std::ptrdiff_t>(y) * width_);
  }
}

void DepthWindow::paint(const Instance& instance) {
  mask_cells_ = 0;
  for (int y = 0; y < height_; ++y) {
    const int row = 2 * (y0_ + y) - instance.box.y;
    if (row < 0 || row >= instance.mask.rows) continue;
    const std::uint8_t* mask = instance.mask.ptr(row);
    for (int x = 0; x < width_; ++x) {
      const int column = 2 * (x0_ + x) - instance.box.x;
      if (column < 0 || column >= instance.mask.cols || mask[column] == 0) continue;
      state_[static_cast<std::size_t>(y * width_ + x)] = kMask;
      ++mask_cells_;
    }
  }
}

bool DepthWindow::find_band(const std::vector<int>& cells) {
  std::array<int, kBins> histogram{};
  int count = 0;
  for (const int cell : cells) {
    const float z = z_[static_cast<std::size_t>(cell)];
    if (!measured(z)) continue;
    ++histogram[static_cast<std::size_t>(bin_of(z))];
    ++count;
  }
  if (count < kMinCells) return false;
  const auto smooth = [&](int bin) {
    int sum = histogram[static_cast<std::size_t>(bin)];
    if (bin > 0) sum += histogram[static_cast<std::size_t>(bin - 1)];
    if (bin + 1 < kBins) sum += histogram[static_cast<std::size_t>(bin + 1)];
    return sum;
  };
  int mode = 0;
  for (int bin = 1; bin < kBins; ++bin) {
    if (smooth(bin) > smooth(mode)) mode = bin;
  }
  // The band goes on while the histogram does.
  const int floor = std::max(smooth(mode) / 10, 2);
  int low = mode;
  int high = mode;
  while (low > 0 && smooth(low - 1) > floor) --low;
  while (high + 1 < kBins && smooth(high + 1) > floor) ++high;
  band_ = {bin_edge(low), bin_edge(high + 1)};
  return true;
}

bool DepthWindow::one_surface(float a, float b) const {
  const float step = static_cast<float>(options_.step_share) * std::min(a, b) +
                     static_cast<float>(options_.step_m);
  return std::abs(a - b) <= step;
}

int DepthWindow::neighbours(int cell, int out[4]) const {
  const int x = cell % width_;
  const int y = cell / width_;
  int count = 0;
  if (x > 0) out[count++] = cell - 1;
  if (x + 1 < width_) out[count++] = cell + 1;
  if (y > 0) out[count++] = cell - width_;
  if (y + 1 < height_) out[count++] = cell + width_;
  return count;
}

bool DepthWindow::open(const HalfDepth& half, const DepthRefinementOptions& options,
                       const Instance& instance) {
  place(half, options, instance);
  paint(instance);
  queue_.clear();
  for (int cell = 0; cell < width_ * height_; ++cell) {
    if (state_[static_cast<std::size_t>(cell)] & kMask) queue_.push_back(cell);
  }
  if (!find_band(queue_)) return false;
  for (const int cell : queue_) state_[static_cast<std::size_t>(cell)] |= kIn;
  return true;
}

bool DepthWindow::open_box(const HalfDepth& half, const DepthRefinementOptions& options,
                           const Instance& instance) {
  place(half, options, instance);
  // The middle half of the box in each direction, where the thing is rather than what is around it.
  const cv::Rect& box = instance.box;
  const int left = (box.x + box.width / 4) / 2 - x0_;
  const int right = (box.br().x - box.width / 4) / 2 - x0_;
  const int top = (box.y + box.height / 8) / 2 - y0_;
  const int bottom = (box.br().y - box.height / 4) / 2 - y0_;
  std::vector<float> depths;
  for (int y = std::max(top, 0); y < std::min(bottom, height_); ++y) {
    for (int x = std::max(left, 0); x < std::min(right, width_); ++x) {
      const float z = z_[static_cast<std::size_t>(y * width_ + x)];
      if (measured(z)) depths.push_back(z);
    }
  }
  if (depths.size() < static_cast<std::size_t>(kMinCells)) return false;
  // The nearest depth that a fifth of the middle lies around: things before the background, but not
  // every thin thing before them.
  std::sort(depths.begin(), depths.end());
  const std::size_t needed = std::max<std::size_t>(depths.size() / 4, kMinCells);
  float centre = depths[depths.size() / 2];
  for (std::size_t i = 0; i + needed <= depths.size(); ++i) {
    if (depths[i + needed - 1] <= depths[i] * 1.12F) {
      centre = depths[i + needed / 2];
      break;
    }
  }
  queue_.clear();
  for (int y = 0; y < height_; ++y) {
    for (int x = 0; x < width_; ++x) {
      const cv::Point pixel(2 * (x0_ + x), 2 * (y0_ + y));
      const int cell = y * width_ + x;
      const float z = z_[static_cast<std::size_t>(cell)];
      if (box.contains(pixel) && z > centre * 0.85F && z < centre * 1.18F &&
          half.facing[static_cast<std::size_t>((y0_ + y) * half.width + x0_ + x)] != 0) {
        queue_.push_back(cell);
      }
    }
  }
  if (!find_band(queue_)) return false;
  mask_cells_ = static_cast<int>(queue_.size());
  for (const int cell : queue_) state_[static_cast<std::size_t>(cell)] |= kMask | kIn;
  return true;
}

void DepthWindow::clear_visited() {
  for (std::uint8_t& state : state_) state &= static_cast<std::uint8_t>(~kVisited);
}

void DepthWindow::remove_what_does_not_belong() {
  // Smooth paths inside the mask, from the band on; an arm stretched out of the band stays.
  queue_.clear();
  for (int cell = 0; cell < width_ * height_; ++cell) {
    auto& state = state_[static_cast<std::size_t>(cell)];
    if ((state & kMask) && band_.contains(z_[static_cast<std::size_t>(cell)])) {
      state |= kVisited;
      queue_.push_back(cell);
    }
  }
  for (std::size_t next = 0; next < queue_.size(); ++next) {
    const int cell = queue_[next];
    int around[4];
    const int count = neighbours(cell, around);
    for (int i = 0; i < count; ++i) {
      auto& state = state_[static_cast<std::size_t>(around[i])];
      const float z = z_[static_cast<std::size_t>(around[i])];
      if (!(state & kMask) || (state & kVisited) || !measured(z)) continue;
      if (!one_surface(z, z_[static_cast<std::size_t>(cell)])) continue;
      state |= kVisited;
      queue_.push_back(around[i]);
    }
  }
  // The rest, surface by surface.
  std::vector<int> foreign;
  for (int start = 0; start < width_ * height_; ++start) {
    const auto state = state_[static_cast<std::size_t>(start)];
    if (!(state & kMask) || (state & kVisited) || !measured(z_[static_cast<std::size_t>(start)])) {
      continue;
    }
    const int inside = flood_foreign_surface(start);
    // A surface that ends where the mask ends is something the network meant, if at another depth:
    // two people in one mask. One that goes on outside is what the mask took in by mistake.
    if (inside >= kMinCells && inside >= 0.7 * static_cast<double>(queue_.size())) continue;
    for (const int cell : queue_) {
      if (state_[static_cast<std::size_t>(cell)] & kMask) foreign.push_back(cell);
    }
  }
  if (static_cast<double>(foreign.size()) <= options_.max_removal * mask_cells_) {
    for (const int cell : foreign) {
      state_[static_cast<std::size_t>(cell)] &= static_cast<std::uint8_t>(~kIn);
    }
  }
  clear_visited();
}

// Gathers the smooth surface of `start` in the queue, inside and outside the mask but not the cells
// of the instance's own; how many of its cells are inside.
int DepthWindow::flood_foreign_surface(int start) {
  queue_.clear();
  queue_.push_back(start);
  state_[static_cast<std::size_t>(start)] |= kVisited;
  int inside = 0;
  for (std::size_t next = 0; next < queue_.size(); ++next) {
    const int cell = queue_[next];
    inside += state_[static_cast<std::size_t>(cell)] & kMask ? 1 : 0;
    int around[4];
    const int count = neighbours(cell, around);
    for (int i = 0; i < count; ++i) {
      const auto at = static_cast<std::size_t>(around[i]);
      const int y = around[i] / width_;
      if ((state_[at] & kVisited) || !measured(z_[at]) || y < near_top_ || y >= near_bottom_ ||
          !one_surface(z_[at], z_[static_cast<std::size_t>(cell)])) {
        continue;
      }
      state_[at] |= kVisited;
      queue_.push_back(around[i]);
    }
  }
  return inside;
}

bool DepthWindow::growable(int cell) const {
  const int x = x0_ + cell % width_;
  const int y = y0_ + cell / width_;
  return band_.contains(z_[static_cast<std::size_t>(cell)]) &&
         half_->facing[static_cast<std::size_t>(y) * static_cast<std::size_t>(half_->width) +
                       static_cast<std::size_t>(x)] != 0;
}

bool DepthWindow::on_side(int cell) const {
  const int x = cell % width_;
  return (open_left_ && x == 0) || (open_right_ && x + 1 == width_);
}

bool DepthWindow::continues(int cell, int from) const {
  const int y = cell / width_;
  return !(state_[static_cast<std::size_t>(cell)] & (kIn | kVisited)) && y >= near_top_ &&
         y < near_bottom_ && growable(cell) &&
         one_surface(z_[static_cast<std::size_t>(cell)], z_[static_cast<std::size_t>(from)]);
}

// Gathers the region outside the mask that starts at `start` in the queue, and in `rim` its cells
// next to the mask; how many of its cells are at an open side of the window.
int DepthWindow::flood_beside(int start, std::vector<int>& rim) {
  queue_.clear();
  queue_.push_back(start);
  rim.clear();
  state_[static_cast<std::size_t>(start)] |= kVisited;
  int sides = 0;
  for (std::size_t next = 0; next < queue_.size(); ++next) {
    const int cell = queue_[next];
    sides += on_side(cell) ? 1 : 0;
    int around[4];
    const int count = neighbours(cell, around);
    bool touches = false;
    for (int i = 0; i < count; ++i) {
      touches |= (state_[static_cast<std::size_t>(around[i])] & kIn) != 0;
      if (!continues(around[i], cell)) continue;
      state_[static_cast<std::size_t>(around[i])] |= kVisited;
      queue_.push_back(around[i]);
    }
    if (touches) rim.push_back(cell);
  }
  return sides;
}

void DepthWindow::grow_beside_the_mask() {
  // Every region outside the mask that continues it is judged as a whole: what is large or goes on
  // beyond the window is something that the thing stands at. Of such a region only the rim next to
  // the mask is taken.
  std::vector<int> seeds, rim, accepted;
  for (int cell = 0; cell < width_ * height_; ++cell) {
    if (state_[static_cast<std::size_t>(cell)] & kIn) seeds.push_back(cell);
  }
  for (const int seed : seeds) {
    int around[4];
    const int count = neighbours(seed, around);
    for (int i = 0; i < count; ++i) {
      if (!continues(around[i], seed)) continue;
      const int sides = flood_beside(around[i], rim);
      const bool whole =
          sides <= 2 && static_cast<double>(queue_.size()) <= options_.max_growth * mask_cells_;
      const std::vector<int>& taken = whole ? queue_ : rim;
      accepted.insert(accepted.end(), taken.begin(), taken.end());
    }
  }
  for (const int cell : accepted) state_[static_cast<std::size_t>(cell)] |= kIn;
  clear_visited();
}

void DepthWindow::grow_up_and_down(double max_growth) {
  near_top_ = 0;
  near_bottom_ = height_;
  options_.max_growth = max_growth;
  grow_beside_the_mask();
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
    const int x = component[i] % width_;
    const int start = component[i] / width_;
    for (const int step : {-1, 1}) {
      int hits_nearer = 0, hits = 0;
      bool found = false;
      for (int y = start + step; y >= 0 && y < height_; y += step) {
        const auto cell = static_cast<std::size_t>(y * width_ + x);
        if (state_[cell] & kVisited) continue;  // the component itself
        if (state_[cell] & kIn) {
          found = true;
          break;
        }
        ++hits;
        hits_nearer += z_[cell] < band_.low ? 1 : 0;
      }
      if (found) {
        ++reached;
        nearer += hits_nearer;
        between += hits;
        break;
      }
    }
  }
  return 2 * reached >= tried && between > 0 && nearer >= 0.7 * between;
}

void DepthWindow::add_parts_behind() {
  if (options_.reach <= 0.0) return;
  std::vector<std::uint8_t> seen(state_.size(), 0);
  std::vector<int> accepted;
  for (int start = 0; start < width_ * height_; ++start) {
    if (seen[static_cast<std::size_t>(start)] != 0 ||
        (state_[static_cast<std::size_t>(start)] & kIn) || !growable(start)) {
      continue;
    }
    queue_.clear();
    queue_.push_back(start);
    seen[static_cast<std::size_t>(start)] = 1;
    int sides = 0;
    bool touches = false;
    for (std::size_t next = 0; next < queue_.size(); ++next) {
      const int cell = queue_[next];
      sides += on_side(cell) ? 1 : 0;
      int around[4];
      const int count = neighbours(cell, around);
      for (int i = 0; i < count; ++i) {
        const auto at = static_cast<std::size_t>(around[i]);
        if (state_[at] & kIn) {
          touches |= one_surface(z_[at], z_[static_cast<std::size_t>(cell)]);
        } else if (seen[at] == 0 && growable(around[i]) &&
                   one_surface(z_[at], z_[static_cast<std::size_t>(cell)])) {
          seen[at] = 1;
          queue_.push_back(around[i]);
        }
      }
    }
    // What touches the instance was judged before.
    if (touches || sides > 0 || queue_.size() < static_cast<std::size_t>(kMinCells) ||
        static_cast<double>(queue_.size()) > mask_cells_) {
      continue;
    }
    for (const int cell : queue_) state_[static_cast<std::size_t>(cell)] |= kVisited;
    const bool hidden = hidden_from_the_mask(queue_);
    for (const int cell : queue_) {
      state_[static_cast<std::size_t>(cell)] &= static_cast<std::uint8_t>(~kVisited);
    }
    if (hidden) accepted.insert(accepted.end(), queue_.begin(), queue_.end());
  }
  for (const int cell : accepted) state_[static_cast<std::size_t>(cell)] |= kIn;
}

void DepthWindow::fill_holes() {
  // Cells without depth that the instance all but surrounds.
  for (int start = 0; start < width_ * height_; ++start) {
    if ((state_[static_cast<std::size_t>(start)] & (kIn | kVisited)) ||
        measured(z_[static_cast<std::size_t>(start)])) {
      continue;
    }
    queue_.clear();
    queue_.push_back(start);
    state_[static_cast<std::size_t>(start)] |= kVisited;
    int inside = 0;
    int outside = 0;
    for (std::size_t next = 0; next < queue_.size(); ++next) {
      int around[4];
      const int count = neighbours(queue_[next], around);
      outside += 4 - count;
      for (int i = 0; i < count; ++i) {
        const auto at = static_cast<std::size_t>(around[i]);
        if (state_[at] & kIn) {
          ++inside;
        } else if (measured(z_[at])) {
          ++outside;
        } else if (!(state_[at] & kVisited)) {
          state_[at] |= kVisited;
          queue_.push_back(around[i]);
        }
      }
    }
    if (inside >= 4 * outside) {
      for (const int cell : queue_) state_[static_cast<std::size_t>(cell)] |= kIn;
    }
  }
  clear_visited();
}

void DepthWindow::write(DepthView depth, Instance& instance) const {
  Extent extent{width_, height_, -1, -1};
  for (int y = 0; y < height_; ++y) {
    for (int x = 0; x < width_; ++x) {
      if (!(state_[static_cast<std::size_t>(y * width_ + x)] & kIn)) continue;
      extent.left = std::min(extent.left, x);
      extent.right = std::max(extent.right, x);
      extent.top = std::min(extent.top, y);
      extent.bottom = std::max(extent.bottom, y);
    }
  }
  if (extent.right < 0) return;
  cv::Rect box(2 * (x0_ + extent.left), 2 * (y0_ + extent.top),
               2 * (extent.right - extent.left + 1), 2 * (extent.bottom - extent.top + 1));
  box &= cv::Rect(0, 0, depth.width, depth.height);
  cv::Mat mask(box.size(), CV_8UC1);
  const auto in = [&](int x, int y) {
    return x >= 0 && y >= 0 && x < width_ && y < height_ &&
           (state_[static_cast<std::size_t>(y * width_ + x)] & kIn) != 0;
  };
  mask.setTo(0);
  for (int y = extent.top; y <= extent.bottom; ++y) {
    for (int x = extent.left; x <= extent.right; ++x) {
      if (!in(x, y)) continue;
      const float cell = z_[static_cast<std::size_t>(y * width_ + x)];
      const bool border = !in(x - 1, y) || !in(x + 1, y) || !in(x, y - 1) || !in(x, y + 1);
      const int u = 2 * (x0_ + x) - box.x;
      const int v = 2 * (y0_ + y) - box.y;
      for (int row = v; row < std::min(v + 2, box.height); ++row) {
        const float* own = depth.row(box.y + row) + box.x;
        std::uint8_t* out = mask.ptr(row);
        for (int column = u; column < std::min(u + 2, box.width); ++column) {
          // At the border the pixel's own depth decides, if it has one.
          const bool decides = border && measured(own[column]) && measured(cell);
          out[column] = !decides || one_surface(own[column], cell) ? 255 : 0;
        }
      }
    }
  }
  instance.box = box;
  instance.mask = mask;
}

}  // namespace dynslam::segmentation
