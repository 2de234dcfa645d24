// What the tests of the rendered scene share.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>

#include <opencv2/core.hpp>

#include "dynslam/dataset/scene.hpp"

namespace dynslam::dataset {

inline SceneOptions small(std::uint64_t seed = 1, int width = 160, int height = 120) {
  SceneOptions options;
  options.seed = seed;
  options.camera = scene_camera(width, height);
  return options;
}

/// Colours without the camera's imperfections.
inline SceneOptions clean(std::uint64_t seed = 1, int width = 160, int height = 120) {
  SceneOptions options = small(seed, width, height);
  options.motion_blur = options.exposure_drift = options.image_noise = options.depth_noise = false;
  return options;
}

/// A scene whose textures are painted once for all tests with the same seed.
inline RenderedScene shared_scene(const SceneOptions& options) {
  static std::map<std::uint64_t, RenderedScene> rooms;
  const auto room = rooms.try_emplace(options.seed, options).first;
  return room->second.variant(options);
}

inline bool same_bits(const cv::Mat& a, const cv::Mat& b) {
  if (a.size() != b.size() || a.type() != b.type()) return false;
  for (int y = 0; y < a.rows; ++y) {
    if (!std::equal(a.ptr(y), a.ptr(y) + a.cols * static_cast<int>(a.elemSize()), b.ptr(y))) {
      return false;
    }
  }
  return true;
}

inline bool same_frame(const Frame& a, const Frame& b) {
  return same_bits(a.color, b.color) && same_bits(a.depth, b.depth) && same_bits(a.mask, b.mask) &&
         a.T_world_cam->t == b.T_world_cam->t && a.T_world_cam->R == b.T_world_cam->R &&
         a.timestamp == b.timestamp && a.name == b.name && a.index == b.index;
}

inline double share_of_movers(const cv::Mat& mask) {
  return static_cast<double>(cv::countNonZero(mask)) / static_cast<double>(mask.total());
}

}  // namespace dynslam::dataset
