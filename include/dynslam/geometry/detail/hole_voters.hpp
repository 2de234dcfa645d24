// Pixels without depth take the label of those with depth around them; a part of region_grow.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "dynslam/core/image_view.hpp"

namespace dynslam::geometry::detail {

/// Where an image has depth: 255, else 0, as outside of the image.
struct KnownPixels {
  static constexpr int kMargin = 10;  // pixels around the image
  static constexpr int kGroup = 4;    // pixels that are read as one word

  int pitch = 0;
  std::vector<std::uint8_t> values;

  void fill(ImageView<const float> depth) {
    pitch = depth.width + 2 * kMargin + kGroup;
    values.assign(static_cast<std::size_t>(pitch) * (depth.height + 2 * kMargin), 0);
    for (int y = 0; y < depth.height; ++y) {
      const float* z = depth.row(y);
      std::uint8_t* to = &values[index(0, y)];
      for (int x = 0; x < depth.width; ++x) {
        const bool known = (z[x] > 0.0F) & (z[x] <= std::numeric_limits<float>::max());
        to[x] = known ? 255 : 0;
      }
    }
  }
  std::size_t index(int x, int y) const {
    return static_cast<std::size_t>(y + kMargin) * pitch + x + kMargin;
  }
  const std::uint8_t* at(int x, int y) const { return &values[index(x, y)]; }

  /// kGroup pixels of a row, a byte each, as they lie in memory.
  static std::uint32_t group(const std::uint8_t* first) {
    std::uint32_t word = 0;
    std::memcpy(&word, first, sizeof(word));
    return word;
  }
};

/// The pixels with depth nearest to each of a group of pixels, in eight directions.
struct HoleVoters {
  static constexpr int kReach = KnownPixels::kMargin;  // pixels
  static constexpr int kSteps[8][2] = {{1, 0}, {-1, 0},  {0, 1},  {0, -1},
                                       {1, 1}, {-1, -1}, {1, -1}, {-1, 1}};

  std::uint8_t away[8][KnownPixels::kGroup];  ///< pixels; 0 = none

  /// Of the pixels from `first` on. Looks from far to near, so that nothing waits for what is
  /// found.
  HoleVoters(const std::uint8_t* first, std::ptrdiff_t pitch) {
    for (int d = 0; d < 8; ++d) {
      const std::ptrdiff_t step = kSteps[d][1] * pitch + kSteps[d][0];
      std::uint32_t nearest = 0;  // a byte a pixel
      for (int i = kReach; i >= 1; --i) {
        const std::uint32_t steps = 0x01010101U * static_cast<std::uint32_t>(i);
        nearest ^= (nearest ^ steps) & KnownPixels::group(first + i * step);
      }
      std::memcpy(away[d], &nearest, sizeof(nearest));
    }
  }

  /// The label of the i-th pixel, (x, y): the voters count by likeness and nearness.
  std::uint8_t label(ImageView<const std::uint8_t> guide, ImageView<std::uint8_t> mask, int i,
                     int x, int y) const {
    constexpr float kLikeness = 12.0F;  // grey levels
    int count = 0, moving = 0;
    for (int d = 0; d < 8; ++d) {
      const int steps = away[d][i], found = steps > 0 ? 1 : 0;
      count += found;
      moving += found & mask(x + steps * kSteps[d][0], y + steps * kSteps[d][1]) >> 7;
    }
    if (count == 0) return mask(x, y);
    if (moving == 0 || moving == count) return moving == 0 ? 0 : 255;  // no need to weigh votes
    float dynamic = 0.0F, total = 0.0F;
    for (int d = 0; d < 8; ++d) {
      const int steps = away[d][i];
      if (steps == 0) continue;
      const int u = x + steps * kSteps[d][0], v = y + steps * kSteps[d][1];
      const float unlike = static_cast<float>(std::abs(guide(u, v) - guide(x, y))) / kLikeness;
      const float vote = 1.0F / ((1.0F + unlike * unlike) * static_cast<float>(1 + steps));
      total += vote;
      dynamic += mask(u, v) != 0 ? vote : 0.0F;
    }
    return 2.0F * dynamic > total ? 255 : 0;
  }
};

/// Gives the pixels of a cell that have no depth the label for which those around them vote.
inline void settle_by_vote(const KnownPixels& known, int stride, int cx, int cy,
                           ImageView<const std::uint8_t> guide, ImageView<std::uint8_t> mask) {
  constexpr int kGroup = KnownPixels::kGroup;
  const int x1 = std::min((cx + 1) * stride, mask.width);
  for (int y = cy * stride; y < std::min((cy + 1) * stride, mask.height); ++y) {
    for (int x = cx * stride; x < x1; x += kGroup) {
      const std::uint8_t* here = known.at(x, y);
      if (KnownPixels::group(here) == ~std::uint32_t{0}) continue;
      const HoleVoters voters(here, known.pitch);
      for (int i = 0; i < std::min(kGroup, x1 - x); ++i) {
        if (here[i] == 0) mask(x + i, y) = voters.label(guide, mask, i, x + i, y);
      }
    }
  }
}

}  // namespace dynslam::geometry::detail
