#include "dynslam/slam/system.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "dynslam/core/errors.hpp"

#include "feature_tracks.hpp"
#include "frame_builder.hpp"
#include "local_mapper.hpp"
#include "mover_detector.hpp"
#include "stopwatch.hpp"
#include "tracker.hpp"

namespace dynslam::slam {
namespace {

constexpr int kMinFirstPoints = 100;              // features with depth that start a map
constexpr double kMaxExtrapolation = 0.5;         // seconds over which a velocity is believed
constexpr std::size_t kRelocalizationTries = 12;  // keyframes compared with a lost frame
constexpr double kRestartAfter = 1.0;  // seconds lost after which a map of few keyframes is dropped
constexpr std::size_t kRestartKeyframes = 3;
constexpr int kWantedPoints = 100;  // a frame that tracks fewer, and could have
constexpr int kSparePoints = 70;    // so many more, becomes a keyframe

/// A frame's pose relative to a keyframe, so that it follows when the map is corrected.
struct FrameRecord {
  double timestamp;
  KeyframeId reference = kNoId;  // kNoId: no pose
  RigidTransform T_cam_reference;
};

}  // namespace

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
  Impl(const DepthCamera& camera_, const SystemOptions& options_)
      : camera(camera_),
        options(options_),
        builder(camera_, options_.tracking),
        tracker(camera_, options_, builder.scale_factors()),
        mapper(camera_, options_, builder.scale_factors()),
        tracks(camera_, builder.scale_factors()),
        movers(camera_) {}

  DepthCamera camera;
  SystemOptions options;
  FrameBuilder builder;
  Tracker tracker;
  LocalMapper mapper;
  FeatureTracks tracks;
  MoverDetector movers;
  Map map;

  std::vector<FrameRecord> records;
  TrackedFrame current, last;
  TrackingState state = TrackingState::kNotInitialized;
  KeyframeId reference = kNoId;
  std::size_t frames_since_keyframe = 0;
  std::size_t next_candidate = 0;  // where the search for a lost frame goes on
  double lost_since = 0.0;
  std::optional<Vector6d> velocity;  // twist of T_cam_last a second

  bool initialize();
  bool follow();
  bool relocalize();
  void restart_if_hopeless();
  std::vector<KeyframeId> relocalization_candidates();
  bool wants_keyframe(int inliers) const;
  void make_keyframe();
  void release(KeyframeId keyframe);
  void record();
  RigidTransform pose_of(const FrameRecord& record) const;
  void update_velocity();
  void find_movers(FrameResult& result);
  bool locate(FrameResult& result);
  void step(FrameResult& result);
};

System::System(const DepthCamera& camera, const SystemOptions& options) {
  camera.validate();
  options.validate();
  DepthCamera weighted = camera;
  if (options.tracking.virtual_baseline > 0.0) {
    weighted.bf = options.tracking.virtual_baseline * camera.fx;
  }
  impl_ = std::make_unique<Impl>(weighted, options);
}
System::~System() = default;
System::System(System&&) noexcept = default;
System& System::operator=(System&&) noexcept = default;

const Map& System::map() const { return impl_->map; }
MoversView System::movers() const { return {impl_->movers.mask(), impl_->movers.judged()}; }
const SystemOptions& System::options() const { return impl_->options; }

bool System::Impl::initialize() {
  const auto& depths = current.features->depths;
  const auto with_depth =
      std::count_if(depths.begin(), depths.end(), [](float z) { return z > 0; });
  if (with_depth < kMinFirstPoints) return false;
  current.T_cam_world = RigidTransform();
  make_keyframe();
  return true;
}

// Tracks from the last frame. The map may have been corrected since, so its pose is read anew.
bool System::Impl::follow() {
  last.T_cam_world = pose_of(records.back());
  const double dt = current.timestamp - last.timestamp;
  tracker.forget_velocity();
  tracker.forget_alignment();
  if (velocity && dt <= kMaxExtrapolation) tracker.set_velocity(se3_exp(dt * *velocity));
  geometry::DepthCheck depth_check;
  if (options.geometry && !current.depth.empty()) {
    depth_check = [this](const RigidTransform& T_cam_world) {
      return movers.static_share(current.depth, T_cam_world, current.timestamp);
    };
  }
  if (depth_check) tracker.align_background(last, current);
  if (tracker.track_last_frame(map, last, current, depth_check)) return true;
  if (tracker.align_depth(last, current)) {
    if (!tracker.track_last_frame(map, last, current, depth_check)) {
      current.reset(current.features, current.timestamp);
      current.T_cam_world = tracker.expected_pose(last);
    }
    return true;
  }
  return tracker.match_keyframe(map, reference, current);
}

