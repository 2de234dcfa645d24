// Motion blur, gain and noise.
#include <algorithm>
#include <cmath>

#include "scene_frame.hpp"

namespace dynslam::dataset::scene {

namespace {

/// Greatest distance that a pixel is smeared to each side; faster motion is cut off.
constexpr int kReach = 7;

/// Weights of a straight smear, 256 in all, as offsets into the picture.
struct Smear {
  struct Tap {
    int dx, dy;
    std::uint16_t weight;
  };
  std::vector<Tap> taps;
  bool none() const { return taps.size() <= 1; }

  /// Motion (vx, vy) pixels during the exposure: the mean over it, each point of the line shared
  /// among the four pixels around it. Symmetrical, so that nothing moves.
  Smear(double vx, double vy) {
    const double length = std::max(std::abs(vx), std::abs(vy));
    if (!(length > 0.25)) {
      taps.push_back({0, 0, 256});
      return;
    }
    const double cut = std::min(1.0, 2.0 * (kReach - 1) / length);
    vx *= cut;
    vy *= cut;
    constexpr int kSide = 2 * kReach + 1;
    double weight[kSide][kSide] = {};
    const int points = 2 * static_cast<int>(std::ceil(length * cut)) + 2;
    for (int i = 0; i < points; ++i) {
      const double along = (i + 0.5) / points - 0.5;
      const double x = vx * along + kReach, y = vy * along + kReach;
      const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
      const double fx = x - x0, fy = y - y0;
      weight[y0][x0] += (1 - fx) * (1 - fy) / points;
      weight[y0][x0 + 1] += fx * (1 - fy) / points;
      weight[y0 + 1][x0] += (1 - fx) * fy / points;
      weight[y0 + 1][x0 + 1] += fx * fy / points;
    }
    int rest = 256;
    std::size_t center = 0;
    for (int dy = -kReach; dy <= kReach; ++dy) {
      for (int dx = -kReach; dx <= kReach; ++dx) {
        const int w = static_cast<int>(std::lround(256.0 * weight[dy + kReach][dx + kReach]));
        if (dx == 0 && dy == 0) center = taps.size();
        if (w == 0 && (dx != 0 || dy != 0)) continue;
        taps.push_back({dx, dy, static_cast<std::uint16_t>(w)});
        rest -= w;
      }
    }
    taps[center].weight = static_cast<std::uint16_t>(taps[center].weight + rest);
  }
};

constexpr int kTileBytes = 4 * kTile;
using Sums = std::array<std::array<std::uint16_t, kTileBytes>, kTile>;

/// sums += weight * picture around (x, y), byte by byte.
void smear(const std::uint32_t* picture, int stride, const Smear& kernel, Sums& sums) {
  for (auto& line : sums) line.fill(0);
  for (const Smear::Tap& tap : kernel.taps) {
    for (int row = 0; row < kTile; ++row) {
      const auto* from =
          reinterpret_cast<const std::uint8_t*>(picture + (row + tap.dy) * stride + tap.dx);
      std::uint16_t* to = sums[static_cast<std::size_t>(row)].data();
      for (int i = 0; i < kTileBytes; ++i) {
        to[i] = static_cast<std::uint16_t>(to[i] + tap.weight * from[i]);
      }
    }
  }
}

/// Motion in the image of the point at pixel (u, v) with inverse depth w under a twist.
Eigen::Vector2d image_motion(const PinholeCamera& camera, const Vector6d& twist, double u, double v,
                             double w) {
  const Eigen::Vector3d d = camera.bearing({u, v});
  // X = d / w moves by rho + omega x X; the image by its perspective derivative.
  const Eigen::Vector3d m = w * twist.head<3>() + twist.tail<3>().cross(d);
  return {camera.fx * (m.x() - d.x() * m.z()), camera.fy * (m.y() - d.y() * m.z())};
}

class Blur {
 public:
  Blur(const World& world, const View& view, const Exposure& exposure, const Workspace& work)
      : world_(world), view_(view), exposure_(exposure), work_(work) {
    tiles_.resize(static_cast<std::size_t>(work.columns * work.rows));
    for (int row = 0; row < work.rows; ++row) {
      for (int column = 0; column < work.columns; ++column) measure(column, row);
    }
  }

