#include "stored_map.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <string>

#include "dynslam/core/errors.hpp"

namespace dynslam::slam {
namespace {

constexpr double kSamePixels = 1e-6;  // text files of calibrations lose a little

std::string describe(const PinholeCamera& camera) {
  char text[160];
  std::snprintf(text, sizeof text, "%dx%d, fx %.6g, fy %.6g, cx %.6g, cy %.6g", camera.width,
                camera.height, camera.fx, camera.fy, camera.cx, camera.cy);
  return text;
}

bool same(const PinholeCamera& a, const PinholeCamera& b) {
  const auto near = [](double x, double y) { return std::abs(x - y) <= kSamePixels; };
  return a.width == b.width && a.height == b.height && near(a.fx, b.fx) && near(a.fy, b.fy) &&
         near(a.cx, b.cx) && near(a.cy, b.cy);
}

std::string describe(Span<const float> scale_factors) {
  return std::to_string(scale_factors.size()) + " pyramid levels up to a scale of " +
         std::to_string(scale_factors.empty() ? 1.0F : scale_factors[scale_factors.size() - 1]);
}

}  // namespace

void require_suitable(const char* function, const StoredMap& stored, const DepthCamera& camera,
                      Span<const float> scale_factors) {
  require(stored.map.keyframe_count() > 0, function, "map", "no keyframes", "at least one");
  if (!same(stored.camera, camera)) {
    throw_invalid_argument(function, "the map's camera", describe(stored.camera),
                           "that of the frames: " + describe(camera));
  }
  const bool same_pyramid = std::equal(stored.scale_factors.begin(), stored.scale_factors.end(),
                                       scale_factors.begin(), scale_factors.end());
  if (!same_pyramid) {
    throw_invalid_argument(function, "the map's features", describe(stored.scale_factors),
                           "those of the options: " + describe(scale_factors));
  }
}

void convert_right_columns(StoredMap& stored, double bf) {
  if (stored.camera.bf == bf) return;
  stored.camera.bf = bf;
  for (const KeyframeId id : stored.map.keyframe_ids()) {
    Keyframe& keyframe = stored.map.keyframe(id);
    auto features = std::make_shared<FrameFeatures>(*keyframe.features);
    for (std::size_t i = 0; i < features->size(); ++i) {
      if (!(features->depths[i] > 0.0F)) continue;
      features->right_columns[i] = static_cast<float>(
          stored.camera.right_column(features->keypoints[i].pt.x, features->depths[i]));
    }
    keyframe.features = std::move(features);
  }
}

}  // namespace dynslam::slam
