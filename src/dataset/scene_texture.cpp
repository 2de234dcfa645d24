#include "scene_texture.hpp"

#include <algorithm>
#include <cmath>

namespace dynslam::dataset::scene {

namespace {

/// Square lattice of random values in [-1, 1] that repeats.
struct Lattice {
  int columns, rows;
  std::vector<float> values;
  Lattice(Random& random, int columns_, int rows_)
      : columns(columns_), rows(rows_), values(static_cast<std::size_t>(columns_ * rows_)) {
    for (float& value : values) value = random.uniformf(-1.0F, 1.0F);
  }
  float at(int column, int row) const {
    return values[static_cast<std::size_t>((row % rows) * columns + column % columns)];
  }
};

float smooth(float x) { return x * x * (3.0F - 2.0F * x); }

std::uint32_t byte(float x) {
  return static_cast<std::uint32_t>(std::clamp(x + 0.5F, 0.0F, 255.0F));
}
void pack(const Color& c, GrainTexel* texel) { *texel = static_cast<GrainTexel>(byte(c.g)); }
void pack(const Color& c, ColorTexel* texel) {
  *texel = byte(c.b) | byte(c.g) << 8 | byte(c.r) << 16 | 0xFF000000U;
}

}  // namespace

Color random_color(Random& random, float brightness, float saturation) {
  const float hue = random.uniformf(0.0F, 6.0F);
  const auto channel = [&](float shift) {
    const float x = std::fmod(hue + shift, 6.0F);
    const float k = std::clamp(std::abs(x - 3.0F) - 1.0F, 0.0F, 1.0F);
    return brightness * (1.0F - saturation * (1.0F - k));
  };
  return {channel(2.0F), channel(4.0F), channel(0.0F)};
}

Canvas::Canvas(int width, int height, Color fill)
    : width_(width), height_(height), pixels_(static_cast<std::size_t>(width * height), fill) {}

void Canvas::modulate(Random& random, float amplitude, int cells, int octaves, float gain,
                      float stretch) {
  const auto width = static_cast<std::size_t>(width_);
  std::vector<float> noise(pixels_.size(), 0.0F);
  std::vector<std::int32_t> column(width);
  std::vector<float> weight_x(width), line;
  float weight = 1.0F, total = 0.0F;
  for (int octave = 0; octave < octaves; ++octave, cells *= 2, weight *= gain) {
    const int rows = std::max(1, cells);
    const float wanted =
        static_cast<float>(cells * width_) / (stretch * static_cast<float>(height_));
    const int columns = std::max(1, static_cast<int>(wanted));
    const Lattice lattice(random, columns, rows);
    total += weight;
    for (std::size_t x = 0; x < width; ++x) {
      const float u =
          static_cast<float>(x) * static_cast<float>(columns) / static_cast<float>(width_);
      column[x] = static_cast<std::int32_t>(u);
      weight_x[x] = smooth(u - static_cast<float>(column[x]));
    }
    line.assign(static_cast<std::size_t>(columns) + 1, 0.0F);
    for (int y = 0; y < height_; ++y) {
      const float v =
          static_cast<float>(y) * static_cast<float>(rows) / static_cast<float>(height_);
      const int row = static_cast<int>(v);
      const float fy = smooth(v - static_cast<float>(row));
      for (int c = 0; c <= columns; ++c) {
        const float above = lattice.at(c, row), below = lattice.at(c, row + 1);
        line[static_cast<std::size_t>(c)] = weight * (above + fy * (below - above));
      }
      float* out = noise.data() + static_cast<std::size_t>(y) * width;
      for (std::size_t x = 0; x < width; ++x) {
        const float* at = line.data() + column[x];
        out[x] += at[0] + weight_x[x] * (at[1] - at[0]);
      }
    }
  }
  for (std::size_t i = 0; i < pixels_.size(); ++i) {
    pixels_[i] = pixels_[i] * (1.0F + amplitude * noise[i] / total);
  }
}

void Canvas::rectangle(int x, int y, int width, int height, Color color) {
  for (int row = y; row < y + height; ++row) {
    for (int column = x; column < x + width; ++column) at(column, row) = color;
  }
}

void Canvas::disc(int x, int y, int radius, Color color) {
  for (int dy = -radius; dy <= radius; ++dy) {
    const int half = static_cast<int>(std::sqrt(static_cast<float>(radius * radius - dy * dy)));
    for (int dx = -half; dx <= half; ++dx) at(x + dx, y + dy) = color;
  }
}

void Canvas::print(Random& random, int x, int y, int width, int height, int line, Color ink) {
  const int letter = std::max(2, line / 2);
  for (int row = y; row + line <= y + height; row += line + std::max(1, line / 2)) {
    int column = x;
    while (column + letter <= x + width) {
      const int wide = std::min(x + width - column, letter / 2 + 1 + random.below(letter));
      const int tall = random.chance(0.3) ? line : line * 2 / 3 + 1;
      rectangle(column, row + line - tall, wide, tall, ink);
      if (wide > 3 && random.chance(0.6)) {  // the counter of a letter
        rectangle(column + wide / 3, row + line - tall + tall / 3, std::max(1, wide / 3),
                  std::max(1, tall / 3), ink * 0.4F + Color{140.0F, 140.0F, 140.0F});
      }
      column += wide + std::max(1, letter / 3) + (random.chance(0.2) ? letter : 0);
    }
  }
}

void Canvas::scatter(Random& random, int count, int low, int high, float brightness,
                     float saturation) {
  for (int i = 0; i < count; ++i) {
    const Color color = random_color(random, brightness * random.uniformf(0.25F, 1.0F), saturation);
    const int x = random.below(width_), y = random.below(height_);
    const int a = low + random.below(high - low + 1), b = low + random.below(high - low + 1);
    if (random.chance(0.7)) {
      rectangle(x, y, a, b, color);
    } else {
      disc(x, y, a / 2 + 1, color);
    }
  }
}

template <typename Texel>
MipMap<Texel>::MipMap(const Canvas& canvas) : width_(canvas.width()), height_(canvas.height()) {
  int w = width_, h = height_;
  texels_.reserve(canvas.pixels().size() * 4 / 3 + 16);
  add_level(canvas.pixels(), w, h);
  std::vector<Color> pixels = canvas.pixels();
  while (w > 1 && h > 1) {  // every level is the mean of 2 x 2 texels of the one before
    std::vector<Color> half(static_cast<std::size_t>(w / 2 * (h / 2)));
    for (int y = 0; y < h / 2; ++y) {
      for (int x = 0; x < w / 2; ++x) {
        const auto p = static_cast<std::size_t>(2 * y * w + 2 * x);
        const auto q = p + static_cast<std::size_t>(w);
        half[static_cast<std::size_t>(y * (w / 2) + x)] =
            (pixels[p] + pixels[p + 1] + pixels[q] + pixels[q + 1]) * 0.25F;
      }
    }
    pixels.swap(half);
    w /= 2;
    h /= 2;
    add_level(pixels, w, h);
  }
}

template <typename Texel>
void MipMap<Texel>::add_level(const std::vector<Color>& pixels, int width, int height) {
  int shift = 0;
  while ((1 << shift) < width) ++shift;
  levels_.push_back({static_cast<std::uint32_t>(texels_.size()), width - 1, height - 1, shift});
  const std::size_t first = texels_.size();
  texels_.resize(first + pixels.size());
  for (std::size_t i = 0; i < pixels.size(); ++i) pack(pixels[i], &texels_[first + i]);
}

template class MipMap<ColorTexel>;
template class MipMap<GrainTexel>;

}  // namespace dynslam::dataset::scene
