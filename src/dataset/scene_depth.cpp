// Depth as a structured-light sensor measures it.
#include <algorithm>
#include <cmath>

#include "scene_frame.hpp"

namespace dynslam::dataset::scene {

namespace {

// The sensor (Kinect of 2010): focal length times baseline, and the step of its disparities.
constexpr float kBaseline = 0.075F, kFocalBaseline = 575.0F * kBaseline, kSteps = 8.0F;
constexpr float kNearest = 0.5F, kFarthest = 8.0F;
/// Cosine of the angle of incidence below which half of the points are lost, and the half width of
/// the transition.
constexpr float kGrazing = 0.17F, kGrazingWidth = 0.05F;
constexpr std::uint32_t kDropouts = 13;  ///< of 4096 pixels

/// Standard deviation of the noise to add before quantization, in disparity, by depth.
struct DisparityNoise {
  static constexpr int kEntries = 1024;
  std::array<float, kEntries> sigma;
  DisparityNoise() {
    for (std::size_t i = 0; i < kEntries; ++i) {
      const double z = static_cast<double>(kFarthest) * (static_cast<double>(i) + 0.5) / kEntries;
      const double wanted = 0.0012 + 0.0019 * (z - 0.4) * (z - 0.4);
      const double in_disparity = wanted * static_cast<double>(kFocalBaseline) / (z * z);
      const double step = 1.0 / static_cast<double>(kSteps);
      sigma[i] = static_cast<float>(
          std::sqrt(std::max(0.0, in_disparity * in_disparity - step * step / 12.0)));
    }
  }
  float at(float z) const {
    return sigma[static_cast<std::size_t>(std::min(z * (kEntries / kFarthest), kEntries - 1.0F))];
  }
};

/// Marks what the projector, `kBaseline` to the right of the camera, does not see: in the image it
/// stands left of whatever throws the shadow. Column of the projector's image: x - shift * w.
void mark_shadow(const float* w, int width, float shift, std::uint8_t* dark) {
  float frontier = 1e30F;
  for (int x = width - 1; x >= 0; --x) {
    const float column = static_cast<float>(x) - shift * w[x];
    dark[x] = column > frontier + 0.75F ? 1 : 0;
    frontier = std::min(frontier, column);
  }
}

/// Slope of w from the more alike of the two neighbours, so that edges do not count.
inline float slope(float before, float here, float after) {
  const float a = here - before, b = after - here;
  return std::abs(a) < std::abs(b) ? a : b;
}

}  // namespace

void sense_depth(const PinholeCamera& camera, std::uint64_t seed, int threads,
                 const Workspace& work, cv::Mat* depth) {
  depth->create(work.height, work.width, CV_32FC1);
  static const DisparityNoise disparity_noise;
  const NoiseTable& table = NoiseTable::get();
  const auto fx = static_cast<float>(camera.fx), fy = static_cast<float>(camera.fy);
  const auto cx = static_cast<float>(camera.cx), cy = static_cast<float>(camera.cy);
  in_parallel(threads, work.height, [&](int first, int last, int) {
    std::vector<std::uint8_t> dark(static_cast<std::size_t>(work.width));
    for (int y = first; y < last; ++y) {
      const float* w = work.w.data() + work.at(0, y);
      const float* above = work.w.data() + work.at(0, std::max(0, y - 1));
      const float* below = work.w.data() + work.at(0, std::min(work.height - 1, y + 1));
      mark_shadow(w, work.width, fx * kBaseline, dark.data());
      const std::uint64_t key = mix(seed, static_cast<std::uint64_t>(y), 0xDE);
      const std::int8_t* noise = table.from(key);
      std::uint64_t bits = key;
      const float ry = (static_cast<float>(y) - cy) / fy;
      auto* out = depth->ptr<float>(y);
      for (int x = 0; x < work.width; ++x) {
        // Twelve random bits for the holes; five pixels to a word.
        if (x % 5 == 0) bits = mix(key + static_cast<std::uint64_t>(x));
        const auto lot = static_cast<std::uint32_t>(bits & 4095U);
        bits >>= 12;
        const float z = 1.0F / w[x];
        const float left = w[std::max(0, x - 1)], right = w[std::min(work.width - 1, x + 1)];
        const float gx = fx * slope(left, w[x], right), gy = fy * slope(above[x], w[x], below[x]);
        // w = n . d up to a factor: n = (gx, gy, w - gx rx - gy ry).
        const float rx = (static_cast<float>(x) - cx) / fx;
        const float gz = w[x] - gx * rx - gy * ry;
        const float cosine2 =
            w[x] * w[x] / ((gx * gx + gy * gy + gz * gz) * (1.0F + rx * rx + ry * ry));
        const float limit = kGrazing + kGrazingWidth * (static_cast<float>(lot) / 2048.0F - 1.0F);
        const float d = kFocalBaseline * w[x];
        const float measured =
            std::floor(kSteps * (d + disparity_noise.at(z) * kNoiseUnit * noise[x]) + 0.5F);
        const bool lost = (z < kNearest) | (z > kFarthest) |
                          (dark[static_cast<std::size_t>(x)] != 0) | (cosine2 < limit * limit) |
                          (lot < kDropouts) | (measured < 1.0F);
        out[x] = lost ? 0.0F : kFocalBaseline * kSteps / measured;
      }
    }
  });
}

}  // namespace dynslam::dataset::scene
