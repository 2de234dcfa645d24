#include "feature_tracks.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "dynslam/core/opencv.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kComparedFrames = 5;  // P-Static
// Seconds between the frames compared: the young catch the fast, the old the slow.
constexpr std::array<double, kComparedFrames> kGaps = {0.12, 0.25, 0.45, 0.7, 1.0};
constexpr std::size_t kMostPastFrames = 40;  // frames
constexpr double kHalfLife = 1.0;            // seconds until half of the evidence is forgotten
constexpr float kSurelyDynamic = 4.0F;       // most log-odds remembered against a feature
constexpr float kSurelyStatic = 2.0F;  // and for it: less, so that what starts to move is found
constexpr float kDecision = 0.6F;
constexpr int kSpreadRadius = 2;  // pixels around a feature whose depths are compared

}  // namespace

FeatureTracks::FeatureTracks(const DepthCamera& camera, const std::vector<float>& scale_factors)
    : camera_(camera), scale_factors_(scale_factors), matches_(kComparedFrames) {}

void FeatureTracks::measure(const TrackedFrame& frame, Past& now) const {
  const FrameFeatures& features = *frame.features;
  now.features = frame.features;
  now.timestamp = frame.timestamp;
  now.T_cam_world = frame.T_cam_world;
  now.previous = frame.previous;
  now.scales.resize(features.size());
  now.spreads.resize(features.size());
  for (std::size_t i = 0; i < features.size(); ++i) {
    now.scales[i] = scale_factors_[static_cast<std::size_t>(features.keypoints[i].octave)];
  }
  if (frame.depth.empty()) {
    now.spreads.clear();
    return;
  }
  std::vector<float> depths(features.size());
  geometry::measure_depths(as_view<const float>(frame.depth),
                           field(features.keypoints, &cv::KeyPoint::pt), kSpreadRadius, depths,
                           now.spreads);
}

geometry::FeaturesView FeatureTracks::view(const Past& past) const {
  geometry::FeaturesView view;
  view.pixels = field(past.features->keypoints, &cv::KeyPoint::pt);
  view.depths = past.features->depths;
  view.scales = past.scales;
  view.spreads = past.spreads;
  return view;
}

void FeatureTracks::judge(const TrackedFrame& frame) {
  measure(frame, now_);
  verdicts_.resize(frame.features->size());
  references_.clear();
  chain_ = now_.previous;
  std::size_t gap = 0;
  for (const Past& past : past_) {
    if (gap == kComparedFrames) break;
    if (frame.timestamp - past.timestamp >= kGaps[gap] - 1e-6) {
      std::vector<Match>& matches = matches_[gap++];
      matches.clear();
      for (std::size_t i = 0; i < chain_.size(); ++i) {
        if (chain_[i] >= 0) matches.push_back({static_cast<std::int32_t>(i), chain_[i], 0.0F});
      }
      geometry::ReferenceView reference;
      reference.T_cur_ref = frame.T_cam_world * past.T_cam_world.inverse();
      reference.features = view(past);
      reference.matches = matches;
      references_.push_back(reference);
    }
    for (std::int32_t& feature : chain_) {
      if (feature >= 0) feature = past.previous[static_cast<std::size_t>(feature)];
    }
  }
  geometry::judge_features(camera_, view(now_), references_, {}, workspace_, verdicts_);
  recall(now_);
}

// What was found to move is remembered for a while, though it may pause.
void FeatureTracks::recall(Past& now) {
  now.odds.assign(verdicts_.size(), 0.0F);
  const float kept =
      past_.empty()
          ? 0.0F
          : static_cast<float>(std::exp2(-(now.timestamp - past_.front().timestamp) / kHalfLife));
  for (std::size_t i = 0; i < verdicts_.size(); ++i) {
    geometry::FeatureVerdict& verdict = verdicts_[i];
    const std::int32_t before = now.previous[i];
    const float remembered = before < 0 || past_.empty()
                                 ? 0.0F
                                 : kept * past_.front().odds[static_cast<std::size_t>(before)];
    const float odds = std::clamp(remembered + verdict.log_odds, -kSurelyStatic, kSurelyDynamic);
    now.odds[i] = verdict.log_odds = odds;
    const geometry::Verdict sum = odds > kDecision    ? geometry::Verdict::kDynamic
                                  : odds < -kDecision ? geometry::Verdict::kStatic
                                                      : geometry::Verdict::kUnknown;
    if (sum != verdict.verdict) verdict.reason = geometry::Reason::kRemembered;
    verdict.verdict = sum;
  }
}

void FeatureTracks::remember(const TrackedFrame& frame) {
  now_.T_cam_world = frame.T_cam_world;
  past_.push_front(std::move(now_));
  now_ = {};
  if (past_.size() > kMostPastFrames) past_.pop_back();
}

void FeatureTracks::move_world(const RigidTransform& T_before_after) {
  for (Past& past : past_) past.T_cam_world = past.T_cam_world * T_before_after;
}

void FeatureTracks::repose(double after, const std::function<RigidTransform(double)>& pose) {
  for (Past& past : past_) {
    if (past.timestamp > after) past.T_cam_world = pose(past.timestamp);
    past.odds.assign(past.odds.size(), 0.0F);
  }
}

}  // namespace dynslam::slam
