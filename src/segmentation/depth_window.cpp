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
constexpr int kMinWindowCells = 12;  // fewer say nothing

int bin_of(float z) {
  static const auto scale = static_cast<float>(1.0 / std::log(kBinRatio));
  const float bin = std::log(std::max(z, kNearest) / kNearest) * scale;
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
  step_ = SurfaceStep(options);
  const cv::Rect& box = instance.box;
  const double margin = options.side_margin * std::min(box.width, box.height);
  const double reach = std::max(options.reach * box.height, margin);
  x0_ = std::max(static_cast<int>((box.x - margin) / 2), 0);
  const int x1 = std::min(static_cast<int>((box.br().x + margin) / 2) + 1, half.width);
  y0_ = std::max(static_cast<int>((box.y - reach) / 2), 0);
  const int y1 = std::min(static_cast<int>((box.br().y + reach) / 2) + 1, half.height);
  depth_.cut(half, cv::Rect(cv::Point(x0_, y0_), cv::Point(x1, y1)));
  const int near_top = std::max(static_cast<int>((box.y - margin) / 2), 0) - y0_;
  const int near_bottom =
      std::min(static_cast<int>((box.br().y + margin) / 2) + 1, half.height) - y0_;
  near_begin_ = depth_.cell_of(-1, near_top);
  near_end_ = depth_.cell_of(-1, near_bottom);
  build_walls(x0_ > 0, x1 < half.width);
}

void DepthWindow::build_walls(bool open_left, bool open_right) {
  state_.assign(depth_.z.size(), 0);
  std::fill_n(state_.begin(), depth_.stride, std::uint8_t{kWall});
  std::fill_n(state_.rbegin(), depth_.stride, std::uint8_t{kWall});
  for (int y = 0; y < depth_.height; ++y) {
    state(depth_.cell_of(-1, y)) = kWall;
    state(depth_.cell_of(depth_.width, y)) = kWall;
    if (open_left) state(depth_.cell_of(0, y)) |= kSide;
    if (open_right) state(depth_.cell_of(depth_.width - 1, y)) |= kSide;
  }
}

// Marks the mask's cells and gathers them in the queue.
void DepthWindow::paint(const Instance& instance) {
  queue_.clear();
  for (int y = 0; y < depth_.height; ++y) {
    const int row = 2 * (y0_ + y) - instance.box.y;
    if (row < 0 || row >= instance.mask.rows) continue;
    const std::uint8_t* mask = instance.mask.ptr(row);
    const int begin = (instance.box.x + 1) / 2 - x0_;
    const int end = std::min((instance.box.br().x + 1) / 2 - x0_, depth_.width);
    for (int x = begin; x < end; ++x) {
      if (mask[2 * (x0_ + x) - instance.box.x] == 0) continue;
      state(depth_.cell_of(x, y)) |= kMask;
      queue_.push_back(depth_.cell_of(x, y));
    }
  }
  mask_cells_ = static_cast<int>(queue_.size());
}

