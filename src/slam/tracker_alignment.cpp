// What Tracker expects of a frame before its features are looked at: by aligned depth, and by the
// motion so far.
#include <algorithm>

#include "dynslam/features/matcher.hpp"

#include "matrix6.hpp"
#include "stopwatch.hpp"
#include "tracker.hpp"
#include "wide_alignment.hpp"

namespace dynslam::slam {
namespace {

constexpr int kMinGuessInliers = 6;  // of a motion that dense alignment is to judge
// Errors of neighbouring depth pixels are not independent: a grid of thousands is worth dozens.
constexpr double kAlignmentTrust = 0.01;
// Nor are those of features: the covariance of a pose is so many times what counting them gives.
constexpr double kFeatureDoubt = 2.0;
constexpr double kDepthBias = 0.01;  // metres that aligned depth is off as a whole
constexpr double kTurnBias = 0.01;   // radians

}  // namespace

void Tracker::set_prior(const TrackedFrame& last, const SurfaceAlignment& alignment) {
  factors::PosePrior prior;
  prior.mean = velocity_ * last.T_cam_world;
  // xi of T_from_to is -Ad(T_from_to) times that of T_cam_world.
  const Matrix6d ad = se3_adjoint(alignment.T_from_to);
  prior.information = kAlignmentTrust * ad.transpose() * alignment.information * ad;
  prior_ = prior;
}

bool Tracker::align_depth(TrackedFrame& last, TrackedFrame& frame) {
  const ScopedTimer timer(times_.match);
  if (!ensure_surface(camera_, last) || !ensure_surface(camera_, frame)) return false;
  last.surface.trust.release();
  for (const RigidTransform& guess : {velocity_.inverse(), RigidTransform()}) {
    const auto alignment = align_surfaces(last.surface, frame.surface, camera_, guess);
    if (!alignment) continue;
    velocity_ = predicted_ = alignment->T_from_to.inverse();
    set_prior(last, *alignment);
    return true;
  }
  return false;
}

std::vector<RigidTransform> Tracker::guess_by_descriptors(const TrackedFrame& last,
                                                          const TrackedFrame& frame) {
  features::BruteForceOptions options;
  options.max_distance = 64;
  options.ratio = 0.8F;
  options.cross_check = true;
  features::match_brute_force(last.features->descriptors_view(), frame.features->descriptors_view(),
                              options, found_);
  motions_.clear();
  for (const Match& match : found_) {
    const auto source = static_cast<std::size_t>(match.query);
    const auto feature = static_cast<std::size_t>(match.train);
    const float depth = last.features->depths[source];
    if (!(depth > 0.0F) || last.rejected[source] != 0) continue;
    const cv::Point2f from = last.features->keypoints[source].pt;
    const cv::KeyPoint& keypoint = frame.features->keypoints[feature];
    motions_.add(camera_.unproject({from.x, from.y}, depth), keypoint.pt,
                 frame.features->depths[feature],
                 scale_factors_[static_cast<std::size_t>(keypoint.octave)], 0.5F, 0.0F);
  }
  geometry::RobustPoseOptions search;
  search.min_inliers = kMinGuessInliers;
  geometry::estimate_pose(camera_, motions_.problem(), nullptr, {}, search, motions_.workspace,
                          motions_.result);
  std::vector<RigidTransform> guesses;
  for (const auto& hypothesis : motions_.result.hypotheses) {
    guesses.push_back(hypothesis.T_cam_world.inverse());
  }
  return guesses;
}

bool Tracker::align_wide_step(TrackedFrame& last, TrackedFrame& frame) {
  const ScopedTimer timer(times_.match);
  if (!ensure_surface(camera_, last) || !ensure_surface(camera_, frame)) return false;
  last.surface.trust = last.cell_trust;
  std::vector<RigidTransform> guesses = guess_by_descriptors(last, frame);
  guesses.insert(guesses.begin(), {velocity_.inverse(), RigidTransform()});
  const auto found = align_wide(last.surface, frame.surface, camera_, guesses);
  if (!found) return false;
  wide_step_ = true;
  velocity_ = predicted_ = found->alignment.T_from_to.inverse();
  SurfaceAlignment alignment = found->alignment;
  Vector6d systematic;  // calibration, rolling shutter: what no number of cells averages out
  systematic << Eigen::Vector3d::Constant(kDepthBias * kDepthBias),
      Eigen::Vector3d::Constant(kTurnBias * kTurnBias);
  const Matrix6d covariance =
      inverse_of(kAlignmentTrust * alignment.information) + Matrix6d(systematic.asDiagonal());
  alignment.information = inverse_of(covariance) / kAlignmentTrust;
  set_prior(last, alignment);
  return true;
}

void Tracker::align_background(TrackedFrame& last, TrackedFrame& frame) {
  const ScopedTimer timer(times_.match);
  if (!ensure_surface(camera_, last) || !ensure_surface(camera_, frame)) return;
  last.surface.trust = last.cell_trust;
  AlignmentOptions options;
  options.first_gate = 0.12;
  options.min_overlap = 0.1;
  options.step = 2;
  options.use_brightness = true;
  const double translation = std::max(kGuessTranslation, kHandAcceleration * step_ * step_);
  const double rotation = std::max(kGuessRotation, kWristAcceleration * step_ * step_);
  Vector6d certainty;
  certainty << Eigen::Vector3d::Constant(1.0 / (translation * translation)),
      Eigen::Vector3d::Constant(1.0 / (rotation * rotation));
  // On the scale of what aligned cells say, before that is trusted a hundredth.
  options.guess_information = (certainty / kAlignmentTrust).asDiagonal();
  const auto alignment =
      align_surfaces(last.surface, frame.surface, camera_, velocity_.inverse(), options);
  if (!alignment) return;
  velocity_ = alignment->T_from_to.inverse();
  set_prior(last, *alignment);
}

// The optimizer believes every feature, so what it weighs them against has to count for more, too.
std::optional<factors::PosePrior> Tracker::expected_motion() {
  if (!motion_.predicted()) return prior_;
  if (prior_) motion_.observe_step(prior_->mean, prior_->information / kFeatureDoubt);
  factors::PosePrior expected = motion_.prior();
  expected.information *= kFeatureDoubt;
  return expected;
}

void Tracker::remember_motion(const TrackedFrame& frame) {
  if (metric_ && covariance_) motion_.update(frame.T_cam_world, kFeatureDoubt * *covariance_);
}

}  // namespace dynslam::slam
