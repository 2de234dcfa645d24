#include "start_check.hpp"

#include <iterator>

#include "dynslam/core/so3.hpp"

#include "wide_alignment.hpp"

namespace dynslam::slam {
namespace {

// Seconds after the first frame: what walks has moved by half of its width, then by all of it.
constexpr double kLooks[] = {0.2, 0.4};
constexpr double kTooLate = 1.0;      // by then too little is left of what the first frame saw
constexpr double kSameMetres = 0.02;  // by which the two motions may differ
constexpr double kSameRadians = 0.02;
constexpr double kClearly = 1.2;  // times as much must agree with the other motion
constexpr int kStep = 2;          // cells

}  // namespace

void StartCheck::begin(const TrackedFrame& first) {
  cancel();
  if (first.depth.empty()) return;
  first_.reset(first.features, first.timestamp);
  first_.T_cam_world = first.T_cam_world;
  build_surface_grid(first.depth, first.gray_cells, camera_, first_.surface);
  looks_ = 0;
}

bool StartCheck::is_due(double timestamp) const {
  const double age = timestamp - first_.timestamp;
  return !first_.surface.empty() && looks_ < static_cast<int>(std::size(kLooks)) &&
         age < kTooLate && age >= kLooks[looks_] - 1e-6;
}

std::optional<RigidTransform> StartCheck::contradict(Span<const RigidTransform> motions,
                                                     TrackedFrame& frame) {
  ++looks_;
  if (!ensure_surface(camera_, frame)) return std::nullopt;
  const auto agreement = [&](const RigidTransform& T_first_cam) {
    return measure_fit(first_.surface, frame.surface, camera_, T_first_cam, kStep).agree;
  };
  const RigidTransform tracked = first_.T_cam_world * frame.T_cam_world.inverse();
  double best = kClearly * agreement(tracked);
  std::optional<RigidTransform> T_cam_world;
  for (const RigidTransform& T_first_cam : motions) {
    const RigidTransform off = tracked.inverse() * T_first_cam;
    if (off.t.norm() < kSameMetres && so3_log(off.R).norm() < kSameRadians) continue;
    const double agree = agreement(T_first_cam);
    if (agree <= best) continue;
    best = agree;
    T_cam_world = (T_first_cam.inverse() * first_.T_cam_world).normalized();
  }
  return T_cam_world;
}

RigidTransform StartCheck::between(double timestamp, double corrected_timestamp,
                                   const RigidTransform& corrected) const {
  const double share = (timestamp - first_.timestamp) / (corrected_timestamp - first_.timestamp);
  const Vector6d motion = se3_log(corrected * first_.T_cam_world.inverse());
  return (se3_exp(share * motion) * first_.T_cam_world).normalized();
}

}  // namespace dynslam::slam
