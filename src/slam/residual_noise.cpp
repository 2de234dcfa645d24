#include "residual_noise.hpp"

#include <algorithm>
#include <limits>

#include "median.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kFewest = 30;      // errors whose median says something
constexpr double kLeast = 0.05;          // pixels, or of a level
constexpr double kMost = 1.0;            // pixels of a level
constexpr double kMedianError = 0.6745;  // of a normal distribution, in standard deviations

double median_of_enough(std::vector<double>& values) {
  return values.size() < kFewest ? std::numeric_limits<double>::quiet_NaN() : median(values);
}

}  // namespace

void ResidualNoise::clear() {
  squared_.clear();
  disparities_.clear();
}

void ResidualNoise::add(const DepthCamera& camera, const Eigen::Vector3d& X,
                        const Eigen::Vector2d& pixel, double right_column, double inverse_sigma) {
  if (!PinholeCamera::in_domain(X)) return;
  squared_.push_back((camera.project(X) - pixel).squaredNorm() * inverse_sigma * inverse_sigma);
  if (right_column >= 0.0) {
    disparities_.push_back(std::abs(camera.bf / X.z() - (pixel.x() - right_column)));
  }
}

FeatureNoise ResidualNoise::standard_deviations() {
  return {std::sqrt(median_of_enough(squared_) / (2.0 * std::log(2.0))),
          median_of_enough(disparities_) / kMedianError};
}

FeatureNoise ResidualNoise::to_weigh_by() {
  FeatureNoise noise = standard_deviations();
  noise.pixels = std::isnan(noise.pixels) ? 1.0 : std::clamp(noise.pixels, kLeast, kMost);
  noise.disparity = std::isnan(noise.disparity) ? 1.0 : std::max(noise.disparity, kLeast);
  return noise;
}

}  // namespace dynslam::slam
