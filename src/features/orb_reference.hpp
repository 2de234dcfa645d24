// Plain loops for every stage of the ORB extractor: the oracle of the tests and what runs on
// machines without vectors. All arithmetic is on integers or rounded step by step, so the
// vectorized kernels give the same bits.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "features/orb_kernels.hpp"
#include "features/orb_pattern.hpp"

namespace dynslam::features::detail::reference {

inline void resize_level(const PixelBlock& source, const ResizeAxis& columns,
                         const ResizeAxis& rows, const MutablePixelBlock& target) {
  for (int y = 0; y < target.height; ++y) {
    const std::uint8_t* upper = source.row(rows.first[y]);
    const std::uint8_t* lower = upper + source.stride;
    const int wy = rows.weight[y];
    for (int x = 0; x < target.width; ++x) {
      const int at = columns.first[x];
      const int left = upper[at] * (256 - wy) + lower[at] * wy;
      const int right = upper[at + 1] * (256 - wy) + lower[at + 1] * wy;
      const int wx = columns.weight[x];
      target.row(y)[x] =
          static_cast<std::uint8_t>((left * (256 - wx) + right * wx + (1 << 15)) >> 16);
    }
  }
}

/// Index of the pixel that lies at `i` when the image is mirrored at its border pixels.
inline int mirrored(int i, int size) {
  if (i < 0) i = -i;
  return i < size ? i : 2 * size - 2 - i;
}

inline void blur_level(const PixelBlock& source, const MutablePixelBlock& target) {
  for (int y = 0; y < source.height; ++y) {
    for (int x = 0; x < source.width; ++x) {
      int sum = 1 << 15;
      for (int j = -3; j <= 3; ++j) {
        const std::uint8_t* row = source.row(mirrored(y + j, source.height));
        int row_sum = 0;
        for (int i = -3; i <= 3; ++i) {
          row_sum += kBlurWeights[i + 3] * row[mirrored(x + i, source.width)];
        }
        sum += kBlurWeights[j + 3] * row_sum;
      }
      target.row(y)[x] = static_cast<std::uint8_t>(sum >> 16);
    }
  }
}

/// Largest t at which the pixel is a FAST-9 corner (nine neighbours in a row on the circle all
/// brighter than centre + t or all darker than centre - t), or 0 if it is none at `threshold`.
inline std::uint8_t fast_score(const std::uint8_t* pixel, std::ptrdiff_t stride, int threshold) {
  // An arc of nine holds one of two opposite pixels at least.
  const int right = std::abs(pixel[3] - pixel[0]);
  const int left = std::abs(pixel[-3] - pixel[0]);
  if (std::max(right, left) <= threshold) return 0;
  int best = 0;
  for (int start = 0; start < 16; ++start) {
    int brighter = 255;
    int darker = 255;
    for (int k = start; k < start + 9; ++k) {
      const CircleOffset& offset = kCircle[k % 16];
      const int difference = pixel[offset.y * stride + offset.x] - pixel[0];
      brighter = std::min(brighter, difference);
      darker = std::min(darker, -difference);
    }
    best = std::max({best, brighter, darker});
  }
  return static_cast<std::uint8_t>(best > threshold ? best - 1 : 0);
}

/// A corner beats the neighbours before it (by rows) strictly and is not beaten by those after it,
/// so that of two equal neighbours one stays.
inline bool is_peak(const std::uint8_t* above, const std::uint8_t* score,
                    const std::uint8_t* below) {
  const int before = std::max({above[-1], above[0], above[1], score[-1]});
  const int after = std::max({below[-1], below[0], below[1], score[1]});
  return score[0] > before && score[0] >= after;
}

inline int fast_corners(const PixelBlock& level, int border, int threshold, std::uint8_t* scratch,
                        Corner* corners) {
  const std::ptrdiff_t stride = level.stride;
  int count = 0;
  for (int y = border - 1; y <= level.height - border; ++y) {
    std::uint8_t* scores = scratch + (y % 3) * stride;
    for (int x = border - 1; x <= level.width - border; ++x) {
      scores[x] = fast_score(level.row(y) + x, stride, threshold);
    }
    if (y < border + 1) continue;
    const std::uint8_t* above = scratch + ((y - 2) % 3) * stride;
    const std::uint8_t* middle = scratch + ((y - 1) % 3) * stride;
    for (int x = border; x < level.width - border; ++x) {
      if (middle[x] != 0 && is_peak(above + x, middle + x, scores + x)) {
        corners[count++] = {static_cast<std::uint16_t>(x), static_cast<std::uint16_t>(y - 1),
                            middle[x], peak_offset(middle[x - 1], middle[x], middle[x + 1]),
                            peak_offset(above[x], middle[x], scores[x])};
      }
    }
  }
  return count;
}

inline void patch_moments(const PixelBlock& level, const Corner* corners, int count,
                          std::int32_t* m10, std::int32_t* m01) {
  for (int i = 0; i < count; ++i) {
    const std::uint8_t* centre = level.row(corners[i].y) + corners[i].x;
    m10[i] = 0;
    m01[i] = 0;
    for (int v = -kPatchRadius; v <= kPatchRadius; ++v) {
      const int reach = kPatchReach[v < 0 ? -v : v];
      for (int u = -reach; u <= reach; ++u) {
        const int value = centre[v * level.stride + u];
        m10[i] += u * value;
        m01[i] += v * value;
      }
    }
  }
}

struct PatternPoint {
  int x, y;
};

/// Point of the pattern turned by the angle, to the nearest pixel.
inline PatternPoint turned(int x, int y, const Rotation& rotation) {
  const float px = static_cast<float>(x);
  const float py = static_cast<float>(y);
  const float turned_x = px * rotation.cos - py * rotation.sin;
  const float turned_y = px * rotation.sin + py * rotation.cos;
  return {static_cast<int>(std::nearbyint(turned_x)), static_cast<int>(std::nearbyint(turned_y))};
}

/// Descriptor of the patch whose pixel at (x, y) from the key point is `pixel(x, y)`.
template <typename Pixel>
void describe_patch(const Rotation& rotation, const Pixel& pixel, std::uint8_t* descriptor) {
  for (int byte = 0; byte < kPairs / 8; ++byte) {
    unsigned bits = 0;
    for (unsigned bit = 0; bit < 8; ++bit) {
      const std::int8_t* pair = kOrbPattern[static_cast<unsigned>(byte) * 8 + bit];
      const PatternPoint a = turned(pair[0], pair[1], rotation);
      const PatternPoint b = turned(pair[2], pair[3], rotation);
      if (pixel(a.x, a.y) < pixel(b.x, b.y)) bits |= 1U << bit;
    }
    descriptor[byte] = static_cast<std::uint8_t>(bits);
  }
}

inline void rotated_brief(const PixelBlock& blurred, const Corner* corners,
                          const Rotation* rotations, int count, std::uint8_t* descriptors) {
  for (int i = 0; i < count; ++i) {
    const std::uint8_t* centre = blurred.row(corners[i].y) + corners[i].x;
    const auto pixel = [&](int x, int y) { return centre[y * blurred.stride + x]; };
    describe_patch(rotations[i], pixel, descriptors + static_cast<std::ptrdiff_t>(i) * kPairs / 8);
  }
}

}  // namespace dynslam::features::detail::reference
