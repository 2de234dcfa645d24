#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "dynslam/core/errors.hpp"
#include "dynslam/evaluation/metrics.hpp"

#include "evaluation/associated.hpp"

namespace dynslam::evaluation {
namespace {

// Decimal timestamps are not exact in binary; a step at the very limit is within it.
constexpr double kStepRounding = 1e-9;

using IndexPairs = std::vector<std::pair<std::size_t, std::size_t>>;

IndexPairs pairs_by_frames(std::size_t count, std::size_t delta, bool all) {
  IndexPairs pairs;
  for (std::size_t i = 0; delta < count && i < count - delta; i += all ? 1 : delta) {
    pairs.emplace_back(i, i + delta);
  }
  return pairs;
}

// The first index after `i` whose value is nearest to at[i] + delta, if it is near enough. `at`
// does not decrease.
std::optional<std::size_t> partner(const std::vector<double>& at, std::size_t i, double delta,
                                   double tolerance) {
  const auto first = at.begin() + static_cast<std::ptrdiff_t>(i) + 1;
  const double goal = at[i] + delta;
  auto best = std::lower_bound(first, at.end(), goal);
  if (best != first) {
    // The earliest of those that stand at the value just short of the goal.
    const auto below = std::lower_bound(first, best, *(best - 1));
    if (best == at.end() || goal - *below <= *best - goal) best = below;
  }
  if (best == at.end() || std::abs(*best - goal) > tolerance * delta + kStepRounding)
    return std::nullopt;
  return static_cast<std::size_t>(best - at.begin());
}

IndexPairs pairs_near(const std::vector<double>& at, const RpeOptions& options, bool all) {
  IndexPairs pairs;
  for (std::size_t i = 0; i < at.size();) {
    const auto j = partner(at, i, options.delta, options.tolerance);
    if (j) pairs.emplace_back(i, *j);
    i = j && !all ? *j : i + 1;
  }
  return pairs;
}

IndexPairs pairs_between_knots(Span<const StampedPose> trajectory,
                               const std::vector<PosePair>& associated, std::size_t PosePair::*side,
                               double delta) {
  IndexPairs pairs;
  std::optional<std::size_t> knot;
  double sum = 0.0;  // from zero at each knot: a difference of long sums would round differently
  for (std::size_t k = 1; k < associated.size(); ++k) {
    sum += (trajectory[associated[k].*side].T_world_cam.t -
            trajectory[associated[k - 1].*side].T_world_cam.t)
               .norm();
    if (sum < delta) continue;
    if (knot) pairs.emplace_back(*knot, k);
    knot = k;
    sum = 0.0;
  }
  return pairs;
}

IndexPairs choose_pairs(Span<const StampedPose> truth, Span<const StampedPose> aligned,
                        const std::vector<PosePair>& associated, const RpeOptions& options) {
  const bool all = options.pairs == RpePairs::kAll ||
                   (options.pairs == RpePairs::kAuto && options.unit == RpeUnit::kSeconds);
  if (options.unit == RpeUnit::kFrames) {
    // A step beyond the last frame has no pair, however large it is.
    const double most = static_cast<double>(associated.size());
    return pairs_by_frames(associated.size(),
                           static_cast<std::size_t>(std::min(options.delta, most)), all);
  }
  if (options.unit == RpeUnit::kSeconds) {
    std::vector<double> times;
    times.reserve(associated.size());
    for (const PosePair& pair : associated) times.push_back(aligned[pair.estimate].timestamp);
    return pairs_near(times, options, all);
  }
  const bool by_truth = options.path == RpePath::kTruth;
  const auto side = by_truth ? &PosePair::truth : &PosePair::estimate;
  const Span<const StampedPose> trajectory = by_truth ? truth : aligned;
  if (!all) return pairs_between_knots(trajectory, associated, side, options.delta);
  return pairs_near(path_lengths(trajectory, associated, side), options, true);
}

}  // namespace

void RpeOptions::validate() const {
  constexpr const char* where = "RpeOptions";
  require(delta > 0.0 && std::isfinite(delta), where, "delta", delta, "a finite step above 0");
  require(unit != RpeUnit::kFrames || delta == std::floor(delta), where, "delta", delta,
          "a whole number of frames");
  require(tolerance > 0.0 && tolerance < 1.0, where, "tolerance", tolerance, "a share in (0, 1)");
  association.validate();
}

RpeResult rpe(Span<const StampedPose> truth, Span<const StampedPose> estimate,
              const RpeOptions& options) {
  options.validate();
  const Associated associated =
      make_associated("rpe", truth, estimate, options.association, options.alignment);
  RpeResult result;
  result.alignment = associated.alignment;
  result.coverage = associated.coverage;
  std::vector<double> translations, rotations;
  for (const auto& [i, j] : choose_pairs(truth, associated.aligned, associated.pairs, options)) {
    RelativeError error;
    error.first = associated.pairs[i];
    error.second = associated.pairs[j];
    error.time = truth[error.second.truth].timestamp;
    const RigidTransform E = relative_error(truth, associated.aligned, error.first, error.second);
    error.translation = E.t.norm();
    error.rotation_deg = angle_deg(E.R);
    translations.push_back(error.translation);
    rotations.push_back(error.rotation_deg);
    result.errors.push_back(error);
  }
  result.translation = statistics(translations);
  result.rotation_deg = statistics(rotations);
  return result;
}

}  // namespace dynslam::evaluation
