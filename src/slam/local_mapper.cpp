#include "local_mapper.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_set>

#include "dynslam/core/points.hpp"
#include "dynslam/features/matcher.hpp"

#include "local_bundle.hpp"
#include "visibility.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kTrialKeyframes = 3;     // a young point is on trial for as many keyframes
constexpr std::size_t kTrialObservations = 2;  // and must have been seen by as many of them
constexpr std::size_t kFuseNeighbours = 10;
constexpr int kFuseDistance = 50;    // bits
constexpr double kFuseRadius = 3.0;  // pixels at the finest level
constexpr double kFuseGap = 0.05;    // share of depth between points that may be one
constexpr int kMinShared = 15;       // points that make two keyframes neighbours
constexpr float kNewWeight = 0.5F;   // belief in a new point where movers are looked for

bool is_seen_by(const MapPoint& point, KeyframeId keyframe) {
  return std::any_of(point.observations.begin(), point.observations.end(),
                     [&](const Observation& o) { return o.keyframe == keyframe; });
}

}  // namespace

LocalMapper::LocalMapper(const DepthCamera& camera, const SystemOptions& options,
                         const std::vector<float>& scale_factors)
    : camera_(camera), options_(options), scale_factors_(scale_factors) {}

KeyframeId LocalMapper::insert(Map& map, TrackedFrame& frame, std::size_t frame_index) {
  Keyframe keyframe;
  keyframe.frame_index = frame_index;
  keyframe.timestamp = frame.timestamp;
  keyframe.T_cam_world = frame.T_cam_world;
  keyframe.features = frame.features;
  const KeyframeId id = map.add_keyframe(std::move(keyframe));
  const RigidTransform T_world_cam = frame.T_cam_world.inverse();
  const FrameFeatures& features = *frame.features;
  for (std::uint32_t i = 0; i < features.size(); ++i) {
    if (map.find_point(frame.points[i]) != nullptr) {
      if (map.add_observation(frame.points[i], {id, i})) {
        map.refresh_point(frame.points[i], scale_factors_);
      }
      continue;
    }
    if (!(features.depths[i] > 0.0F) || frame.moving[i] != 0) continue;
    const cv::Point2f pixel = features.keypoints[i].pt;
    MapPoint point;
    point.position = T_world_cam * camera_.unproject({pixel.x, pixel.y}, features.depths[i]);
    point.color = features.colors[i];
    // A point must prove itself: what looks static now may only have paused.
    if (options_.geometry) point.static_weight = std::min(kNewWeight, frame.staticness[i]);
    frame.points[i] = map.add_point(std::move(point));
    frame.rejected[i] = 0;
    map.add_observation(frame.points[i], {id, i});
    map.refresh_point(frame.points[i], scale_factors_);
    young_points_.push_back(frame.points[i]);
  }
  return id;
}

void LocalMapper::refine(Map& map, KeyframeId keyframe) {
  drop_bad_points(map);
  fuse_neighbours(map, keyframe);
  if (options_.bundle_adjustment && map.keyframe_count() > 2) adjust_bundle(map, keyframe);
}

void LocalMapper::drop_bad_points(Map& map) {
  const auto settled = [&](PointId id) {
    const MapPoint* point = map.find_point(id);
    if (point == nullptr) return true;
    const std::size_t age = map.keyframes_made() - point->born_keyframe;
    const bool rarely_found =
        point->found < options_.mapping.min_found_share * static_cast<double>(point->visible);
    const bool rarely_seen =
        age >= kTrialKeyframes && point->observations.size() < kTrialObservations;
    if (rarely_found || rarely_seen) {
      map.erase_point(id);
      return true;
    }
    return age > kTrialKeyframes;
  };
  young_points_.erase(std::remove_if(young_points_.begin(), young_points_.end(), settled),
                      young_points_.end());
}

