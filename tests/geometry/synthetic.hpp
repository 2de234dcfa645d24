// A room with one box in it, rendered exactly: depth and the box's mask.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"

namespace dynslam::geometry::synthetic {

inline constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
inline const PinholeCamera kCamera{525.0, 525.0, 319.5, 239.5, 640, 480};

struct Box {
  Eigen::Vector3d centre, half;
};

/// Depth along `d` from `o` to the box, or 0.
inline double hit_box(const Box& box, const Eigen::Vector3d& o, const Eigen::Vector3d& d) {
  double first = 1e-3, last = 1e9;
  for (int k = 0; k < 3; ++k) {
    double a = (box.centre[k] - box.half[k] - o[k]) / d[k];
    double b = (box.centre[k] + box.half[k] - o[k]) / d[k];
    if (a > b) std::swap(a, b);
    first = std::max(first, a);
    last = std::min(last, b);
  }
  return first < last ? first : 0.0;
}

/// Depth image of back wall (z = 3), floor (y = 1), side walls (x = +-2.5) and the box. Rays are
/// d = (.., .., 1) in the camera, so that the parameter along a ray is the depth.
inline std::vector<float> render(const RigidTransform& T_cam_world, const Box& box,
                                 std::vector<std::uint8_t>& mask) {
  const RigidTransform T_world_cam = T_cam_world.inverse();
  std::vector<float> depth(640 * 480);
  mask.assign(depth.size(), 0);
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      const Eigen::Vector3d o = T_world_cam.t;
      const Eigen::Vector3d d =
          T_world_cam.R * kCamera.bearing({static_cast<double>(x), static_cast<double>(y)}) +
          Eigen::Vector3d::Constant(1e-12);
      double z = 1e9;
      const auto plane = [&](int axis, double at) {
        const double s = (at - o[axis]) / d[axis];
        if (s > 0.0 && s < z) z = s;
      };
      plane(2, 3.0);
      plane(1, 1.0);
      plane(0, 2.5);
      plane(0, -2.5);
      const std::size_t i = static_cast<std::size_t>(y * 640 + x);
      const double b = hit_box(box, o, d);
      if (b > 0.0 && b < z) {
        z = b;
        mask[i] = 255;
      }
      depth[i] = static_cast<float>(z);
    }
  }
  return depth;
}

}  // namespace dynslam::geometry::synthetic