  /// Blurred tile, packed colours row by row.
  void tile(int column, int row, std::uint32_t* out) const {
    const std::uint32_t* picture = work_.color.data() + work_.color_at(column * kTile, row * kTile);
    const Neighbourhood near = look_around(column, row);
    const Tile& here = at(column, row);
    const Smear still = motion_of(here.still, here.still_pixels);
    Sums sums;
    if (near.moving_pixels == 0) {
      smear(picture, work_.color_stride, still, sums);
      pack(sums, out);
      return;
    }
    const Smear moving = motion_of(near.moving, near.moving_pixels);
    if (near.still_pixels == 0) {
      smear(picture, work_.color_stride, moving, sums);
      pack(sums, out);
      return;
    }
    // Two layers: what moves, smeared over what does not.
    const Smear behind = motion_of(near.still, near.still_pixels);
    std::uint32_t front[kLayerSide * kLayerSide], back[kLayerSide * kLayerSide];
    split(column, row, front, back);
    const int middle = kReach * kLayerSide + kReach;
    Sums back_sums;
    smear(front + middle, kLayerSide, moving, sums);
    smear(back + middle, kLayerSide, behind, back_sums);
    compose(sums, back_sums, out);
  }

 private:
  static constexpr int kLayerSide = kTile + 2 * kReach;
  struct Tile {
    Eigen::Vector2d still = Eigen::Vector2d::Zero(), moving = Eigen::Vector2d::Zero();
    int still_pixels = 0, moving_pixels = 0;  ///< looked at, one in four
  };
  using Neighbourhood = Tile;

  const Tile& at(int column, int row) const {
    return tiles_[static_cast<std::size_t>(row * work_.columns + column)];
  }
  static Smear motion_of(const Eigen::Vector2d& sum, int pixels) {
    const double k = 1.0 / std::max(1, pixels);
    return {k * sum.x(), k * sum.y()};
  }
  bool moves(std::int32_t surface) const {
    return world_.surfaces[static_cast<std::size_t>(surface)].label != kStaticLabel;
  }

  /// Sums of the motions of every other pixel of every other line.
  void measure(int column, int row) {
    Tile& tile = tiles_[static_cast<std::size_t>(row * work_.columns + column)];
    for (int y = row * kTile + 1; y < (row + 1) * kTile; y += 2) {
      for (int x = column * kTile + 1; x < (column + 1) * kTile; x += 2) {
        const std::size_t i = work_.at(x, y);
        const Surface& surface = world_.surfaces[static_cast<std::size_t>(work_.surface[i])];
        const int body = world_.solids[static_cast<std::size_t>(surface.solid)].body;
        const Eigen::Vector2d v =
            image_motion(view_.camera(), exposure_.motion[static_cast<std::size_t>(body)], x, y,
                         static_cast<double>(work_.w[i]));
        if (body == 0) {
          tile.still += v;
          ++tile.still_pixels;
        } else {
          tile.moving += v;
          ++tile.moving_pixels;
        }
      }
    }
  }

  /// Tiles within reach of the blur together.
  Neighbourhood look_around(int column, int row) const {
    Neighbourhood near;
    for (int r = std::max(0, row - 1); r <= std::min(work_.rows - 1, row + 1); ++r) {
      for (int c = std::max(0, column - 1); c <= std::min(work_.columns - 1, column + 1); ++c) {
        const Tile& t = at(c, r);
        near.still += t.still;
        near.moving += t.moving;
        near.still_pixels += t.still_pixels;
        near.moving_pixels += t.moving_pixels;
      }
    }
    return near;
  }

  /// The picture around a tile as two, each transparent (0) where the other is not. Opaque pixels
  /// have 255 in their fourth byte.
  void split(int column, int row, std::uint32_t* front, std::uint32_t* back) const {
    const int right = work_.width - 1, bottom = work_.height - 1;
    for (int y = 0; y < kLayerSide; ++y) {
      for (int x = 0; x < kLayerSide; ++x) {
        const int px = column * kTile + x - kReach, py = row * kTile + y - kReach;
        const std::size_t i = work_.at(std::clamp(px, 0, right), std::clamp(py, 0, bottom));
        const std::uint32_t mask = moves(work_.surface[i]) ? 0xFFFFFFFFU : 0U;
        const std::uint32_t c = work_.color[work_.color_at(px, py)];
        front[y * kLayerSide + x] = c & mask;
        back[y * kLayerSide + x] = c & ~mask;
      }
    }
  }

  static void pack(const Sums& sums, std::uint32_t* out) {
    auto* bytes = reinterpret_cast<std::uint8_t*>(out);
    for (const auto& line : sums) {
      for (int i = 0; i < kTileBytes; ++i) {
        *bytes++ = static_cast<std::uint8_t>((line[static_cast<std::size_t>(i)] + 128) >> 8);
      }
    }
  }

