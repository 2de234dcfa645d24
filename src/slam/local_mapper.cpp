#include "local_mapper.hpp"

#include <algorithm>
#include <functional>
#include <map>
#include <unordered_set>
#include <utility>

#include "local_map.hpp"
#include "map_bundle.hpp"
#include "point_looks.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kTrialKeyframes = 3;     // a young point is on trial for as many keyframes
constexpr std::size_t kTrialObservations = 2;  // and must have been seen by as many of them
constexpr float kBesidePoint = 3.0F;           // pixels of the level
constexpr std::size_t kFuseNeighbours = 10;
constexpr std::size_t kTriangulateNeighbours = 10;
constexpr float kNewWeight = 0.5F;           // belief in a new point where movers are looked for
constexpr std::size_t kCullNeighbours = 20;  // keyframes looked at for being redundant
constexpr std::size_t kFewestPoints = 15;    // that a keyframe must show to be of use
constexpr std::size_t kCrowd = 100;      // keyframes at one place, beyond which more add nothing
constexpr std::size_t kCullInTurn = 10;  // and so many of the rest of the map
constexpr std::size_t kRefreshAtOnce = 256;  // points refreshed in one hold of the map

}  // namespace

LocalMapper::LocalMapper(const DepthCamera& camera, const SystemOptions& options,
                         const std::vector<float>& scale_factors, SharedMap& shared)
    : camera_(camera),
      options_(options),
      scale_factors_(scale_factors),
      shared_(shared),
      fusion_(camera, scale_factors),
      triangulator_(camera, scale_factors) {}

// A corner beside a point that was found by its look shows that point.
bool LocalMapper::is_beside_found(const TrackedFrame& frame, std::size_t corner) const {
  const FrameFeatures& features = *frame.features;
  const cv::KeyPoint& at = features.keypoints[corner];
  const float radius = kBesidePoint * scale_factors_[static_cast<std::size_t>(at.octave)];
  bool beside = false;
  features.grid.visit(at.pt, radius, [&](std::int32_t index) {
    const auto i = static_cast<std::size_t>(index);
    beside |= features.is_sought(i) && frame.points[i] != kNoId &&
              std::abs(features.keypoints[i].octave - at.octave) <= 1;
  });
  return beside;
}

KeyframeId LocalMapper::insert(TrackedFrame& frame, std::size_t frame_index) {
  Map& map = shared_.map;
  Keyframe keyframe;
  keyframe.frame_index = frame_index;
  keyframe.timestamp = frame.timestamp;
  keyframe.T_cam_world = frame.T_cam_world;
  keyframe.features = frame.features;
  if (options_.geometry) keyframe.moving = frame.moving;
  const KeyframeId id = map.add_keyframe(std::move(keyframe));
  const RigidTransform T_world_cam = frame.T_cam_world.inverse();
  const FrameFeatures& features = *frame.features;
  for (std::uint32_t i = 0; i < features.size(); ++i) {
    if (MapPoint* known = map.find_point(frame.points[i])) {
      if (map.add_observation(frame.points[i], {id, i})) {
        map.refresh_point(frame.points[i], scale_factors_);
        if (known->look == nullptr) {
          known->look = point_look(camera_, frame, i, known->position, scale_factors_);
        }
      }
      continue;
    }
    if (!(features.depths[i] > 0.0F) || frame.moving[i] != 0) continue;
    if (features.is_sought(i) || is_beside_found(frame, i)) continue;
    const cv::Point2f pixel = features.keypoints[i].pt;
    MapPoint point;
    point.position = T_world_cam * camera_.unproject({pixel.x, pixel.y}, features.depths[i]);
    point.color = features.colors[i];
    // A point must prove itself: what looks static now may only have paused.
    if (options_.geometry) point.static_weight = std::min(kNewWeight, frame.staticness[i]);
    point.look = point_look(camera_, frame, i, point.position, scale_factors_);
    frame.points[i] = map.add_point(std::move(point));
    frame.rejected[i] = 0;
    map.add_observation(frame.points[i], {id, i});
    map.refresh_point(frame.points[i], scale_factors_);
    young_points_.push_back(frame.points[i]);
  }
  return id;
}

