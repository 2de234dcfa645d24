#include "keyframe_similarity.hpp"

#include <vector>

#include "dynslam/core/match.hpp"
#include "dynslam/features/matcher.hpp"

namespace dynslam::slam {
namespace {

constexpr int kSameBits = 50;  // the strict of the field's two thresholds for ORB

}  // namespace

double similarity(const FrameFeatures& frame, const FrameFeatures& other) {
  const DescriptorsView corners = frame.corner_descriptors();
  if (corners.height == 0) return 0.0;
  features::BruteForceOptions options;
  options.max_distance = kSameBits;
  options.cross_check = true;
  std::vector<Match> matches;
  features::match_brute_force(corners, other.corner_descriptors(), options, matches);
  return static_cast<double>(matches.size()) / static_cast<double>(corners.height);
}

}  // namespace dynslam::slam
