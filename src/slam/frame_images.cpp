#include "frame_images.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>

#include "depth_alignment.hpp"

namespace dynslam::slam {
namespace {

constexpr int kCell = kSurfaceCell;
constexpr int kCellPixels = kCell * kCell;
constexpr int kBlock = 16;  // columns at a time, a constant, so that the loop is vectorized
constexpr int kStrip = 32;  // pixels that are hidden or not as one

// Sums of `kBlock` columns of four rows from `top` on.
std::array<std::uint16_t, kBlock> column_sums(const std::uint8_t* top, std::size_t pitch) {
  static_assert(kCell == 4);
  std::array<std::uint16_t, kBlock> sums;
  for (int x = 0; x < kBlock; ++x) {
    sums[static_cast<std::size_t>(x)] =
        static_cast<std::uint16_t>(top[x] + top[pitch + static_cast<std::size_t>(x)] +
                                   top[2 * pitch + static_cast<std::size_t>(x)] +
                                   top[3 * pitch + static_cast<std::size_t>(x)]);
  }
  return sums;
}

std::uint8_t rounded_mean(int sum) {
  const int odd = sum / kCellPixels % 2;
  return static_cast<std::uint8_t>((sum + kCellPixels / 2 - 1 + odd) / kCellPixels);
}

bool any_set(const std::uint8_t* mask, int count) {
  std::array<std::uint64_t, kStrip / sizeof(std::uint64_t)> words{};
  std::memcpy(words.data(), mask, static_cast<std::size_t>(count));
  return std::any_of(words.begin(), words.end(), [](std::uint64_t word) { return word != 0; });
}

}  // namespace

void mean_of_cells(const cv::Mat& gray, cv::Mat& cells) {
  cells.create(gray.size() / kCell, CV_8UC1);
  const int whole = cells.cols * kCell / kBlock * kBlock;
  for (int y = 0; y < cells.rows; ++y) {
    const std::uint8_t* top = gray.ptr(kCell * y);
    std::uint8_t* out = cells.ptr(y);
    for (int x = 0; x < whole; x += kBlock) {
      const auto sums = column_sums(top + x, gray.step);
      for (std::size_t i = 0; i < kBlock; i += kCell) {
        *out++ = rounded_mean(sums[i] + sums[i + 1] + sums[i + 2] + sums[i + 3]);
      }
    }
    for (int x = whole; x < cells.cols * kCell; x += kCell) {
      int sum = 0;
      for (int v = 0; v < kCell; ++v) {
        const std::uint8_t* row = gray.ptr(kCell * y + v) + x;
        sum += row[0] + row[1] + row[2] + row[3];
      }
      *out++ = rounded_mean(sum);
    }
  }
}

void split_depth(const cv::Mat& depth, const cv::Mat& mask, cv::Mat& seen, cv::Mat& hidden) {
  seen.create(depth.size(), CV_32FC1);
  hidden.create(depth.size(), CV_32FC1);
  for (int y = 0; y < depth.rows; ++y) {
    const std::uint8_t* masked = mask.ptr(y);
    const auto* whole = depth.ptr<float>(y);
    auto* left = seen.ptr<float>(y);
    std::copy_n(whole, depth.cols, left);
    for (int x = 0; x < depth.cols; x += kStrip) {
      const int count = std::min(kStrip, depth.cols - x);
      if (!any_set(masked + x, count)) continue;
      std::copy_n(whole + x, count, hidden.ptr<float>(y) + x);
      for (int i = x; i < x + count; ++i) left[i] = masked[i] != 0 ? 0.0F : whole[i];
    }
  }
}

}  // namespace dynslam::slam
