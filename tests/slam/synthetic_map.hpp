// A camera that turns inside a wall of points, and the map that it makes of them.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <random>
#include <unordered_map>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/factors/similarity.hpp"
#include "dynslam/slam/map.hpp"

#include "slam/shared_map.hpp"

namespace dynslam::slam {

inline std::vector<float> unit_scales() {
  std::vector<float> scales;
  for (int i = 0; i < 8; ++i) scales.push_back(static_cast<float>(std::pow(1.2, i)));
  return scales;
}

struct WallPoint {
  Eigen::Vector3d position;
  std::array<std::uint8_t, 32> descriptor;
};

class SyntheticMap {
 public:
  SyntheticMap() {
    camera.fx = camera.fy = 525.0;
    camera.cx = 319.5;
    camera.cy = 239.5;
    camera.width = 640;
    camera.height = 480;
    camera.bf = 0.2 * 525.0;
    add_wall(1800);
  }

  /// A round wall of radius 2.5 to 3.5 m.
  void add_wall(int count) {
    wall.clear();
    for (int i = 0; i < count; ++i) {
      const double angle = uniform(0.0, 2.0 * kPi), away = uniform(2.5, 3.5);
      add_point({away * std::sin(angle), uniform(-1.2, 1.2), away * std::cos(angle)});
    }
  }
  void add_point(const Eigen::Vector3d& position) {
    WallPoint point{position, {}};
    for (std::uint8_t& byte : point.descriptor) byte = static_cast<std::uint8_t>(random() & 255U);
    wall.push_back(point);
  }
  /// From here on nothing in view is joined with points of before.
  void forget_points() { known_.clear(); }

  /// Where a camera that looks at `degrees` is, on the spot or so far from the middle.
  static RigidTransform true_pose(double degrees, double from_middle = 0.0) {
    return {so3_exp({0.0, -degrees * kPi / 180.0, 0.0}), {0.0, 0.0, -from_middle}};
  }

  /// Makes a keyframe of what a camera at `degrees` sees, at the pose that drift has led to.
  KeyframeId look(double degrees, const RigidTransform& T_cam_world) {
    return look(degrees, factors::Similarity(T_cam_world));
  }
  /// The same where the unit of length has drifted as well: `S_cam_world` gives metres.
  KeyframeId look(double degrees, const factors::Similarity& S_cam_world) {
    std::vector<std::size_t> seen;
    const auto features = see(true_pose(degrees, radius), seen);
    const std::vector<float> depths = features->depths;
    if (!has_depth) {
      std::fill(features->depths.begin(), features->depths.end(), 0.0F);
      std::fill(features->right_columns.begin(), features->right_columns.end(), std::nanf(""));
    }
    return insert(features, depths, seen, S_cam_world);
  }

  /// What a camera sees of the wall; `seen` is which of its points, by feature.
  std::shared_ptr<FrameFeatures> see(const RigidTransform& T_cam_true,
                                     std::vector<std::size_t>& seen) {
    auto features = std::make_shared<FrameFeatures>();
    seen.clear();
    for (std::size_t i = 0; i < wall.size(); ++i) {
      const Eigen::Vector3d in_camera = T_cam_true * wall[i].position;
      const auto pixel = camera.project_into_image(in_camera);
      if (!pixel) continue;
      seen.push_back(i);
      features->keypoints.emplace_back(
          cv::Point2f(static_cast<float>(pixel->x() + uniform(-0.4, 0.4)),
                      static_cast<float>(pixel->y() + uniform(-0.4, 0.4))),
          31.0F);
      features->keypoints.back().octave = 0;
      const auto z = static_cast<float>(in_camera.z() + uniform(-0.005, 0.005));
      features->depths.push_back(z);
      features->right_columns.push_back(
          static_cast<float>(camera.right_column(features->keypoints.back().pt.x, z)));
    }
    features->colors.resize(seen.size());
    features->descriptors = cv::Mat(static_cast<int>(seen.size()), 32, CV_8U);
    for (std::size_t f = 0; f < seen.size(); ++f) {
      std::uint8_t* row = features->descriptors.ptr<std::uint8_t>(static_cast<int>(f));
      std::copy_n(wall[seen[f]].descriptor.begin(), 32, row);
      for (int flip = 0; flip < 6; ++flip) row[random() % 32] ^= 1U << (random() % 8);
    }
    features->grid.build(field(features->keypoints, &cv::KeyPoint::pt), camera.width,
                         camera.height);
    return features;
  }

  DepthCamera camera;
  SharedMap shared;
  std::vector<WallPoint> wall;
  std::size_t memory = 3;  ///< keyframes after which a point is not found again
  double radius = 0.0;     ///< metres, of the circle that the camera goes
  bool has_depth = true;   ///< whether features do; points are where they are either way

 private:
  static constexpr double kPi = 3.14159265358979323846;
  struct Known {
    PointId id = kNoId;
    std::size_t keyframes = 0;  // made when it was last seen
  };

  KeyframeId insert(const FrameFeaturesPtr& features, const std::vector<float>& depths,
                    const std::vector<std::size_t>& seen, const factors::Similarity& S_cam_world) {
    Map& map = shared.map;
    Keyframe keyframe;
    keyframe.frame_index = 10 * map.keyframes_made();
    keyframe.timestamp = 0.1 * static_cast<double>(keyframe.frame_index);
    keyframe.T_cam_world = S_cam_world.rigid();
    keyframe.features = features;
    const KeyframeId id = map.add_keyframe(std::move(keyframe));
    const factors::Similarity S_world_cam = S_cam_world.inverse();
    for (std::uint32_t f = 0; f < seen.size(); ++f) {
      Known& known = known_[seen[f]];
      const bool lost = map.keyframes_made() > known.keyframes + memory;
      if (!lost && map.find_point(known.id) != nullptr) {
        map.add_observation(known.id, {id, f});
      } else {
        const cv::Point2f pixel = features->keypoints[f].pt;
        MapPoint point;
        point.position = S_world_cam * camera.unproject({pixel.x, pixel.y}, depths[f]);
        known.id = map.add_point(point);
        map.add_observation(known.id, {id, f});
      }
      known.keyframes = map.keyframes_made();
      map.refresh_point(known.id, unit_scales());
    }
    return id;
  }
  double uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(random() >> 11U) * 0x1.0p-53;
  }

  std::mt19937_64 random{7};
  std::unordered_map<std::size_t, Known> known_;  // points of the wall in the map
};

}  // namespace dynslam::slam
