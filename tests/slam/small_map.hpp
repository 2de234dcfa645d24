// A map small enough to be damaged byte by byte.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/slam/map.hpp"

namespace dynslam::slam::testing {

inline DepthCamera small_camera() {
  DepthCamera camera;
  camera.fx = 300.25;
  camera.fy = 301.5;
  camera.cx = 159.5;
  camera.cy = 119.75;
  camera.width = 320;
  camera.height = 240;
  camera.bf = 60.0;
  return camera;
}

inline std::vector<float> small_scales() { return {1.0F, 1.2F, 1.44F, 1.728F}; }

/// Four features a frame, one of them without depth; other ones for every `frame`.
inline FrameFeaturesPtr small_features(int frame) {
  constexpr int kFeatures = 4;
  auto features = std::make_shared<FrameFeatures>();
  features->descriptors.create(kFeatures, 32, CV_8U);
  for (int i = 0; i < kFeatures; ++i) {
    const float x = 20.0F + 70.5F * static_cast<float>(i) + static_cast<float>(frame);
    const float depth = i == 3 ? 0.0F : 1.5F + 0.25F * static_cast<float>(i);
    features->keypoints.emplace_back(x, 30.25F + 50.0F * static_cast<float>(i), 31.0F, 12.5F,
                                     0.001F, i);
    features->depths.push_back(depth);
    features->right_columns.push_back(i == 3 ? std::numeric_limits<float>::quiet_NaN()
                                             : x - 60.0F / depth);
    features->colors.emplace_back(i, 100 + frame, 200);
    features->descriptors.row(i) = 16 * frame + i;
  }
  features->masked_share = 0.125F;
  features->grid.build(field(features->keypoints, &cv::KeyPoint::pt), 320, 240);
  return features;
}

/// Three keyframes of four that were made, and points that two, three and one of them see.
inline Map small_map() {
  Map map;
  std::vector<KeyframeId> keyframes;
  for (int i = 0; i < 4; ++i) {
    Keyframe keyframe;
    keyframe.frame_index = static_cast<std::size_t>(10 * i);
    keyframe.timestamp = 1000.0 + i / 3.0;
    Vector6d twist;
    twist << 0.1 * i, 0.02, -0.03 * i, 0.01, 0.2 * i, -0.1;
    keyframe.T_cam_world = se3_exp(twist);
    keyframe.features = small_features(i);
    keyframe.moving = {0, 0, 0, 1};
    keyframes.push_back(map.add_keyframe(std::move(keyframe)));
  }
  map.erase_keyframe(keyframes[1]);
  const KeyframeId seers[][3] = {{keyframes[2], keyframes[0], kNoId},
                                 {keyframes[0], keyframes[2], keyframes[3]},
                                 {keyframes[3], kNoId, kNoId}};
  for (std::uint32_t i = 0; i < 3; ++i) {
    MapPoint point;
    point.position = Eigen::Vector3d(0.1 * i, 1.0 / 3.0, 2.0);
    point.static_weight = 0.5F + 0.1F * static_cast<float>(i);
    point.visible = 9 + i;
    point.found = 5 + i;
    point.color = {std::uint8_t(i), 20, 30};
    const PointId id = map.add_point(point);
    for (const KeyframeId keyframe : seers[i]) {
      if (keyframe != kNoId) map.add_observation(id, {keyframe, i});
    }
    map.refresh_point(id, small_scales());
  }
  return map;
}

}  // namespace dynslam::slam::testing
