// Textures of the rendered scene: painted once, sampled with mip maps.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "scene_random.hpp"

namespace dynslam::dataset::scene {

/// Colour as stored in the picture (gamma already applied), 0..255 a channel.
struct Color {
  float b = 0.0F, g = 0.0F, r = 0.0F;
  friend Color operator*(Color c, float k) { return {c.b * k, c.g * k, c.r * k}; }
  friend Color operator+(Color a, Color c) { return {a.b + c.b, a.g + c.g, a.r + c.r}; }
};

/// Any colour; brightness is the greatest channel.
Color random_color(Random& random, float brightness, float saturation);

/// Picture in the making. Both sides are powers of two; the borders wrap around.
class Canvas {
 public:
  Canvas(int width, int height, Color fill);
  int width() const { return width_; }
  int height() const { return height_; }
  const std::vector<Color>& pixels() const { return pixels_; }
  Color& at(int x, int y) { return pixels_[static_cast<std::size_t>(index(x, y))]; }
  const Color& at(int x, int y) const { return pixels_[static_cast<std::size_t>(index(x, y))]; }

  /// Multiplies brightness with 1 + amplitude * noise, where noise in [-1, 1] is a sum of octaves
  /// of value noise from `cells` cells across the height, each octave `gain` times as strong as the
  /// one before. `stretch` > 1 draws the noise out along x.
  void modulate(Random& random, float amplitude, int cells, int octaves, float gain,
                float stretch = 1.0F);
  /// Filled rectangle; outside the canvas it wraps around.
  void rectangle(int x, int y, int width, int height, Color color);
  void disc(int x, int y, int radius, Color color);
  /// Rows of small blocks of random widths like lines of print.
  void print(Random& random, int x, int y, int width, int height, int line, Color ink);
  /// Rectangles and discs of random place, colour and size in [low, high] pixels.
  void scatter(Random& random, int count, int low, int high, float brightness, float saturation);

 private:
  int index(int x, int y) const { return (y & (height_ - 1)) * width_ + (x & (width_ - 1)); }
  int width_, height_;
  std::vector<Color> pixels_;
};

// Texels and their filters: the inner loop of shading, hence in the header.

/// B, G, R, 255. Two channels at a time ride in one word, each with eight bits of room for weights.
using ColorTexel = std::uint32_t;
/// One channel.
using GrainTexel = std::uint8_t;

inline constexpr std::uint32_t kEvenBytes = 0x00FF00FFU;

/// Sum of four texels; the weights are 256 in all.
inline std::uint32_t weigh(const ColorTexel& a, const ColorTexel& b, const ColorTexel& c,
                           const ColorTexel& d, const std::uint32_t* w) {
  const std::uint32_t even = ((a & kEvenBytes) * w[0] + (b & kEvenBytes) * w[1] +
                              (c & kEvenBytes) * w[2] + (d & kEvenBytes) * w[3]) >>
                             8;
  const std::uint32_t odd = ((a >> 8) & kEvenBytes) * w[0] + ((b >> 8) & kEvenBytes) * w[1] +
                            ((c >> 8) & kEvenBytes) * w[2] + ((d >> 8) & kEvenBytes) * w[3];
  return (even & kEvenBytes) | (odd & ~kEvenBytes);
}
inline std::uint32_t weigh(const GrainTexel& a, const GrainTexel& b, const GrainTexel& c,
                           const GrainTexel& d, const std::uint32_t* w) {
  return (a * w[0] + b * w[1] + c * w[2] + d * w[3]) >> 8;
}

/// Mip-mapped texture that repeats in both directions.
template <typename Texel>
class MipMap {
 public:
  MipMap() = default;
  explicit MipMap(const Canvas& canvas);
  int width() const { return width_; }
  int height() const { return height_; }

  /// Colour (in the layout of the texel) at texel coordinates (s, t) >= 0 of the finest level
  /// (texel centres at integers + 0.5), filtered over 2^lod texels. Bilinear within a level;
  /// between two levels it blends over the middle half of the way only, which saves the second
  /// level half of the time.
  std::uint32_t sample(float s, float t, float lod) const {
    const auto x = static_cast<int>(s * 256.0F), y = static_cast<int>(t * 256.0F);
    const int last = static_cast<int>(levels_.size()) - 1;
    const int fixed = lod > 0.0F ? static_cast<int>(lod * 256.0F) : 0;
    const int level = fixed >> 8;
    if (level >= last) return bilinear(last, x, y);
    const int rest = fixed & 255;
    if (rest <= 64) return bilinear(level, x, y);
    if (rest >= 192) return bilinear(level + 1, x, y);
    const auto weight = static_cast<std::uint32_t>(2 * (rest - 64));
    const std::uint32_t weights[4] = {256U - weight, weight, 0U, 0U};
    const auto a = static_cast<Texel>(bilinear(level, x, y));
    const auto b = static_cast<Texel>(bilinear(level + 1, x, y));
    return weigh(a, b, a, a, weights);
  }

 private:
  struct Level {
    std::uint32_t offset;
    int mask_x, mask_y, shift;
  };

  /// x and y in 1/256 texel of the finest level.
  std::uint32_t bilinear(int level, int x, int y) const {
    const Level& l = levels_[static_cast<std::size_t>(level)];
    x = (x >> level) - 128;  // to the texel whose centre is left of and above the sample
    y = (y >> level) - 128;
    const auto fx = static_cast<std::uint32_t>(x & 255), fy = static_cast<std::uint32_t>(y & 255);
    const std::uint32_t both = (fx * fy + 128U) >> 8;
    const std::uint32_t weights[4] = {256U - fx - fy + both, fx - both, fy - both, both};
    const int x0 = (x >> 8) & l.mask_x, x1 = ((x >> 8) + 1) & l.mask_x;
    const int y0 = (y >> 8) & l.mask_y, y1 = ((y >> 8) + 1) & l.mask_y;
    const Texel* row0 = texels_.data() + l.offset + (y0 << l.shift);
    const Texel* row1 = texels_.data() + l.offset + (y1 << l.shift);
    return weigh(row0[x0], row0[x1], row1[x0], row1[x1], weights);
  }
  void add_level(const std::vector<Color>& pixels, int width, int height);

  int width_ = 0, height_ = 0;
  std::vector<Level> levels_;
  std::vector<Texel> texels_;
};

using Texture = MipMap<ColorTexel>;
using Grain = MipMap<GrainTexel>;
extern template class MipMap<ColorTexel>;
extern template class MipMap<GrainTexel>;

}  // namespace dynslam::dataset::scene