std::vector<KeyframeId> System::Impl::relocalization_candidates() {
  std::vector<KeyframeId> candidates{reference};
  for (const KeyframeId id : map.covisible_keyframes(reference, kRelocalizationTries / 2 - 1)) {
    candidates.push_back(id);
  }
  // The rest of the map in turns, a few keyframes for each lost frame.
  const std::vector<KeyframeId> all = map.keyframe_ids();
  for (std::size_t i = 0; i < all.size() && candidates.size() < kRelocalizationTries; ++i) {
    const KeyframeId id = all[next_candidate++ % all.size()];
    if (std::find(candidates.begin(), candidates.end(), id) == candidates.end()) {
      candidates.push_back(id);
    }
  }
  return candidates;
}

bool System::Impl::relocalize() {
  for (const KeyframeId candidate : relocalization_candidates()) {
    current.reset(current.features, current.timestamp);
    if (!tracker.match_keyframe(map, candidate, current)) continue;
    const int inliers = tracker.track_local_map(map, candidate, current, true);
    if (inliers >= options.tracking.min_relocalization_inliers) return true;
  }
  return false;
}

void System::Impl::restart_if_hopeless() {
  const bool hopeless =
      map.keyframes_made() <= kRestartKeyframes && current.timestamp - lost_since > kRestartAfter;
  if (!hopeless) return;
  map = Map();
  movers.clear();
  tracks.clear();
  for (FrameRecord& record : records) record.reference = kNoId;
  reference = kNoId;
  state = TrackingState::kNotInitialized;
}

bool System::Impl::wants_keyframe(int inliers) const {
  if (frames_since_keyframe < static_cast<std::size_t>(options.mapping.min_frames)) return false;
  if (frames_since_keyframe >= static_cast<std::size_t>(options.mapping.max_frames)) return true;
  const std::size_t min_observations = map.keyframe_count() > 2 ? 3 : 2;
  int reference_points = 0;
  for (const PointId id : map.keyframe(reference).points) {
    const MapPoint* point = map.find_point(id);
    if (point != nullptr && point->observations.size() >= min_observations) ++reference_points;
  }
  int spare = 0;
  for (std::size_t i = 0; i < current.points.size(); ++i) {
    if (current.points[i] == kNoId && current.features->depths[i] > 0.0F) ++spare;
  }
  return inliers < options.mapping.keyframe_share * reference_points ||
         (inliers < kWantedPoints && spare > kSparePoints);
}

void System::Impl::make_keyframe() {
  reference = mapper.insert(map, current, records.size());
  mapper.refine(map, reference);
  for (const KeyframeId redundant : mapper.redundant_keyframes(map, reference)) {
    release(redundant);
    map.erase_keyframe(redundant);
  }
  current.T_cam_world = map.keyframe(reference).T_cam_world;
  frames_since_keyframe = 0;
}

// Frames that hang on a keyframe are tied to its best neighbour before it goes.
void System::Impl::release(KeyframeId keyframe) {
  const std::vector<KeyframeId> neighbours = map.covisible_keyframes(keyframe, 1);
  const KeyframeId heir = neighbours.empty() ? reference : neighbours.front();
  const RigidTransform T_keyframe_heir =
      map.keyframe(keyframe).T_cam_world * map.keyframe(heir).T_cam_world.inverse();
  for (FrameRecord& record : records) {
    if (record.reference != keyframe) continue;
    record.reference = heir;
    record.T_cam_reference = record.T_cam_reference * T_keyframe_heir;
  }
}

RigidTransform System::Impl::pose_of(const FrameRecord& record) const {
  return record.T_cam_reference * map.keyframe(record.reference).T_cam_world;
}

void System::Impl::record() {
  FrameRecord entry;
  entry.timestamp = current.timestamp;
  if (state == TrackingState::kTracked || state == TrackingState::kRelocalized) {
    entry.reference = reference;
    entry.T_cam_reference = current.T_cam_world * map.keyframe(reference).T_cam_world.inverse();
  }
  records.push_back(entry);
}

void System::Impl::update_velocity() {
  velocity.reset();
  if (records.empty() || records.back().reference == kNoId) return;
  const double dt = current.timestamp - last.timestamp;
  const RigidTransform T_last_world = pose_of(records.back());
  velocity = se3_log(current.T_cam_world * T_last_world.inverse()) / dt;
}

