#include "keyframe_similarity.hpp"

#include <vector>

#include "dynslam/core/match.hpp"
#include "dynslam/features/matcher.hpp"

namespace dynslam::slam {
namespace {

constexpr int kSameBits = 50;  // the strict of the field's two thresholds for ORB

}  // namespace

double similarity(const FrameFeatures& frame, const FrameFeatures& other) {
  if (frame.size() == 0) return 0.0;
  features::BruteForceOptions options;
  options.max_distance = kSameBits;
  options.cross_check = true;
  std::vector<Match> matches;
  features::match_brute_force(frame.descriptors_view(), other.descriptors_view(), options, matches);
  return static_cast<double>(matches.size()) / static_cast<double>(frame.size());
}

}  // namespace dynslam::slam
