#include "loop_scale.hpp"

#include <cmath>
#include <cstddef>

#include "median.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kMinPoints = 20;
constexpr double kMaxError = 0.02;             // standard error of the logarithm
constexpr double kDeviationOfMedian = 1.4826;  // of a normal distribution over that of the median
constexpr double kErrorOfMedian = 1.2533;      // of a median over that of a mean

}  // namespace

std::optional<double> agreed_scale(std::vector<double> log_ratios) {
  const std::size_t n = log_ratios.size();
  if (n < kMinPoints) return std::nullopt;
  const double middle = median(log_ratios);
  for (double& ratio : log_ratios) ratio = std::abs(ratio - middle);
  const double sigma = kDeviationOfMedian * median(log_ratios);
  if (!(kErrorOfMedian * sigma <= kMaxError * std::sqrt(static_cast<double>(n)))) {
    return std::nullopt;
  }
  return std::exp(middle);
}

}  // namespace dynslam::slam
