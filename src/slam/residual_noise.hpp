// Noise of features, told by what is left of their errors.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"

namespace dynslam::slam {

/// Standard deviations of what a feature measures.
struct FeatureNoise {
  double pixels = 1.0;     ///< of a coordinate of the key point, pixels of its level
  double disparity = 1.0;  ///< of its column less that in the right camera, pixels

  /// 1 / sigma of the right column of a key point whose level has pixels of `scale` pixels: it is
  /// off by what the key point is off, and by what the disparity is off. The solvers take the rows
  /// of an observation as independent, so that it repeats the key point's error is left out;
  /// factors::depth_sqrt_information has it.
  double right_inverse_sigma(double scale) const {
    return 1.0 / std::hypot(pixels * scale, disparity);
  }
};

/// Collects errors of features; their medians tell the noise, whatever a few of them are.
class ResidualNoise {
 public:
  void clear();

  /// The errors of a point `X` in camera coordinates that was seen at `pixel` and `right_column`
  /// (NaN or < 0: none), where a pixel of its pyramid level is 1 / `inverse_sigma` pixels. Points
  /// behind the camera are left out.
  void add(const DepthCamera& camera, const Eigen::Vector3d& X, const Eigen::Vector2d& pixel,
           double right_column, double inverse_sigma);

  /// Of pixels: sqrt(median of |r|^2 / (2 ln 2)), as of a normal distribution in the plane. Of
  /// disparity: median of |r| / 0.6745. What fewer than 30 errors tell of is NaN. O(N).
  FeatureNoise standard_deviations();

  /// The same for errors to be weighed by: 0.05 pixels at least, those of key points one at most,
  /// and one where it is unknown.
  FeatureNoise to_weigh_by();

 private:
  std::vector<double> squared_, disparities_;
};

}  // namespace dynslam::slam
