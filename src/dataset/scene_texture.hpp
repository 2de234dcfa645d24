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

/// Mip-mapped texture that repeats in both directions, four bytes a texel: B, G, R, 255.
class Texture {
 public:
  Texture() = default;
  explicit Texture(const Canvas& canvas);
  int width() const { return width_; }
  int height() const { return height_; }

  /// Colour at texel coordinates (s, t) >= 0 of the finest level (texel centres at integers + 0.5),
  /// filtered over 2^lod texels. Bilinear within a level; between two levels it blends over the
  /// middle half of the way only, which saves the second level half of the time.
  std::uint32_t sample(float s, float t, float lod) const;

 private:
  struct Level {
    std::uint32_t offset;
    int mask_x, mask_y, shift;
  };
  std::uint32_t bilinear(int level, int x, int y) const;
  void add_level(const std::vector<Color>& pixels, int width, int height);

  int width_ = 0, height_ = 0;
  std::vector<Level> levels_;
  std::vector<std::uint32_t> texels_;
};

// Filtering: the inner loop of shading, hence in the header. Two colour channels at a time ride in
// one 32-bit word, each with eight bits of room for its weight.

inline constexpr std::uint32_t kEvenBytes = 0x00FF00FFU;

/// a + (b - a) * weight / 256 in each of the four bytes.
inline std::uint32_t blend(std::uint32_t a, std::uint32_t b, std::uint32_t weight) {
  const std::uint32_t back = 256U - weight;
  const std::uint32_t even = ((a & kEvenBytes) * back + (b & kEvenBytes) * weight) >> 8;
  const std::uint32_t odd = ((a >> 8) & kEvenBytes) * back + ((b >> 8) & kEvenBytes) * weight;
  return (even & kEvenBytes) | (odd & ~kEvenBytes);
}

/// x and y in 1/256 texel of the finest level.
inline std::uint32_t Texture::bilinear(int level, int x, int y) const {
  const Level& l = levels_[static_cast<std::size_t>(level)];
  x = (x >> level) - 128;  // to the texel whose centre is left of and above the sample
  y = (y >> level) - 128;
  const auto fx = static_cast<std::uint32_t>(x & 255), fy = static_cast<std::uint32_t>(y & 255);
  const std::uint32_t w11 = (fx * fy + 128U) >> 8, w10 = fx - w11, w01 = fy - w11;
  const std::uint32_t w00 = 256U - fx - fy + w11;
  const int x0 = (x >> 8) & l.mask_x, x1 = ((x >> 8) + 1) & l.mask_x;
  const std::uint32_t* row0 = texels_.data() + l.offset + ((((y >> 8)) & l.mask_y) << l.shift);
  const std::uint32_t* row1 = texels_.data() + l.offset + ((((y >> 8) + 1) & l.mask_y) << l.shift);
  const std::uint32_t a = row0[x0], b = row0[x1], c = row1[x0], d = row1[x1];
  const std::uint32_t even = ((a & kEvenBytes) * w00 + (b & kEvenBytes) * w10 +
                              (c & kEvenBytes) * w01 + (d & kEvenBytes) * w11) >> 8;
  const std::uint32_t odd = ((a >> 8) & kEvenBytes) * w00 + ((b >> 8) & kEvenBytes) * w10 +
                            ((c >> 8) & kEvenBytes) * w01 + ((d >> 8) & kEvenBytes) * w11;
  return (even & kEvenBytes) | (odd & ~kEvenBytes);
}

inline std::uint32_t Texture::sample(float s, float t, float lod) const {
  const auto x = static_cast<int>(s * 256.0F), y = static_cast<int>(t * 256.0F);
  const int last = static_cast<int>(levels_.size()) - 1;
  const int fixed = lod > 0.0F ? static_cast<int>(lod * 256.0F) : 0;
  int level = fixed >> 8;
  if (level >= last) return bilinear(last, x, y);
  const int rest = fixed & 255;
  if (rest <= 64) return bilinear(level, x, y);
  if (rest >= 192) return bilinear(level + 1, x, y);
  return blend(bilinear(level, x, y), bilinear(level + 1, x, y),
               static_cast<std::uint32_t>(2 * (rest - 64)));
}

}  // namespace dynslam::dataset::scene
