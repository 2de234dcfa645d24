#include "tracking_session.hpp"

#include <algorithm>
#include <utility>

#include "dynslam/factors/similarity.hpp"

#include "keyframe_similarity.hpp"
#include "median_depth.hpp"
#include "stopwatch.hpp"

namespace dynslam::slam {
namespace {

using factors::Similarity;

constexpr int kMinFirstPoints = 100;              // features with depth that start a map
constexpr double kMaxExtrapolation = 0.5;         // seconds over which a velocity is believed
constexpr double kWideStep = 0.3;                 // beyond which it may be off by a decimetre
constexpr double kMaxGuess = 1.5;                 // and up to which it is a guess among others
constexpr std::size_t kRelocalizationTries = 12;  // keyframes compared with a lost frame
constexpr std::size_t kFirstTries = 20;           // and with one that may be anywhere
constexpr double kRestartAfter = 1.0;  // seconds lost after which a map of few keyframes is dropped
constexpr std::size_t kRestartKeyframes = 3;
// What takes a camera farther from where it was expected is no motion: five g and a flick of the
// wrist, beside errors of the pose, which grow with the distance of what is seen.
constexpr double kMaxAcceleration = 50.0;  // m/s^2
constexpr double kMaxTurn = 200.0;         // rad/s^2
constexpr double kPoseNoise = 0.03;        // share of the median depth, and radians
constexpr double kUnknownVelocity = 2.0;   // by which more it may have gone from one unknown
constexpr int kWantedPoints = 100;         // a frame that tracks fewer, and could have
constexpr int kSparePoints = 70;           // so many more, becomes a keyframe
// Or, in a map of few keyframes, that tracks less than this share of the features there are to be,
// and could have twice as many: those keyframes were full of what has turned out to move.
constexpr double kThinShare = 0.3;
constexpr std::size_t kYoungKeyframes = 3;
constexpr std::size_t kComparedKeyframes = 3;  // that a frame must look unlike to be new

}  // namespace

TrackingSession::TrackingSession(const DepthCamera& camera, const SystemOptions& options,
                                 FrameBuilder& builder, SharedMap& shared, Backend& backend)
    : options_(options),
      builder_(builder),
      shared_(shared),
      backend_(backend),
      tracker_(camera, options, builder.scale_factors()),
      mono_(camera, builder.scale_factors()),
      tracks_(camera, builder.scale_factors()),
      movers_(camera),
      second_look_(camera) {}

// A map that was corrected as a whole takes the poses along that are kept outside of it.
void TrackingSession::follow_corrections() {
  if (corrections_ == shared_.corrections) return;
  corrections_ = shared_.corrections;
  tracker_.forget_alignment();
  second_look_.cancel();
  const double scale = shared_.log.take_scale();
  const std::optional<RigidTransform> corrected = shared_.log.last_pose(shared_.map);
  if (!corrected) {
    movers_.clear();
    tracks_.clear();
    return;
  }
  const Similarity S_cam_after(1.0 / scale, corrected->R, corrected->t / scale);
  const Similarity S_before_after = Similarity(last_.T_cam_world).inverse() * S_cam_after;
  current_.T_cam_world = (Similarity(current_.T_cam_world) * S_before_after).rigid();
  last_.T_cam_world = *corrected;
  if (velocity_) velocity_->head<3>() *= scale;
  tracker_.rescale(scale);
  // What was seen in depth needs no scale.
  movers_.move_world(S_before_after.rigid());
  tracks_.move_world(S_before_after.rigid());
}

// Both frames become keyframes; those between them never had a pose.
bool TrackingSession::initialize_mono(FrameResult& result) {
  if (!mono_.offer(current_, shared_.log.size())) return false;
  const MonoStart& start = mono_.start();
  shared_.log.reference = backend_.insert_start(start, current_, shared_.log.size());
  velocity_ = se3_log(current_.T_cam_world) / (current_.timestamp - start.first.timestamp);
  frames_since_keyframe_ = 0;
  most_inliers_ = 0;
  result.keyframe = true;
  mono_.reset();
  return true;
}

void TrackingSession::start_in_known_map() {
  known_map_ = true;
  state_ = TrackingState::kLost;
}

bool TrackingSession::initialize(FrameResult& result, TrackingLock& lock) {
  if (options_.localize_only) return false;
  if (options_.sensor == Sensor::kMono) return initialize_mono(result);
  const auto& depths = current_.features->depths;
  const auto with_depth =
      std::count_if(depths.begin(), depths.end(), [](float z) { return z > 0; });
  if (with_depth < kMinFirstPoints) return false;
  current_.T_cam_world = T_cam_origin_;
  make_keyframe(result, lock);
  past_.begin(current_.timestamp);
  if (options_.geometry) second_look_.begin(current_, last_keyframe());
  return true;
}

// Where the camera is expected; true if that rests on the alignment of a wide step.
bool TrackingSession::expect_motion(TrackingLock& lock) {
  const double dt = current_.timestamp - last_.timestamp;
  tracker_.forget_velocity();
  tracker_.begin_frame(last_, dt);
  if (velocity_ && dt <= kMaxGuess) tracker_.set_velocity(se3_exp(dt * *velocity_));
  if (dt > kWideStep) {
    // Over a long step features may go astray unnoticed, so shape has the first word.
    bool aligned = false;
    without_map(lock, [&] { aligned = tracker_.align_wide_step(last_, current_); });
    if (aligned) return true;
    if (dt > kMaxExtrapolation) tracker_.forget_velocity();
  }
  if (options_.geometry && !current_.depth.empty()) {
    without_map(lock, [this] { tracker_.align_background(last_, current_); });
  }
  return false;
}

// Tracks from the last frame. The map may have been corrected since, so its pose is read anew.
bool TrackingSession::follow(TrackingLock& lock) {
  last_.T_cam_world = *shared_.log.last_pose(shared_.map);
  geometry::DepthCheck depth_check;
  if (options_.geometry && !current_.depth.empty()) {
    depth_check = [this](const RigidTransform& T_cam_world) {
      return movers_.static_share(current_.depth, T_cam_world, current_.timestamp);
    };
  }
  const bool wide = expect_motion(lock);
  const Map& map = shared_.map;
  if (tracker_.track_last_frame(map, last_, current_, depth_check)) return true;
  if (wide || tracker_.align_depth(last_, current_) || tracker_.align_wide_step(last_, current_)) {
    if (!tracker_.track_last_frame(map, last_, current_, depth_check)) {
      current_.start_over();
      current_.T_cam_world = tracker_.expected_pose(last_);
    }
    return true;
  }
  return tracker_.match_keyframe(map, shared_.log.reference, current_);
}

std::vector<KeyframeId> TrackingSession::relocalization_candidates() {
  const Map& map = shared_.map;
  const KeyframeId reference = shared_.log.reference;
  std::vector<KeyframeId> candidates;
  const auto add = [&](KeyframeId id) {
    const bool known = std::find(candidates.begin(), candidates.end(), id) != candidates.end();
    if (!known && map.find_keyframe(id) != nullptr) candidates.push_back(id);
  };
  for (const KeyframeId id : backend_.similar(*current_.features, kRelocalizationTries / 2)) {
    add(id);
  }
  add(reference);
  if (reference != kNoId) {
    for (const KeyframeId id : map.covisible_keyframes(reference, kRelocalizationTries / 2 - 1)) {
      add(id);
    }
  }
  // The rest of the map in turns, a few keyframes for each lost frame.
  const std::vector<KeyframeId> all = map.keyframe_ids();
  const std::size_t tries = reference == kNoId ? kFirstTries : kRelocalizationTries;
  for (std::size_t i = 0; i < all.size() && candidates.size() < tries; ++i) {
    add(all[next_candidate_++ % all.size()]);
  }
  return candidates;
}

bool TrackingSession::relocalize() {
  for (const KeyframeId candidate : relocalization_candidates()) {
    current_.start_over();
    if (!tracker_.match_keyframe(shared_.map, candidate, current_)) continue;
    const int inliers = tracker_.track_local_map(shared_.map, candidate, current_, true);
    if (inliers >= options_.tracking.min_relocalization_inliers) return true;
  }
  return false;
}

void TrackingSession::restart_if_hopeless() {
  const bool hopeless = !known_map_ && shared_.map.keyframes_made() <= kRestartKeyframes &&
                        current_.timestamp - lost_since_ > kRestartAfter;
  if (!hopeless) return;
  // The next map begins where the camera was seen last: the best guess there is.
  T_cam_origin_ = shared_.log.latest_pose(shared_.map).value_or(RigidTransform());
  shared_.log.let_go_of_map(shared_.map);
  shared_.map.clear();
  movers_.clear();
  tracks_.clear();
  second_look_.cancel();
  past_.clear();
  state_ = TrackingState::kNotInitialized;
}

// Whether the frame looks less like the keyframes around than like the frame before.
bool TrackingSession::looks_new() const {
  const Map& map = shared_.map;
  const KeyframeId reference = shared_.log.reference;
  std::vector<KeyframeId> around = map.covisible_keyframes(reference, kComparedKeyframes - 1);
  around.push_back(reference);
  const double threshold =
      options_.mapping.keyframe_similarity * similarity(*current_.features, *last_.features);
  return std::all_of(around.begin(), around.end(), [&](KeyframeId id) {
    return similarity(*current_.features, *map.keyframe(id).features) < threshold;
  });
}

bool TrackingSession::wants_keyframe(int inliers) const {
  if (options_.localize_only) return false;
  if (!backend_.accepts_keyframe()) return false;
  if (frames_since_keyframe_ < static_cast<std::size_t>(options_.mapping.min_frames)) return false;
  if (frames_since_keyframe_ >= static_cast<std::size_t>(options_.mapping.max_frames)) return true;
  if (inliers < options_.mapping.remaining_share * most_inliers_) return true;
  const Map& map = shared_.map;
  const std::size_t min_observations = map.keyframe_count() > 2 ? 3 : 2;
  int reference_points = 0;
  for (const PointId id : map.keyframe(shared_.log.reference).points) {
    const MapPoint* point = map.find_point(id);
    if (point != nullptr && point->observations.size() >= min_observations) ++reference_points;
  }
  int spare = 0, still = 0;
  for (std::size_t i = 0; i < current_.points.size(); ++i) {
    if (current_.points[i] != kNoId || !(current_.features->depths[i] > 0.0F)) continue;
    ++spare;
    if (current_.moving[i] == 0 && current_.rejected[i] == 0) ++still;
  }
  if (inliers < kWantedPoints && spare > kSparePoints) return true;
  const bool thin = inliers < kThinShare * options_.tracking.orb.max_features;
  if (thin && still > inliers && map.keyframes_made() <= kYoungKeyframes) return true;
  if (options_.mapping.keyframe_similarity > 0.0) return looks_new();
  const double share = options_.sensor == Sensor::kMono ? options_.mapping.mono_keyframe_share
                                                        : options_.mapping.keyframe_share;
  return inliers < share * reference_points;
}

void TrackingSession::make_keyframe(FrameResult& result, TrackingLock& lock) {
  {
    const ScopedTimer timer(result.ms.map);
    shared_.log.reference = backend_.insert(current_, shared_.log.size());
  }
  const KeyframeId keyframe = shared_.log.reference;
  result.keyframe = true;
  frames_since_keyframe_ = 0;
  most_inliers_ = 0;
  without_map(lock, [&] { backend_.process(keyframe); });
  const Keyframe* refined = shared_.map.find_keyframe(keyframe);
  if (refined == nullptr) return;
  current_.T_cam_world = refined->T_cam_world;
  if (options_.sensor != Sensor::kRgbd) current_.points = refined->points;  // triangulated ones
}

// Judged from where the last frame is and from where it was said to be: mapping may have moved it
// since. Corrections by a loop are told by the loops of the result.
bool TrackingSession::jumped() const {
  const std::optional<RigidTransform> T_last_world = shared_.log.last_pose(shared_.map);
  if (!T_last_world) return false;
  const double dt = current_.timestamp - last_.timestamp;
  const double doubt = velocity_ ? 1.0 : kUnknownVelocity;
  const double depth =
      median_depth(shared_.map, current_.points, current_.T_cam_world).value_or(0.0);
  const double max_way = kPoseNoise * depth + doubt * kMaxAcceleration * dt * dt;
  const double max_turn = kPoseNoise + doubt * kMaxTurn * dt * dt;
  const RigidTransform expected = se3_exp(velocity_ ? Vector6d(dt * *velocity_) : Vector6d::Zero());
  const auto is_far_from = [&](const RigidTransform& T_before_world) {
    const RigidTransform off = current_.T_cam_world * (expected * T_before_world).inverse();
    return off.t.norm() > max_way || so3_log(off.R).norm() > max_turn;
  };
  const bool loop_told = backend_.closures().size() != told_loops_;
  return is_far_from(*T_last_world) || (told_ && !loop_told && is_far_from(*told_));
}

// What exceeds the acceleration of a camera is an error of the pose and no velocity.
void TrackingSession::update_velocity() {
  const Vector6d before = velocity_.value_or(Vector6d::Zero());
  const double doubt = velocity_ ? 1.0 : kUnknownVelocity;
  velocity_ = std::exchange(corrected_velocity_, std::nullopt);
  if (state_ == TrackingState::kRelocalized) {
    tracker_.forget_motion();
    return;
  }
  const std::optional<RigidTransform> T_last_world = shared_.log.last_pose(shared_.map);
  if (!T_last_world) return;
  const double dt = current_.timestamp - last_.timestamp;
  Vector6d change = se3_log(current_.T_cam_world * T_last_world->inverse()) / dt - before;
  const auto limit = [&](auto part, double most) {
    if (part.norm() > most) part *= most / part.norm();
  };
  limit(change.head<3>(), doubt * kMaxAcceleration * dt);
  limit(change.tail<3>(), doubt * kMaxTurn * dt);
  velocity_ = before + change;
}

// Lets go of the features that move by geometry, given a first pose of the frame.
void TrackingSession::find_movers(FrameResult& result, TrackingLock& lock) {
  if (!options_.geometry || current_.depth.empty()) return;
  const ScopedTimer timer(result.ms.geometry);
  without_map(lock, [this] {
    tracks_.judge(current_);
    movers_.detect(current_, tracks_.verdicts());
    movers_found_ = true;
  });
  result.moving_share = static_cast<float>(movers_.masked_share());
  result.moving_features = 0;  // of a frame that is judged twice the second time counts
  current_.cell_trust = movers_.trust();
  for (std::size_t i = 0; i < current_.points.size(); ++i) {
    const cv::Point2f pixel = current_.features->keypoints[i].pt;
    current_.staticness[i] = movers_.staticness(pixel);
    const bool covered =
        movers_.mask().at<std::uint8_t>(cv::Point(cvRound(pixel.x), cvRound(pixel.y))) != 0;
    if (!covered && tracks_.verdicts()[i].verdict != geometry::Verdict::kDynamic) continue;
    current_.moving[i] = 1;
    current_.rejected[i] = 1;
    current_.points[i] = kNoId;
    ++result.moving_features;
  }
}

// Finds the pose of the current frame; the state says how that went.
bool TrackingSession::locate(FrameResult& result, TrackingLock& lock) {
  if (state_ == TrackingState::kNotInitialized) {
    const bool lost_before = shared_.log.latest_pose(shared_.map).has_value();
    if (!initialize(result, lock)) return false;
    result.inliers = static_cast<int>(shared_.map.point_count());
    state_ = lost_before ? TrackingState::kRelocalized : TrackingState::kTracked;
    return true;
  }
  if (state_ != TrackingState::kLost && follow(lock)) {
    find_movers(result, lock);
    result.inliers = tracker_.track_local_map(shared_.map, shared_.log.reference, current_,
                                              tracker_.wide_step());
    if (result.inliers >= options_.tracking.min_inliers || tracker_.depth_aligned()) {
      result.depth_aligned = tracker_.depth_aligned();
      state_ = TrackingState::kTracked;
      return true;
    }
  }
  if (relocalize()) {
    current_.drop_sought();
    find_movers(result, lock);
    result.inliers = static_cast<int>(std::count_if(current_.points.begin(), current_.points.end(),
                                                    [](PointId id) { return id != kNoId; }));
    state_ = TrackingState::kRelocalized;
    return true;
  }
  if (state_ != TrackingState::kLost) lost_since_ = current_.timestamp;
  state_ = TrackingState::kLost;
  return false;
}

void TrackingSession::step(FrameResult& result) {
  TrackingLock lock(shared_.mutex);
  follow_corrections();
  movers_found_ = false;
  const bool first = state_ == TrackingState::kNotInitialized;
  const bool located = locate(result, lock);
  const bool corrected = located && !first && look_back(result, lock);
  const TrackerTimes times = tracker_.take_times();
  result.state = state_;
  if (located && !first) {
    if (corrected || (state_ == TrackingState::kTracked && jumped())) {
      state_ = TrackingState::kRelocalized;
    }
    shared_.log.reference = tracker_.local_map().reference;
    ++frames_since_keyframe_;
    most_inliers_ = std::max(most_inliers_, result.inliers);
    update_velocity();
    if (state_ == TrackingState::kTracked && wants_keyframe(result.inliers)) {
      make_keyframe(result, lock);
      if (jumped()) state_ = TrackingState::kRelocalized;
    }
    result.state = state_;
  }
  result.ms.match = times.match;
  result.ms.optimize = times.optimize;
  revise_past(result, located);
  current_.drop_sought();
  if (located) result.T_world_cam = current_.T_cam_world.inverse();
  if (located && options_.geometry && !current_.depth.empty()) {
    if (first) find_movers(result, lock);
    tracks_.remember(current_);
    movers_.remember(current_);
  }
  shared_.log.add(shared_.map, current_.timestamp,
                  located ? std::optional(current_.T_cam_world) : std::nullopt);
  result.loops = told_loops_ = backend_.closures().size();
  told_ = located ? std::optional(current_.T_cam_world) : std::nullopt;
  if (state_ == TrackingState::kLost) restart_if_hopeless();
  current_.levels.clear();
  std::swap(last_, current_);
}

MoversView TrackingSession::movers() {
  const cv::Mat& mask = movers_found_ ? movers_.complete(last_, tracks_.verdicts()) : last_.mask;
  return {mask, movers_.judged()};
}

FrameResult TrackingSession::track(const FrameInput& frame) {
  FrameResult result;
  result.timestamp = frame.timestamp;
  {
    const ScopedTimer whole(result.ms.total);
    {
      const ScopedTimer timer(result.ms.extract);
      KnownMovers before;
      const bool just_now = frame.timestamp - last_.timestamp <= kWideStep;
      if (movers_found_ && just_now) before = {movers_.mask(), movers_.masked_share()};
      current_.reset(builder_.build(frame, before), frame.timestamp);
      builder_.copy_depth(frame, current_);
      builder_.view_levels(current_.levels);
      builder_.swap_gray(current_.gray);
      current_.gray_cells = builder_.gray_cells().clone();
    }
    result.index = shared_.log.size();
    result.features = static_cast<int>(current_.features->size());
    result.masked_share = current_.features->masked_share;
    step(result);
  }
  result.background = backend_.take_times();
  return result;
}

}  // namespace dynslam::slam