void LocalMapper::fuse_into(Map& map, const std::vector<PointId>& points, KeyframeId id) {
  const Keyframe& keyframe = map.keyframe(id);
  const Visibility visible(camera_, scale_factors_, keyframe.T_cam_world);
  std::vector<PointId> candidates;
  std::vector<cv::Point2f> pixels;
  std::vector<float> radii;
  std::vector<int> min_octaves, max_octaves;
  std::vector<std::uint8_t> descriptors;
  for (const PointId candidate : points) {
    const MapPoint* point = map.find_point(candidate);
    if (point == nullptr || is_seen_by(*point, id)) continue;
    const auto sighting =
        visible(point->position, point->normal, point->min_distance, point->max_distance);
    if (!sighting) continue;
    candidates.push_back(candidate);
    pixels.emplace_back(static_cast<float>(sighting->pixel.x()),
                        static_cast<float>(sighting->pixel.y()));
    radii.push_back(static_cast<float>(kFuseRadius *
                                       scale_factors_[static_cast<std::size_t>(sighting->octave)]));
    min_octaves.push_back(sighting->octave - 1);
    max_octaves.push_back(sighting->octave);
    descriptors.insert(descriptors.end(), point->descriptor.begin(), point->descriptor.end());
  }
  const features::WindowPredictions windows{
      pixels, radii, min_octaves, max_octaves,
      DescriptorsView(descriptors.data(), 32, static_cast<int>(candidates.size()))};
  features::WindowFeatures features;
  features.grid = &keyframe.features->grid;
  features.octaves = field(keyframe.features->keypoints, &cv::KeyPoint::octave);
  features.descriptors = keyframe.features->descriptors_view();
  features::WindowOptions options;
  options.max_distance = kFuseDistance;
  std::vector<Match> matches;
  features::match_windowed(windows, features, options, matches);
  for (const Match& match : matches) {
    join(map, candidates[static_cast<std::size_t>(match.query)],
         {id, static_cast<std::uint32_t>(match.train)});
  }
}

// A point was found at a feature: it gets the observation, or is the same as the point there.
void LocalMapper::join(Map& map, PointId candidate, const Observation& at) {
  if (map.find_point(candidate) == nullptr) return;
  const Keyframe& keyframe = map.keyframe(at.keyframe);
  const PointId there = keyframe.points[at.feature];
  if (there == kNoId) {
    map.add_observation(candidate, at);
    map.refresh_point(candidate, scale_factors_);
    return;
  }
  // Points far apart along the ray look alike from here; only near ones are the same.
  const Eigen::Vector3d& position = map.point(there).position;
  const double gap = (position - map.point(candidate).position).norm();
  if (gap > kFuseGap * (keyframe.T_cam_world * position).z()) return;
  const bool keep_there =
      map.point(there).observations.size() >= map.point(candidate).observations.size();
  const PointId kept = keep_there ? there : candidate;
  map.merge_points(keep_there ? candidate : there, kept);
  map.refresh_point(kept, scale_factors_);
}

void LocalMapper::fuse_neighbours(Map& map, KeyframeId id) {
  const std::vector<KeyframeId> neighbours =
      map.covisible_keyframes(id, kFuseNeighbours, kMinShared);
  for (const KeyframeId neighbour : neighbours) {
    fuse_into(map, std::vector<PointId>(map.keyframe(id).points), neighbour);
  }
  std::vector<PointId> theirs;
  std::unordered_set<PointId> seen;
  for (const KeyframeId neighbour : neighbours) {
    for (const PointId point : map.keyframe(neighbour).points) {
      if (point != kNoId && seen.insert(point).second) theirs.push_back(point);
    }
  }
  fuse_into(map, theirs, id);
}

void LocalMapper::adjust_bundle(Map& map, KeyframeId id) {
  LocalBundle bundle(map, id, options_.mapping.bundle_keyframes, scale_factors_);
  bundle.solve(camera_, workspace_, map);
  for (const PointId point : bundle.points()) {
    if (map.find_point(point) != nullptr) map.refresh_point(point, scale_factors_);
  }
}

std::vector<KeyframeId> LocalMapper::redundant_keyframes(const Map& map, KeyframeId id) const {
  std::vector<KeyframeId> redundant;
  if (options_.mapping.redundant_share >= 1.0) return redundant;
  for (const KeyframeId candidate : map.covisible_keyframes(id, 20, kMinShared)) {
    const Keyframe& keyframe = map.keyframe(candidate);
    if (keyframe.number == 0 || keyframe.number + 3 > map.keyframe(id).number) continue;
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
    if (static_cast<double>(covered) >
        options_.mapping.redundant_share * static_cast<double>(points)) {
      redundant.push_back(candidate);
    }
  }
  return redundant;
}

}  // namespace dynslam::slam
