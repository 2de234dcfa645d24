// Noise of features, told by what is left of their errors.
#pragma once

#include <algorithm>
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
  double corner = 1.0;     ///< of a key point as it was found, in units of `pixels`
  double aligned = 1.0;    ///< of one aligned as well as can be, in units of `pixels`
  double growth = 0.0;     ///< added to that in quadrature by a pixel of its alignment_sigma

  /// Of a key point (FrameFeatures::alignment_sigma), in units of `pixels`: between half and twice,
  /// as it widens the bound of inliers as well.
  double relative(double alignment_sigma) const {
    const double own =
        alignment_sigma > 0.0 ? std::hypot(aligned, growth * alignment_sigma) : corner;
    return std::clamp(own, 0.5, 2.0);
  }

  /// `share` of this and the rest of `other`.
  FeatureNoise blended(const FeatureNoise& other, double share) const;

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
  /// (NaN or < 0: none), where a pixel of its pyramid level is 1 / `inverse_sigma` pixels;
  /// `alignment_sigma` as the features have it. Points behind the camera are left out.
  void add(const DepthCamera& camera, const Eigen::Vector3d& X, const Eigen::Vector2d& pixel,
           double right_column, double inverse_sigma, double alignment_sigma = 0.0);

  /// Of pixels: sqrt(median of |r|^2 / (2 ln 2)), as of a normal distribution in the plane. Of
  /// disparity: median of |r| / 0.6745. What fewer than 30 errors tell of is NaN. O(N).
  FeatureNoise standard_deviations();

  /// The same for errors to be weighed by: 0.05 pixels at least, those of key points one at most,
  /// and one where it is unknown; with what corners and aligned key points differ by, as far as 30
  /// of each kind tell.
  FeatureNoise to_weigh_by();

 private:
  struct Aligned {
    double sigma, squared;
  };
  /// What half of the aligned ones are like: medians of both, squared.
  struct Half {
    double sigma2, error2;
  };
  Half half(std::size_t first, std::size_t last);
  void tell_apart(FeatureNoise& noise);

  std::vector<double> squared_, disparities_, corners_, values_;
  std::vector<Aligned> aligned_;
};

}  // namespace dynslam::slam
