// A frame on its way through the tracker.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <opencv2/core/mat.hpp>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/slam/frame.hpp"
#include "dynslam/slam/map.hpp"

namespace dynslam::slam {

/// Features of a frame, its pose, and which map point each feature shows.
struct TrackedFrame {
  FrameFeaturesPtr features;
  double timestamp = 0.0;
  RigidTransform T_cam_world;
  cv::Mat depth;                       ///< copy of the depth image; 0 under the mask
  std::vector<PointId> points;         ///< by feature; kNoId = none
  std::vector<std::uint8_t> rejected;  ///< by feature: 1 when its match disagreed with the pose

  void reset(FrameFeaturesPtr new_features, double time) {
    features = std::move(new_features);
    timestamp = time;
    points.assign(features->size(), kNoId);
    rejected.assign(features->size(), 0);
  }
};

}  // namespace dynslam::slam