KeyframeId LocalMapper::insert_start(const MonoStart& start, TrackedFrame& second,
                                     std::size_t frame_index) {
  Map& map = shared_.map;
  TrackedFrame first = start.first;
  first.T_cam_world = RigidTransform();
  second.T_cam_world = start.reconstruction.T_second_first;
  const KeyframeId first_id = insert(first, start.first_index);
  const KeyframeId second_id = insert(second, frame_index);
  for (std::size_t i = 0; i < start.matches.size(); ++i) {
    if (start.reconstruction.good[i] == 0) continue;
    const auto a = static_cast<std::uint32_t>(start.matches[i].query);
    const auto b = static_cast<std::uint32_t>(start.matches[i].train);
    MapPoint point;
    point.position = start.reconstruction.points[i];
    point.color = second.features->colors[b];
    second.points[b] = map.add_point(std::move(point));
    map.add_observation(second.points[b], {first_id, a});
    map.add_observation(second.points[b], {second_id, b});
    map.refresh_point(second.points[b], scale_factors_);
  }
  return second_id;
}

void LocalMapper::adopt_map() {
  const Map& map = shared_.map;
  young_points_.clear();
  for (const PointId id : map.point_ids()) {
    const std::size_t age = map.keyframes_made() - map.point(id).born_keyframe;
    if (age <= kTrialKeyframes) young_points_.push_back(id);
  }
}

void LocalMapper::refine(KeyframeId id, bool with_bundle, const std::atomic<bool>& stop) {
  drop_bad_points();
  drop_unproven_points(id);
  if (options_.sensor != Sensor::kRgbd) triangulate(id, stop);
  fuse_neighbours(id, stop);
  if (options_.bundle_adjustment && with_bundle) adjust_bundle(id, stop);
  drop_redundant(id, stop);
}

void LocalMapper::drop_bad_points() {
  const BackgroundLock lock(shared_.mutex);
  Map& map = shared_.map;
  const auto settled = [&](PointId id) {
    const MapPoint* point = map.find_point(id);
    if (point == nullptr) return true;
    const std::size_t age = map.keyframes_made() - point->born_keyframe;
    const bool rarely_seen =
        age >= kTrialKeyframes && point->observations.size() < kTrialObservations;
    if (is_rarely_found(*point) || rarely_seen) {
      map.erase_point(id);
      return true;
    }
    return age > kTrialKeyframes;
  };
  young_points_.erase(std::remove_if(young_points_.begin(), young_points_.end(), settled),
                      young_points_.end());
}

// A point of few observations stays on trial: where the frames that should show it do not any more,
// it was on something that has left, or nothing that can be found again.
void LocalMapper::drop_unproven_points(KeyframeId id) {
  const BackgroundLock lock(shared_.mutex);
  Map& map = shared_.map;
  if (map.find_keyframe(id) == nullptr) return;
  LocalMap around;
  around.collect(map, {}, id, options_.tracking.local_keyframes);
  for (const PointId candidate : around.ids) {
    const MapPoint& point = map.point(candidate);
    if (point.observations.size() <= kTrialObservations && is_rarely_found(point)) {
      map.erase_point(candidate);
    }
  }
}

bool LocalMapper::is_rarely_found(const MapPoint& point) const {
  return point.found < options_.mapping.min_found_share * static_cast<double>(point.visible);
}

void LocalMapper::triangulate(KeyframeId id, const std::atomic<bool>& stop) {
  const std::vector<PointId> made = triangulator_.grow(shared_, id, kTriangulateNeighbours, stop);
  const BackgroundLock lock(shared_.mutex);
  young_points_.insert(young_points_.end(), made.begin(), made.end());
}

void LocalMapper::fuse_neighbours(KeyframeId id, const std::atomic<bool>& stop) {
  const auto points_of = [&](KeyframeId keyframe) {
    const BackgroundLock lock(shared_.mutex);
    const Keyframe* found = shared_.map.find_keyframe(keyframe);
    return found == nullptr ? std::vector<PointId>() : found->points;
  };
  std::vector<KeyframeId> neighbours;
  {
    const BackgroundLock lock(shared_.mutex);
    if (shared_.map.find_keyframe(id) == nullptr) return;
    neighbours = shared_.map.covisible_keyframes(id, kFuseNeighbours, kMinShared);
  }
  for (const KeyframeId neighbour : neighbours) {
    if (stop) return;
    fusion_.fuse(shared_, points_of(id), neighbour);
  }
  std::vector<PointId> theirs;
  std::unordered_set<PointId> seen;
  for (const KeyframeId neighbour : neighbours) {
    for (const PointId point : points_of(neighbour)) {
      if (point != kNoId && seen.insert(point).second) theirs.push_back(point);
    }
  }
  fusion_.fuse(shared_, theirs, id);
}

