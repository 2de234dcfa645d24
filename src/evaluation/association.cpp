#include "dynslam/evaluation/association.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "dynslam/core/errors.hpp"

#include "evaluation/trajectory_checks.hpp"

namespace dynslam::evaluation {
namespace {

// Timestamps of decimal files differ from their decimals by rounding; 0.02 s apart must be 0.02.
constexpr double kRounding = 1e-9;

// A pose in the common order of time.
struct Event {
  double time;
  std::size_t index;
  bool is_truth;
};

std::vector<Event> merge(Span<const StampedPose> truth, Span<const StampedPose> estimate,
                         double offset) {
  std::vector<Event> events;
  events.reserve(truth.size() + estimate.size());
  std::size_t i = 0, j = 0;
  while (i < truth.size() || j < estimate.size()) {
    const bool take_truth =
        j == estimate.size() ||
        (i < truth.size() && truth[i].timestamp <= estimate[j].timestamp + offset);
    if (take_truth) {
      events.push_back({truth[i].timestamp, i, true});
      ++i;
    } else {
      events.push_back({estimate[j].timestamp + offset, j, false});
      ++j;
    }
  }
  return events;
}

}  // namespace

void AssociationOptions::validate() const {
  require(max_difference >= 0.0 && std::isfinite(max_difference), "AssociationOptions",
          "max_difference", max_difference, "a finite time of at least 0 s");
  require(std::isfinite(offset), "AssociationOptions", "offset", offset, "a finite time in s");
}

std::vector<PosePair> associate(Span<const StampedPose> truth, Span<const StampedPose> estimate,
                                const AssociationOptions& options) {
  options.validate();
  require_times("associate", "truth", truth);
  require_times("associate", "estimate", estimate);
  const std::vector<Event> events = merge(truth, estimate, options.offset);
  const double limit = options.max_difference + kRounding;

  // Gap g lies between events g and g + 1. Gaps that share an event exclude each other. While gaps
  // shrink they wait on a stack; where they stop shrinking, the top is the closest of its
  // neighbourhood, so it is taken, the one under it excluded, the next taken, and so on down.
  std::vector<std::size_t> waiting;
  std::vector<PosePair> pairs;
  const auto take_waiting = [&] {
    const auto before = static_cast<std::ptrdiff_t>(pairs.size());
    for (std::size_t k = waiting.size(); k > 0; k -= std::min<std::size_t>(k, 2)) {
      const Event& a = events[waiting[k - 1]];
      const Event& b = events[waiting[k - 1] + 1];
      pairs.push_back(a.is_truth ? PosePair{a.index, b.index} : PosePair{b.index, a.index});
    }
    std::reverse(pairs.begin() + before, pairs.end());
    waiting.clear();
  };
  double last_gap = 0.0;
  for (std::size_t g = 0; g + 1 < events.size(); ++g) {
    const double gap = events[g + 1].time - events[g].time;
    const bool candidate = events[g].is_truth != events[g + 1].is_truth && gap <= limit;
    const bool shrinks = waiting.empty() || gap < last_gap;
    if (candidate && shrinks) {
      waiting.push_back(g);
      last_gap = gap;
      continue;
    }
    // A candidate that does not shrink shares an event with the top and is excluded by it.
    take_waiting();
  }
  take_waiting();
  return pairs;
}

}  // namespace dynslam::evaluation
