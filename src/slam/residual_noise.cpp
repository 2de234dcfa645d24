#include "residual_noise.hpp"

#include <algorithm>
#include <limits>

#include "median.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kFewest = 30;                // errors whose median says something
constexpr double kLeast = 0.05;                    // pixels, or of a level
constexpr double kMost = 1.0;                      // pixels of a level
constexpr double kLeastSquare = 0.1;               // of an aligned key point's share of the noise
const double kMedianSquare = 2.0 * std::log(2.0);  // of a normal distribution in the plane
constexpr double kMedianError = 0.6745;  // of a normal distribution, in standard deviations

double median_of_enough(std::vector<double>& values) {
  return values.size() < kFewest ? std::numeric_limits<double>::quiet_NaN() : median(values);
}

}  // namespace

FeatureNoise FeatureNoise::blended(const FeatureNoise& other, double share) const {
  const auto blend = [share](double a, double b) { return share * a + (1.0 - share) * b; };
  FeatureNoise noise;
  noise.pixels = blend(pixels, other.pixels);
  noise.disparity = blend(disparity, other.disparity);
  noise.corner = blend(corner, other.corner);
  noise.aligned = blend(aligned, other.aligned);
  noise.growth = blend(growth, other.growth);
  return noise;
}

void ResidualNoise::clear() {
  squared_.clear();
  disparities_.clear();
  corners_.clear();
  aligned_.clear();
}

void ResidualNoise::add(const DepthCamera& camera, const Eigen::Vector3d& X,
                        const Eigen::Vector2d& pixel, double right_column, double inverse_sigma,
                        double alignment_sigma) {
  if (!PinholeCamera::in_domain(X)) return;
  squared_.push_back((camera.project(X) - pixel).squaredNorm() * inverse_sigma * inverse_sigma);
  if (alignment_sigma > 0.0) {
    aligned_.push_back({alignment_sigma, squared_.back()});
  } else {
    corners_.push_back(squared_.back());
  }
  if (right_column >= 0.0) {
    disparities_.push_back(std::abs(camera.bf / X.z() - (pixel.x() - right_column)));
  }
}

FeatureNoise ResidualNoise::standard_deviations() {
  FeatureNoise noise;
  noise.pixels = std::sqrt(median_of_enough(squared_) / kMedianSquare);
  noise.disparity = median_of_enough(disparities_) / kMedianError;
  return noise;
}

ResidualNoise::Half ResidualNoise::half(std::size_t first, std::size_t last) {
  Half half;
  values_.clear();
  for (std::size_t i = first; i < last; ++i) values_.push_back(aligned_[i].squared);
  half.error2 = median(values_);
  values_.clear();
  for (std::size_t i = first; i < last; ++i) values_.push_back(aligned_[i].sigma);
  const double sigma = median(values_);
  half.sigma2 = sigma * sigma;
  return half;
}

// Aligned ones are split by how well they were: two medians are a straight line.
void ResidualNoise::tell_apart(FeatureNoise& noise) {
  const double unit = kMedianSquare * noise.pixels * noise.pixels;
  if (corners_.size() >= kFewest) noise.corner = std::sqrt(median(corners_) / unit);
  if (aligned_.size() < 2 * kFewest) return;
  const std::size_t middle = aligned_.size() / 2;
  std::nth_element(aligned_.begin(), aligned_.begin() + static_cast<std::ptrdiff_t>(middle),
                   aligned_.end(),
                   [](const Aligned& a, const Aligned& b) { return a.sigma < b.sigma; });
  const Half better = half(0, middle), worse = half(middle, aligned_.size());
  const double apart = worse.sigma2 - better.sigma2;
  const double slope =
      apart > 0.0 ? std::max(0.0, (worse.error2 - better.error2) / (apart * unit)) : 0.0;
  noise.growth = std::sqrt(slope);
  noise.aligned = std::sqrt(std::max(kLeastSquare, better.error2 / unit - slope * better.sigma2));
}

FeatureNoise ResidualNoise::to_weigh_by() {
  FeatureNoise noise = standard_deviations();
  if (noise.pixels > 0.0) tell_apart(noise);
  noise.pixels = std::isnan(noise.pixels) ? 1.0 : std::clamp(noise.pixels, kLeast, kMost);
  noise.disparity = std::isnan(noise.disparity) ? 1.0 : std::max(noise.disparity, kLeast);
  return noise;
}

}  // namespace dynslam::slam