// Solves on a copy. A map that was corrected as a whole meanwhile has outdated the result.
void LocalMapper::adjust_bundle(KeyframeId id, const std::atomic<bool>& stop) {
  MapBundle bundle;
  std::uint64_t corrections = 0;
  {
    const BackgroundLock lock(shared_.mutex);
    if (shared_.map.find_keyframe(id) == nullptr || shared_.map.keyframe_count() <= 2) return;
    bundle.collect_around(shared_.map, id, options_.mapping.bundle_keyframes, scale_factors_);
    corrections = shared_.corrections;
  }
  if (!bundle.solve(camera_, workspace_, stop)) return;
  {
    const BackgroundLock lock(shared_.mutex);
    if (shared_.corrections != corrections) return;
    bundle.write_back(shared_.map);
  }
  const std::vector<PointId>& points = bundle.points();
  for (std::size_t i = 0; i < points.size();) {
    const BackgroundLock lock(shared_.mutex);
    for (const std::size_t end = std::min(points.size(), i + kRefreshAtOnce); i < end; ++i) {
      if (shared_.map.find_point(points[i]) == nullptr) continue;
      shared_.map.refresh_point(points[i], scale_factors_);
    }
  }
}

// Share of a keyframe's points that three others see at least as finely; 1 if it has lost them.
double LocalMapper::redundancy(const Map& map, KeyframeId candidate) const {
  const Keyframe& keyframe = map.keyframe(candidate);
  std::size_t points = 0, covered = 0;
  for (std::size_t i = 0; i < keyframe.points.size(); ++i) {
    const MapPoint* point = map.find_point(keyframe.points[i]);
    if (point == nullptr) continue;
    ++points;
    const int octave = keyframe.features->keypoints[i].octave;
    const auto as_fine = std::count_if(
        point->observations.begin(), point->observations.end(), [&](const Observation& o) {
          return o.keyframe != candidate &&
                 map.keyframe(o.keyframe).features->keypoints[o.feature].octave <= octave + 1;
        });
    if (as_fine >= 3) ++covered;
  }
  if (points < kFewestPoints) return 1.0;
  return static_cast<double>(covered) / static_cast<double>(points);
}

// The neighbours of a keyframe, and some of the rest of the map in turn: what was joined, adjusted
// or found again elsewhere may have made any keyframe redundant.
std::vector<KeyframeId> LocalMapper::culling_candidates(const Map& map, KeyframeId id) {
  const bool crowded = map.keyframe(id).covisible.size() > kCrowd;
  std::vector<KeyframeId> candidates =
      crowded ? map.covisible_keyframes(id, map.keyframe_count())
              : map.covisible_keyframes(id, kCullNeighbours, kMinShared);
  const std::vector<KeyframeId> all = map.keyframe_ids();
  for (std::size_t i = 0; i < std::min(kCullInTurn, all.size()); ++i) {
    const KeyframeId candidate = all[next_to_cull_++ % all.size()];
    if (std::find(candidates.begin(), candidates.end(), candidate) == candidates.end()) {
      candidates.push_back(candidate);
    }
  }
  const std::size_t newest = map.keyframe(id).number;
  const auto must_stay = [&](KeyframeId candidate) {
    const std::size_t number = map.keyframe(candidate).number;
    return number == 0 || number + 3 > newest;
  };
  candidates.erase(std::remove_if(candidates.begin(), candidates.end(), must_stay),
                   candidates.end());
  return candidates;
}

// Drops what is redundant, and of a crowd around the keyframe those that add least to it.
void LocalMapper::drop_redundant(KeyframeId id, const std::atomic<bool>& stop) {
  if (options_.mapping.redundant_share >= 1.0) return;
  const Map& map = shared_.map;
  std::vector<KeyframeId> candidates;
  std::map<KeyframeId, int> around;
  {
    const BackgroundLock lock(shared_.mutex);
    if (map.find_keyframe(id) == nullptr) return;
    candidates = culling_candidates(map, id);
    around = map.keyframe(id).covisible;
  }
  std::vector<std::pair<double, KeyframeId>> ranked;
  for (const KeyframeId candidate : candidates) {
    if (stop) return;
    const BackgroundLock lock(shared_.mutex);
    if (map.find_keyframe(candidate) == nullptr) continue;
    ranked.emplace_back(redundancy(map, candidate), candidate);
  }
  std::sort(ranked.begin(), ranked.end(), std::greater<>());
  std::size_t crowd = around.size();
  for (const auto& [share, keyframe] : ranked) {
    const bool is_around = around.count(keyframe) != 0;
    if (share <= options_.mapping.redundant_share && !(is_around && crowd > kCrowd)) continue;
    const BackgroundLock lock(shared_.mutex);
    if (map.find_keyframe(keyframe) == nullptr) continue;
    shared_.log.release(map, keyframe, id);
    shared_.map.erase_keyframe(keyframe);
    if (is_around) --crowd;
  }
}

}  // namespace dynslam::slam
