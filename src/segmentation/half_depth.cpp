#include <algorithm>
#include <cmath>

#include "segmentation/depth_window.hpp"

namespace dynslam::segmentation {

float HalfDepth::nearest(cv::Point2f point) const {
  return at(std::clamp(static_cast<int>(std::lround(point.x)), 0, width - 1),
            std::clamp(static_cast<int>(std::lround(point.y)), 0, height - 1));
}

namespace {

// The first measured of four pixels. Without branches, so that loops over it are vectorized.
float first_measured(float a, float b, float c, float d) {
  float z = measured(d) ? d : 0.0F;
  z = measured(c) ? c : z;
  z = measured(b) ? b : z;
  return measured(a) ? a : z;
}

void halve_row(const float* first, const float* second, int width, float* out) {
  const int pairs = width / 2;
  for (int x = 0; x < pairs; ++x) {
    out[x] = first_measured(first[2 * x], first[2 * x + 1], second[2 * x], second[2 * x + 1]);
  }
  if (width % 2 == 0) return;
  const float last = first[width - 1];
  out[pairs] = first_measured(last, last, second[width - 1], second[width - 1]);
}

// What the slope of a surface is judged by.
struct SlopeRule {
  float limit;  // of the rise, as a share of the depth
  float jump;   // from which on a rise is an edge, as a share of the depth
};

void judge_slopes(const float* above, const float* here, const float* below, int width,
                  const SlopeRule& rule, std::uint8_t* facing) {
  for (int x = 0; x < width; ++x) {
    const float z = here[x];
    const float a = measured(above[x]) ? above[x] : z;
    const float b = measured(below[x]) ? below[x] : z;
    const float up = std::abs(a - z);
    const float down = std::abs(b - z);
    const float across = std::abs(a - b);
    // A jump is an edge, not a slope: then the side that continues this surface counts twice.
    const float without_above = down > rule.jump * z ? 0.0F : 2 * down;
    const float without_below = down > rule.jump * z ? 2 * up : across;
    const float rise = up > rule.jump * z ? without_above : without_below;
    facing[x] = rise <= rule.limit * z ? 1 : 0;
  }
}

}  // namespace

void HalfDepth::build(DepthView depth, const DepthRefinementOptions& options) {
  width = (depth.width + 1) / 2;
  height = (depth.height + 1) / 2;
  const auto count = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  z.resize(count);
  facing.resize(count);
  const auto row = [this](int y) { return z.data() + static_cast<std::ptrdiff_t>(y) * width; };
  for (int y = 0; y < height; ++y) {
    halve_row(depth.row(2 * y), depth.row(std::min(2 * y + 1, depth.height - 1)), depth.width,
              row(y));
  }
  // Steepness over 2 * kReach cells up and down: dz / (z * pixels / focal length).
  constexpr int kReach = 3;
  const double focal = options.focal_ratio * depth.width / 2.0;  // in cells
  const SlopeRule rule = {static_cast<float>(options.max_slant * 2 * kReach / focal),
                          static_cast<float>(3 * kReach * options.step_share)};
  for (int y = 0; y < height; ++y) {
    judge_slopes(row(std::max(y - kReach, 0)), row(y), row(std::min(y + kReach, height - 1)), width,
                 rule, facing.data() + static_cast<std::ptrdiff_t>(y) * width);
  }
}

void WalledDepth::clear(cv::Size size) {
  width = size.width;
  height = size.height;
  stride = width + 2;
  z.assign(static_cast<std::size_t>(stride) * static_cast<std::size_t>(height + 2), 0.0F);
}

void WalledDepth::cut(const HalfDepth& half, const cv::Rect& window) {
  clear(window.size());
  for (int y = 0; y < height; ++y) {
    const float* row =
        half.z.data() + static_cast<std::ptrdiff_t>(window.y + y) * half.width + window.x;
    std::copy_n(row, width, z.data() + cell_of(0, y));
  }
}

}  // namespace dynslam::segmentation