  static void compose(const Sums& front, const Sums& back, std::uint32_t* out) {
    constexpr float kOpaque = 255.0F * 256.0F;
    auto* bytes = reinterpret_cast<std::uint8_t*>(out);
    for (std::size_t row = 0; row < kTile; ++row) {
      for (std::size_t x = 0; x < kTileBytes; x += 4, bytes += 4) {
        const float cover = static_cast<float>(front[row][x + 3]);
        const float seen = static_cast<float>(back[row][x + 3]);
        // What is hidden behind the front layer at all times has no say.
        const float k = seen > 0.0F ? (kOpaque - cover) / seen : 0.0F;
        const float whole = seen > 0.0F ? 1.0F : kOpaque / std::max(1.0F, cover);
        for (std::size_t c = 0; c < 3; ++c) {
          const float sum = whole * static_cast<float>(front[row][x + c]) +
                            k * static_cast<float>(back[row][x + c]);
          bytes[c] = static_cast<std::uint8_t>(std::min(255.0F, sum * (1.0F / 256.0F) + 0.5F));
        }
        bytes[3] = 255;
      }
    }
  }

  const World& world_;
  const View& view_;
  const Exposure& exposure_;
  const Workspace& work_;
  std::vector<Tile> tiles_;
};

/// Gain and noise of every possible value of a channel.
struct Response {
  std::array<std::int32_t, 256> value;      ///< 1/256 of a grey level, with the rounding half
  std::array<std::int32_t, 256> amplitude;  ///< 1/256 of a grey level a unit of the noise table
  Response(float gain, bool noise) {
    constexpr double kGamma = 2.2;
    for (std::size_t i = 0; i < 256; ++i) {
      const double light = gain * std::pow(static_cast<double>(i) / 255.0, kGamma);
      const double encoded = std::min(1.0, std::pow(light, 1.0 / kGamma));
      // Shot noise of about 6000 electrons at full well, read noise of 0.2 % of full scale; the
      // gamma curve passes them on with its slope, which the dark end limits.
      const double sigma = std::sqrt(std::min(light, 1.0) / 6000.0 + 0.002 * 0.002);
      const double slope = std::pow(std::max(light, 0.004), 1.0 / kGamma - 1.0) / kGamma;
      value[i] = static_cast<std::int32_t>(std::lround(encoded * 255.0 * 256.0)) + 128;
      amplitude[i] = noise ? static_cast<std::int32_t>(std::lround(sigma * slope * 255.0 * 256.0 *
                                                                   static_cast<double>(kNoiseUnit)))
                           : 0;
    }
  }
};

}  // namespace

void expose_frame(const World& world, const View& view, const Exposure& exposure, int threads,
                  Workspace& work, cv::Mat* image) {
  image->create(work.height, work.width, CV_8UC3);
  std::unique_ptr<Blur> blur;
  if (!exposure.motion.empty()) blur = std::make_unique<Blur>(world, view, exposure, work);
  const Response response(exposure.gain, exposure.noise);
  const NoiseTable& table = NoiseTable::get();
  in_parallel(threads, work.rows, [&](int first, int last, int) {
    std::uint32_t tile[kTilePixels];
    for (int row = first; row < last; ++row) {
      for (int column = 0; column < work.columns; ++column) {
        const int x0 = column * kTile, y0 = row * kTile;
        const int wide = std::min(kTile, work.width - x0);
        if (blur) blur->tile(column, row, tile);
        for (int line = 0; line < kTile && y0 + line < work.height; ++line) {
          const std::uint32_t* from =
              blur ? tile + line * kTile : work.color.data() + work.color_at(x0, y0 + line);
          const std::uint64_t hash = mix(exposure.seed, static_cast<std::uint64_t>(y0 + line));
          const std::int8_t* noise = table.from(hash) + 3 * x0;
          std::uint8_t* to = image->ptr<std::uint8_t>(y0 + line) + 3 * x0;
          for (int i = 0; i < wide; ++i) {
            std::uint32_t c = from[i];
            for (int channel = 0; channel < 3; ++channel, c >>= 8) {
              const std::size_t level = c & 255U;
              const std::int32_t v = response.value[level] + response.amplitude[level] * *noise++;
              *to++ = static_cast<std::uint8_t>(std::clamp(v >> 8, 0, 255));
            }
          }
        }
      }
    }
  });
}

NoiseTable::NoiseTable() : values_(65536 + 3 * 8192 + 64) {
  // Box and Muller's transform of a fixed sequence.
  Random random(0x5CE7E, 9);
  for (std::size_t i = 0; i < values_.size(); ++i) {
    const double radius = std::sqrt(-2.0 * std::log(1.0 - random.uniform()));
    const double deviate = radius * std::cos(2.0 * 3.14159265358979323846 * random.uniform());
    const double unit = std::clamp(deviate / static_cast<double>(kNoiseUnit), -127.0, 127.0);
    values_[i] = static_cast<std::int8_t>(std::lround(unit));
  }
}

const NoiseTable& NoiseTable::get() {
  static const NoiseTable table;
  return table;
}

}  // namespace dynslam::dataset::scene