// Lets go of the features that move by geometry, given a first pose of the frame.
void System::Impl::find_movers(FrameResult& result) {
  if (!options.geometry || current.depth.empty()) return;
  const ScopedTimer timer(result.ms.geometry);
  tracks.judge(current);
  movers.detect(current, tracks.verdicts());
  result.moving_share = static_cast<float>(movers.masked_share());
  current.cell_trust = movers.trust();
  for (std::size_t i = 0; i < current.points.size(); ++i) {
    const cv::Point2f pixel = current.features->keypoints[i].pt;
    current.staticness[i] = movers.staticness(pixel);
    const bool covered =
        movers.mask().at<std::uint8_t>(cv::Point(cvRound(pixel.x), cvRound(pixel.y))) != 0;
    if (!covered && tracks.verdicts()[i].verdict != geometry::Verdict::kDynamic) continue;
    current.moving[i] = 1;
    current.rejected[i] = 1;
    current.points[i] = kNoId;
    ++result.moving_features;
  }
}

// Finds the pose of the current frame; the state says how that went.
bool System::Impl::locate(FrameResult& result) {
  if (state == TrackingState::kNotInitialized) {
    if (!initialize()) return false;
    result.keyframe = true;
    result.inliers = static_cast<int>(map.point_count());
    state = TrackingState::kTracked;
    return true;
  }
  if (state != TrackingState::kLost && follow()) {
    find_movers(result);
    result.inliers = tracker.track_local_map(map, reference, current, false);
    if (result.inliers >= options.tracking.min_inliers || tracker.depth_aligned()) {
      result.depth_aligned = tracker.depth_aligned();
      state = TrackingState::kTracked;
      return true;
    }
  }
  if (relocalize()) {
    find_movers(result);
    result.inliers = static_cast<int>(std::count_if(current.points.begin(), current.points.end(),
                                                    [](PointId id) { return id != kNoId; }));
    state = TrackingState::kRelocalized;
    return true;
  }
  if (state != TrackingState::kLost) lost_since = current.timestamp;
  state = TrackingState::kLost;
  return false;
}

void System::Impl::step(FrameResult& result) {
  const bool first = state == TrackingState::kNotInitialized;
  const bool located = locate(result);
  const TrackerTimes times = tracker.take_times();
  result.state = state;
  if (located && !first) {
    const ScopedTimer timer(result.ms.map);
    reference = tracker.local_map().reference;
    ++frames_since_keyframe;
    update_velocity();
    if (state == TrackingState::kTracked && wants_keyframe(result.inliers)) {
      make_keyframe();
      result.keyframe = true;
    }
  }
  result.ms.match = times.match;
  result.ms.optimize = times.optimize;
  if (located) result.T_world_cam = current.T_cam_world.inverse();
  if (located && options.geometry && !current.depth.empty()) {
    if (first) find_movers(result);
    tracks.remember(current);
    movers.remember(current.depth, current.T_cam_world, current.timestamp);
  }
  record();
  if (state == TrackingState::kLost) restart_if_hopeless();
  std::swap(last, current);
}

FrameResult System::track(const FrameInput& frame) {
  Impl& s = *impl_;
  s.builder.require_valid(frame);
  require(std::isfinite(frame.timestamp), "System::track", "timestamp", frame.timestamp,
          "a finite number of seconds");
  if (!s.records.empty() && !(frame.timestamp > s.records.back().timestamp)) {
    throw_invalid_argument("System::track", "timestamp", frame.timestamp,
                           "a time after " + std::to_string(s.records.back().timestamp));
  }
  FrameResult result;
  result.index = s.records.size();
  result.timestamp = frame.timestamp;
  {
    const ScopedTimer whole(result.ms.total);
    {
      const ScopedTimer timer(result.ms.extract);
      s.current.reset(s.builder.build(frame), frame.timestamp);
      s.builder.copy_depth(frame, s.current.depth);
      if (s.options.geometry) s.builder.gray().copyTo(s.current.gray);
      s.current.gray_cells = s.builder.gray_cells().clone();
    }
    result.features = static_cast<int>(s.current.features->size());
    result.masked_share = s.current.features->masked_share;
    s.step(result);
  }
  return result;
}

Trajectory System::trajectory() const {
  Trajectory poses;
  for (const FrameRecord& record : impl_->records) {
    if (record.reference == kNoId) continue;
    poses.push_back({record.timestamp, impl_->pose_of(record).normalized().inverse()});
  }
  return poses;
}

Trajectory System::keyframe_trajectory() const {
  Trajectory poses;
  for (const KeyframeId id : impl_->map.keyframe_ids()) {
    const Keyframe& keyframe = impl_->map.keyframe(id);
    poses.push_back({keyframe.timestamp, keyframe.T_cam_world.normalized().inverse()});
  }
  return poses;
}

}  // namespace dynslam::slam
