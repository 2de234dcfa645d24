#include "residual_noise.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "median.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kFewest = 30;  // errors whose median says something
constexpr double kInflation = 2.5;
constexpr double kLeastNoise = 0.15;  // pixels of a level

}  // namespace

void ResidualNoise::add(const PinholeCamera& camera, const Eigen::Vector3d& X,
                        const Eigen::Vector2d& pixel, double inverse_sigma) {
  if (!PinholeCamera::in_domain(X)) return;
  squared_.push_back((camera.project(X) - pixel).squaredNorm() * inverse_sigma * inverse_sigma);
}

double ResidualNoise::standard_deviation() {
  if (squared_.size() < kFewest) return std::numeric_limits<double>::quiet_NaN();
  return std::sqrt(median(squared_) / (2.0 * std::log(2.0)));
}

double ResidualNoise::noise_to_weigh_by() {
  const double seen = standard_deviation();
  return std::isnan(seen) ? 1.0 : std::clamp(kInflation * seen, kLeastNoise, 1.0);
}

}  // namespace dynslam::slam
