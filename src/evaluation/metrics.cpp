#include "dynslam/evaluation/metrics.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/so3.hpp"

#include "evaluation/associated.hpp"
#include "evaluation/trajectory_checks.hpp"

namespace dynslam::evaluation {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// A stretch without associated poses longer than this many median steps is not covered.
constexpr double kLargestStep = 3.0;

// Order statistic of `values` at the fractional position share * (n - 1).
double quantile_of(std::vector<double>& values, double share) {
  if (values.empty()) return kNaN;
  const double position = share * static_cast<double>(values.size() - 1);
  const auto below = static_cast<std::ptrdiff_t>(position);
  std::nth_element(values.begin(), values.begin() + below, values.end());
  const double low = values[static_cast<std::size_t>(below)];
  const double fraction = position - static_cast<double>(below);
  if (fraction == 0.0) return low;
  const double high = *std::min_element(values.begin() + below + 1, values.end());
  return low + fraction * (high - low);
}

double covered_share(Span<const StampedPose> truth, const std::vector<PosePair>& pairs) {
  if (pairs.empty()) return 0.0;
  const double duration = truth[truth.size() - 1].timestamp - truth[0].timestamp;
  if (duration <= 0.0) return 1.0;
  std::vector<double> steps;
  for (std::size_t k = 1; k < pairs.size(); ++k) {
    steps.push_back(truth[pairs[k].truth].timestamp - truth[pairs[k - 1].truth].timestamp);
  }
  std::vector<double> copy = steps;
  const double largest = kLargestStep * quantile_of(copy, 0.5) * (1.0 + 1e-9);
  double covered = 0.0;
  for (const double step : steps) covered += step <= largest ? step : 0.0;
  return covered / duration;
}

}  // namespace

Statistics statistics(Span<const double> values) {
  Statistics s;
  s.count = values.size();
  if (values.empty()) return s;
  const double n = static_cast<double>(values.size());
  double sum = 0.0, squares = 0.0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    require(std::isfinite(values[i]), "statistics", "values[" + std::to_string(i) + "]", values[i],
            "a finite number");
    sum += values[i];
    squares += values[i] * values[i];
  }
  s.mean = sum / n;
  s.rmse = std::sqrt(squares / n);
  double deviation = 0.0;
  for (const double v : values) deviation += (v - s.mean) * (v - s.mean);
  s.std = std::sqrt(deviation / n);
  std::vector<double> sorted(values.begin(), values.end());
  s.median = quantile_of(sorted, 0.5);
  const auto [low, high] = std::minmax_element(values.begin(), values.end());
  s.min = *low;
  s.max = *high;
  return s;
}

double quantile(Span<const double> values, double share) {
  require(share >= 0.0 && share <= 1.0, "quantile", "share", share, "a value in [0, 1]");
  std::vector<double> kept;
  kept.reserve(values.size());
  std::copy_if(values.begin(), values.end(), std::back_inserter(kept),
               [](double v) { return !std::isnan(v); });
  return quantile_of(kept, share);
}

double improvement_percent(double a, double b) { return a == 0.0 ? kNaN : (a - b) / a * 100.0; }

Associated make_associated(std::string_view function, Span<const StampedPose> truth,
                           Span<const StampedPose> estimate, const AssociationOptions& association,
                           Alignment alignment) {
  require_trajectory(function, "truth", truth);
  require_trajectory(function, "estimate", estimate);
  Associated result;
  result.pairs = associate(truth, estimate, association);
  const auto n = static_cast<Eigen::Index>(result.pairs.size());
  Eigen::Matrix3Xd true_points(3, n), estimated_points(3, n);
  for (Eigen::Index k = 0; k < n; ++k) {
    const PosePair& pair = result.pairs[static_cast<std::size_t>(k)];
    true_points.col(k) = truth[pair.truth].T_world_cam.t;
    estimated_points.col(k) = estimate[pair.estimate].T_world_cam.t;
  }
  result.alignment = align_points(true_points, estimated_points, alignment);
  result.aligned = transform(estimate, result.alignment.truth_from_estimate);
  result.coverage.truth_poses = truth.size();
  result.coverage.estimate_poses = estimate.size();
  result.coverage.pairs = result.pairs.size();
  result.coverage.time_share = covered_share(truth, result.pairs);
  return result;
}

std::vector<double> path_lengths(Span<const StampedPose> trajectory,
                                 const std::vector<PosePair>& pairs, std::size_t PosePair::*side) {
  std::vector<double> path(pairs.size(), 0.0);
  for (std::size_t k = 1; k < pairs.size(); ++k) {
    const Eigen::Vector3d& a = trajectory[pairs[k - 1].*side].T_world_cam.t;
    const Eigen::Vector3d& b = trajectory[pairs[k].*side].T_world_cam.t;
    path[k] = path[k - 1] + (b - a).norm();
  }
  return path;
}

RigidTransform relative_error(Span<const StampedPose> truth, Span<const StampedPose> estimate,
                              const PosePair& first, const PosePair& second) {
  const RigidTransform Q =
      truth[first.truth].T_world_cam.inverse() * truth[second.truth].T_world_cam;
  const RigidTransform P =
      estimate[first.estimate].T_world_cam.inverse() * estimate[second.estimate].T_world_cam;
  return Q.inverse() * P;
}

double angle_deg(const Eigen::Matrix3d& R) { return so3_log(R).norm() * (180.0 / M_PI); }

void AteOptions::validate() const { association.validate(); }

AteResult ate(Span<const StampedPose> truth, Span<const StampedPose> estimate,
              const AteOptions& options) {
  options.validate();
  Associated associated =
      make_associated("ate", truth, estimate, options.association, options.alignment);
  AteResult result;
  result.pairs = std::move(associated.pairs);
  result.alignment = associated.alignment;
  result.aligned = std::move(associated.aligned);
  result.coverage = associated.coverage;
  result.errors.reserve(result.pairs.size());
  for (const PosePair& pair : result.pairs) {
    const Eigen::Vector3d& estimated = result.aligned[pair.estimate].T_world_cam.t;
    result.errors.push_back((truth[pair.truth].T_world_cam.t - estimated).norm());
  }
  result.error = statistics(result.errors);
  return result;
}

}  // namespace dynslam::evaluation
