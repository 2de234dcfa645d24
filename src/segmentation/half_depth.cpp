#include <algorithm>
#include <cmath>

#include "segmentation/depth_window.hpp"

namespace dynslam::segmentation {

float HalfDepth::nearest(cv::Point2f point) const {
  return at(std::clamp(static_cast<int>(std::lround(point.x)), 0, width - 1),
            std::clamp(static_cast<int>(std::lround(point.y)), 0, height - 1));
}

void HalfDepth::build(DepthView depth, const DepthRefinementOptions& options) {
  width = (depth.width + 1) / 2;
  height = (depth.height + 1) / 2;
  const auto count = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  z.resize(count);
  facing.resize(count);
  for (int y = 0; y < height; ++y) {
    const float* first = depth.row(2 * y);
    const float* second = depth.row(std::min(2 * y + 1, depth.height - 1));
    float* out = z.data() + static_cast<std::ptrdiff_t>(y) * width;
    for (int x = 0; x < width; ++x) {
      const int right = std::min(2 * x + 1, depth.width - 1);
      const float candidates[4] = {first[2 * x], first[right], second[2 * x], second[right]};
      out[x] = 0.0F;
      for (const float candidate : candidates) {
        if (measured(candidate)) {
          out[x] = candidate;
          break;
        }
      }
    }
  }
  // Steepness over 2 * kReach cells up and down: dz / (z * pixels / focal length).
  constexpr int kReach = 3;
  const double focal = options.focal_ratio * depth.width / 2.0;  // in cells
  const float limit = static_cast<float>(options.max_slant * 2 * kReach / focal);
  for (int y = 0; y < height; ++y) {
    const int above = std::max(y - kReach, 0);
    const int below = std::min(y + kReach, height - 1);
    for (int x = 0; x < width; ++x) {
      const float here = at(x, y);
      const float a = measured(at(x, above)) ? at(x, above) : here;
      const float b = measured(at(x, below)) ? at(x, below) : here;
      // A jump is an edge, not a slope: then the side that continues this surface counts twice.
      const float jump = static_cast<float>(3 * kReach * options.step_share) * here;
      const bool jump_a = std::abs(a - here) > jump;
      const bool jump_b = std::abs(b - here) > jump;
      float rise = std::abs(a - b);
      if (jump_a && jump_b) {
        rise = 0.0F;
      } else if (jump_a) {
        rise = 2 * std::abs(here - b);
      } else if (jump_b) {
        rise = 2 * std::abs(here - a);
      }
      facing[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
             static_cast<std::size_t>(x)] = rise <= limit * here ? 1 : 0;
    }
  }
}

}  // namespace dynslam::segmentation
