// Noise of key points, told by what is left of their reprojection errors.
#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"

namespace dynslam::slam {

/// Collects reprojection errors; their median tells the noise, whatever a few of them are.
class ResidualNoise {
 public:
  void clear() { squared_.clear(); }

  /// The error of a point `X` in camera coordinates that was seen at `pixel`, where a pixel of its
  /// pyramid level is 1 / `inverse_sigma` pixels. Points behind the camera are left out.
  void add(const PinholeCamera& camera, const Eigen::Vector3d& X, const Eigen::Vector2d& pixel,
           double inverse_sigma);

  /// Standard deviation of a coordinate, pixels of its level: sqrt(median of |r|^2 / (2 ln 2)), as
  /// of a normal distribution in the plane. NaN from fewer than 30 errors. O(N).
  double standard_deviation();

  /// What errors are to be weighed by: 2.5 times that, as errors of the map, which are the same in
  /// every frame, show but little; 0.15 pixels at least, one at most, and one where it is unknown.
  double noise_to_weigh_by();

 private:
  std::vector<double> squared_;
};

}  // namespace dynslam::slam
