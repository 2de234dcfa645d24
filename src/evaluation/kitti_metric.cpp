#include <algorithm>
#include <cmath>
#include <string>

#include "dynslam/core/errors.hpp"
#include "dynslam/evaluation/metrics.hpp"

#include "evaluation/associated.hpp"

namespace dynslam::evaluation {
namespace {

// Mean of the segments of one length, or of all for length 0.
KittiMean mean_of(const std::vector<KittiSegment>& segments, double length) {
  KittiMean mean;
  mean.length = length;
  double translation = 0.0, rotation = 0.0;
  for (const KittiSegment& segment : segments) {
    if (length != 0.0 && segment.length != length) continue;
    translation += segment.translation_percent;
    rotation += segment.rotation_deg_per_100m;
    ++mean.count;
  }
  if (mean.count > 0) {
    mean.translation_percent = translation / static_cast<double>(mean.count);
    mean.rotation_deg_per_100m = rotation / static_cast<double>(mean.count);
  }
  return mean;
}

}  // namespace

void KittiOptions::validate() const {
  constexpr const char* where = "KittiOptions";
  require(!lengths.empty(), where, "lengths", "an empty list", "at least one length in m");
  for (const double length : lengths) {
    require(length > 0.0 && std::isfinite(length), where, "lengths", length,
            "finite lengths above 0 m");
  }
  require(step >= 1, where, "step", step, "at least 1 frame");
  association.validate();
}

KittiResult kitti_metric(Span<const StampedPose> truth, Span<const StampedPose> estimate,
                         const KittiOptions& options) {
  options.validate();
  const Associated associated =
      make_associated("kitti_metric", truth, estimate, options.association, options.alignment);
  const std::vector<PosePair>& pairs = associated.pairs;
  const std::vector<double> path = path_lengths(truth, pairs, &PosePair::truth);

  KittiResult result;
  result.coverage = associated.coverage;
  for (std::size_t i = 0; i < pairs.size(); i += static_cast<std::size_t>(options.step)) {
    for (const double length : options.lengths) {
      const auto from = path.begin() + static_cast<std::ptrdiff_t>(i);
      const auto end = std::upper_bound(from, path.end(), path[i] + length);
      if (end == path.end()) continue;
      KittiSegment segment;
      segment.first = pairs[i];
      segment.last = pairs[static_cast<std::size_t>(end - path.begin())];
      segment.length = length;
      const RigidTransform E =
          relative_error(truth, associated.aligned, segment.first, segment.last);
      segment.translation_percent = E.t.norm() / length * 100.0;
      segment.rotation_deg_per_100m = angle_deg(E.R) / length * 100.0;
      result.segments.push_back(segment);
    }
  }
  result.all = mean_of(result.segments, 0.0);
  for (const double length : options.lengths) {
    result.by_length.push_back(mean_of(result.segments, length));
  }
  return result;
}

}  // namespace dynslam::evaluation
