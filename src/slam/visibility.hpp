// Where, and on which pyramid level, a camera should see a map point.
#pragma once

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"

namespace dynslam::slam {

/// How a camera sees a point.
struct Sighting {
  Eigen::Vector2d pixel;
  int octave = 0;       ///< level on which the point looks as it did when it was made
  double cosine = 1.0;  ///< between this line of sight and the usual one
};

/// Tells which points a camera at one pose should see.
class Visibility {
 public:
  Visibility(const PinholeCamera& camera, const std::vector<float>& scale_factors,
             const RigidTransform& T_cam_world)
      : camera_(camera),
        T_cam_world_(T_cam_world),
        centre_(T_cam_world.inverse().t),
        log_scale_(std::log(static_cast<double>(scale_factors[1]))),
        levels_(static_cast<int>(scale_factors.size())) {}

  /// Nothing if the point is outside the image, too near or too far for its levels (with a margin
  /// of a fifth), or seen from more than 60 degrees aside.
  std::optional<Sighting> operator()(const Eigen::Vector3d& position, const Eigen::Vector3f& normal,
                                     float min_distance, float max_distance) const {
    const auto pixel = camera_.project_into_image(T_cam_world_ * position);
    if (!pixel) return std::nullopt;
    const Eigen::Vector3d ray = position - centre_;
    const double distance = ray.norm();
    if (distance < 0.8 * min_distance || distance > 1.2 * max_distance) return std::nullopt;
    const double cosine = ray.dot(normal.cast<double>()) / distance;
    if (cosine < 0.5) return std::nullopt;
    const int level = static_cast<int>(std::ceil(std::log(max_distance / distance) / log_scale_));
    return Sighting{*pixel, std::clamp(level, 0, levels_ - 1), cosine};
  }

 private:
  PinholeCamera camera_;
  RigidTransform T_cam_world_;
  Eigen::Vector3d centre_;
  double log_scale_;
  int levels_;
};

}  // namespace dynslam::slam