bool DepthWindow::find_band(const std::vector<int>& cells) {
  std::array<int, kBins> histogram{};
  int count = 0;
  for (const int cell : cells) {
    if (!measured(depth_.at(cell))) continue;
    ++histogram[static_cast<std::size_t>(bin_of(depth_.at(cell)))];
    ++count;
  }
  if (count < kMinWindowCells) return false;
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

bool DepthWindow::open(const HalfDepth& half, const DepthRefinementOptions& options,
                       const Instance& instance) {
  place(half, options, instance);
  paint(instance);
  if (!find_band(queue_)) return false;
  for (const int cell : queue_) state(cell) |= kIn;
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
  for (int y = std::max(top, 0); y < std::min(bottom, depth_.height); ++y) {
    for (int x = std::max(left, 0); x < std::min(right, depth_.width); ++x) {
      const float there = depth_.at(depth_.cell_of(x, y));
      if (measured(there)) depths.push_back(there);
    }
  }
  if (depths.size() < static_cast<std::size_t>(kMinWindowCells)) return false;
  // The nearest depth that a fifth of the middle lies around: things before the background, but not
  // every thin thing before them.
  std::sort(depths.begin(), depths.end());
  const std::size_t needed = std::max<std::size_t>(depths.size() / 4, kMinWindowCells);
  float centre = depths[depths.size() / 2];
  for (std::size_t i = 0; i + needed <= depths.size(); ++i) {
    if (depths[i + needed - 1] <= depths[i] * 1.12F) {
      centre = depths[i + needed / 2];
      break;
    }
  }
  queue_.clear();
  for (int y = 0; y < depth_.height; ++y) {
    for (int x = 0; x < depth_.width; ++x) {
      const cv::Point pixel(2 * (x0_ + x), 2 * (y0_ + y));
      const int cell = depth_.cell_of(x, y);
      if (box.contains(pixel) && depth_.at(cell) > centre * 0.85F &&
          depth_.at(cell) < centre * 1.18F &&
          half.facing[static_cast<std::size_t>((y0_ + y) * half.width + x0_ + x)] != 0) {
        queue_.push_back(cell);
      }
    }
  }
  if (!find_band(queue_)) return false;
  mask_cells_ = static_cast<int>(queue_.size());
  for (const int cell : queue_) state(cell) |= kMask | kIn;
  return true;
}

void DepthWindow::clear_visited() {
  for (std::uint8_t& state : state_) state &= static_cast<std::uint8_t>(~kVisited);
}

void DepthWindow::remove_what_does_not_belong() {
  // Smooth paths inside the mask, from the band on; an arm stretched out of the band stays.
  queue_.clear();
  for (int cell = depth_.begin(); cell < depth_.end(); ++cell) {
    if ((state(cell) & kMask) && band_.contains(depth_.at(cell))) {
      state(cell) |= kVisited;
      queue_.push_back(cell);
    }
  }
  for (std::size_t next = 0; next < queue_.size(); ++next) {
    const int cell = queue_[next];
    for (const int other : depth_.neighbours(cell)) {
      if (!(state(other) & kMask) || (state(other) & kVisited) || !measured(depth_.at(other)))
        continue;
      if (!continuous(other, cell)) continue;
      state(other) |= kVisited;
      queue_.push_back(other);
    }
  }
  // The rest, surface by surface.
  std::vector<int> foreign;
  for (int start = depth_.begin(); start < depth_.end(); ++start) {
    if (!(state(start) & kMask) || (state(start) & kVisited) || !measured(depth_.at(start)))
      continue;
    const int inside = flood_foreign_surface(start);
    // A surface that ends where the mask ends is something the network meant, if at another depth:
    // two people in one mask. One that goes on outside is what the mask took in by mistake.
    if (inside >= kMinWindowCells && inside >= 0.7 * static_cast<double>(queue_.size())) continue;
    for (const int cell : queue_) {
      if (state(cell) & kMask) foreign.push_back(cell);
    }
  }
  if (static_cast<double>(foreign.size()) <= options_.max_removal * mask_cells_) {
    for (const int cell : foreign) state(cell) &= static_cast<std::uint8_t>(~kIn);
  }
  clear_visited();
}

// Gathers the smooth surface of `start` in the queue, inside and outside the mask but not the cells
// of the instance's own; how many of its cells are inside.
int DepthWindow::flood_foreign_surface(int start) {
  queue_.assign(1, start);
  state(start) |= kVisited;
  int inside = 0;
  for (std::size_t next = 0; next < queue_.size(); ++next) {
    const int cell = queue_[next];
    inside += state(cell) & kMask ? 1 : 0;
    for (const int other : depth_.neighbours(cell)) {
      if ((state(other) & kVisited) || !measured(depth_.at(other)) || !is_near(other) ||
          !continuous(other, cell)) {
        continue;
      }
      state(other) |= kVisited;
      queue_.push_back(other);
    }
  }
  return inside;
}

}  // namespace dynslam::segmentation
