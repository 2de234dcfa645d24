#include "second_look.hpp"

#include <algorithm>

#include "dynslam/core/so3.hpp"

#include "wide_alignment.hpp"

namespace dynslam::slam {
namespace {

// Seconds after the first frame: what walks has moved by half of its width, then by all of it.
constexpr double kEarlyLooks[] = {0.2, 0.4};
constexpr double kLaterLooks[] = {0.2};
constexpr double kTooLate = 1.0;     // by then too little is left of what the first frame saw
constexpr double kSame = 0.03;       // metres and radians by which two motions may differ
constexpr double kClearly = 1.5;     // times as much surface must agree with the other motion
constexpr double kDoubtful = 2.0;    // looks that say little: until then much is still the same
constexpr double kCertain = 10.0;    // looks after which twice as much must agree
constexpr double kLeastShare = 0.2;  // of both frames' surface, or it may be of a mover
// Information on a motion that is to stay what it is, and on one that keeps only what surfaces
// leave open.
constexpr double kHeld = 1e7, kFree = 1.0;
constexpr int kStep = 2;  // cells
constexpr int kAlignmentStep = 3;

bool same(const RigidTransform& a, const RigidTransform& b) {
  const RigidTransform off = a.inverse() * b;
  return off.t.norm() < kSame && so3_log(off.R).norm() < kSame;
}

AlignmentOptions alignment_options() {
  AlignmentOptions options;
  options.max_rms = 0.1;
  options.min_overlap = 0.1;
  options.step = kAlignmentStep;
  options.use_brightness = true;
  return options;
}

}  // namespace

void SecondLook::take(TrackedFrame& first, const LastKeyframe& keyframe, Span<const double> looks) {
  cancel();
  if (!ensure_surface(camera_, first)) return;
  first_.reset(first.features, first.timestamp);
  first_.T_cam_world = first.T_cam_world;
  first_.surface = first.surface;
  first_.surface.gray = first.surface.gray.clone();  // images share what they hold
  first_.surface.trust = surface_by_cell(first_.surface);
  keyframe_ = keyframe;
  looks_ = looks;
}

void SecondLook::begin(TrackedFrame& first, const LastKeyframe& keyframe) {
  take(first, keyframe, kEarlyLooks);
  withstood_ = 0;
}

void SecondLook::begin_anew(TrackedFrame& first, const LastKeyframe& keyframe) {
  take(first, keyframe, kLaterLooks);
}

bool SecondLook::is_over(double timestamp) const {
  return first_.surface.empty() || looks_.empty() || timestamp - first_.timestamp >= kTooLate;
}

bool SecondLook::is_due(double timestamp) const {
  return !is_over(timestamp) && timestamp - first_.timestamp >= looks_[0] - 1e-6;
}

// What one look after the other has left as it was takes more to be contradicted.
double SecondLook::clearly() const {
  return kClearly * (1.0 + std::clamp((withstood_ - kDoubtful) / (kCertain - kDoubtful), 0.0, 1.0));
}

// By aligned depth; near surfaces count no more than far ones of the same size.
RigidTransform SecondLook::polished(const RigidTransform& T_first_cam, double certainty,
                                    const TrackedFrame& frame) const {
  AlignmentOptions options = alignment_options();
  options.guess_information = certainty * Matrix6d::Identity();
  const auto aligned = align_surfaces(first_.surface, frame.surface, camera_, T_first_cam, options);
  return aligned ? aligned->T_from_to : T_first_cam;
}

std::optional<RigidTransform> SecondLook::contradict(Span<const RigidTransform> motions,
                                                     TrackedFrame& frame) {
  looks_ = {looks_.data() + 1, looks_.size() - 1};
  if (!ensure_surface(camera_, frame)) return std::nullopt;
  const auto agreement = [&](const RigidTransform& T_first_cam) {
    return agreeing_surface(first_.surface, frame.surface, camera_, T_first_cam, kStep);
  };
  const RigidTransform tracked = first_.T_cam_world * frame.T_cam_world.inverse();
  const RigidTransform held = polished(tracked, kHeld, frame);
  double best = agreement(tracked);
  if (same(held, tracked)) best = std::max(best, agreement(held));
  best = std::max(kLeastShare, clearly() * best);
  std::optional<RigidTransform> T_cam_world;
  const auto consider = [&](const RigidTransform& T_first_cam) {
    if (same(T_first_cam, tracked)) return;
    const double agree = agreement(T_first_cam);
    if (agree <= best) return;
    best = agree;
    T_cam_world = (T_first_cam.inverse() * first_.T_cam_world).normalized();
  };
  consider(held);
  consider(polished(tracked, kFree, frame));
  for (const RigidTransform& motion : motions) {
    if (same(motion, tracked)) continue;
    consider(motion);
    consider(polished(motion, kHeld, frame));
  }
  withstood_ = T_cam_world ? 0 : withstood_ + 1;
  return T_cam_world;
}

RigidTransform SecondLook::between(double timestamp, double corrected_timestamp,
                                   const RigidTransform& corrected) const {
  const double seconds = timestamp - first_.timestamp;
  const Vector6d motion = seconds * velocity(corrected_timestamp, corrected);
  return (se3_exp(motion) * first_.T_cam_world).normalized();
}

Vector6d SecondLook::velocity(double corrected_timestamp, const RigidTransform& corrected) const {
  return se3_log(corrected * first_.T_cam_world.inverse()) /
         (corrected_timestamp - first_.timestamp);
}

}  // namespace dynslam::slam
