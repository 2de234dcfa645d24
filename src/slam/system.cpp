#include "dynslam/slam/system.hpp"

#include <cmath>
#include <string>
#include <utility>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"

#include "backend.hpp"
#include "frame_builder.hpp"
#include "shared_map.hpp"
#include "stored_map.hpp"
#include "tracking_session.hpp"

namespace dynslam::slam {

const char* to_string(TrackingState state) {
  switch (state) {
    case TrackingState::kNotInitialized:
      return "not_initialized";
    case TrackingState::kTracked:
      return "tracked";
    case TrackingState::kRelocalized:
      return "relocalized";
    case TrackingState::kLost:
      return "lost";
  }
  return "";
}

struct System::Impl {
  Impl(const DepthCamera& camera_, const SystemOptions& options_, loop::Vocabulary vocabulary)
      : camera(camera_),
        options(options_),
        builder(camera, options_),
        backend(camera, options_, builder.scale_factors(), std::move(vocabulary), shared),
        session(camera, options_, builder, shared, backend) {}

  DepthCamera camera;
  SystemOptions options;
  FrameBuilder builder;
  SharedMap shared;
  Backend backend;  // its workers end before what they use
  TrackingSession session;
  std::size_t stored_keyframes = 0;  // numbers below are of a map made before
};

System::System(const DepthCamera& camera, const SystemOptions& options,
               loop::Vocabulary vocabulary) {
  options.validate();
  require(vocabulary.empty() || vocabulary.descriptor_bytes() == 32, "System", "vocabulary",
          std::to_string(vocabulary.empty() ? 0 : vocabulary.descriptor_bytes()) + " bytes a word",
          "a vocabulary of 32-byte descriptors");
  DepthCamera weighted = camera;
  if (options.sensor == Sensor::kMono) weighted.bf = weighted.fx;  // of no meaning, but valid
  weighted.validate();
  if (options.sensor == Sensor::kRgbd && options.tracking.virtual_baseline > 0.0) {
    weighted.bf = options.tracking.virtual_baseline * camera.fx;
  }
  impl_ = std::make_unique<Impl>(weighted, options, std::move(vocabulary));
}
System::~System() = default;
System::System(System&&) noexcept = default;
System& System::operator=(System&&) noexcept = default;

const Map& System::map() const { return impl_->shared.map; }
FeaturesView System::features() const { return impl_->session.features(); }
MoversView System::movers() const { return impl_->session.movers(); }
const SystemOptions& System::options() const { return impl_->options; }

FrameResult System::track(const FrameInput& frame) {
  Impl& s = *impl_;
  s.backend.rethrow_failure();
  s.builder.require_valid(frame);
  require(std::isfinite(frame.timestamp), "System::track", "timestamp", frame.timestamp,
          "a finite number of seconds");
  // Only this thread makes the log longer.
  if (!s.shared.log.empty() && !(frame.timestamp > s.shared.log.last_timestamp())) {
    throw_invalid_argument("System::track", "timestamp", frame.timestamp,
                           "a time after " + std::to_string(s.shared.log.last_timestamp()));
  }
  return s.session.track(frame);
}

void System::start_from(StoredMap stored) {
  Impl& s = *impl_;
  constexpr const char* kName = "System::start_from";
  require(s.shared.log.empty(), kName, "frames tracked", s.shared.log.size(), "none yet");
  require_suitable(kName, stored, s.camera, s.builder.scale_factors());
  convert_right_columns(stored, s.camera.bf);
  s.shared.map = std::move(stored.map);
  s.stored_keyframes = s.shared.map.keyframes_made();
  s.backend.adopt_map();
  s.session.start_in_known_map();
}

void System::save_map(const std::string& path) const {
  std::string bytes;
  {
    const BackgroundLock lock(impl_->shared.mutex);
    bytes = serialize_map(impl_->shared.map, impl_->camera, impl_->builder.scale_factors());
  }
  write_file_atomically(path, bytes);
}

void System::finish() { impl_->backend.finish(); }

std::vector<LoopClosure> System::loops() const {
  const BackgroundLock lock(impl_->shared.mutex);
  return impl_->backend.closures();
}

Trajectory System::trajectory() const {
  const BackgroundLock lock(impl_->shared.mutex);
  return impl_->shared.log.trajectory(impl_->shared.map);
}

Trajectory System::keyframe_trajectory() const {
  const BackgroundLock lock(impl_->shared.mutex);
  Trajectory poses;
  for (const KeyframeId id : impl_->shared.map.keyframe_ids()) {
    const Keyframe& keyframe = impl_->shared.map.keyframe(id);
    if (keyframe.number < impl_->stored_keyframes) continue;
    poses.push_back({keyframe.timestamp, keyframe.T_cam_world.normalized().inverse()});
  }
  return poses;
}

}  // namespace dynslam::slam
