#include "local_mapper.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>
#include <unordered_set>

#include "dynslam/core/points.hpp"
#include "dynslam/features/matcher.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kTrialKeyframes = 3;     // a young point is on trial for as many keyframes
constexpr std::size_t kTrialObservations = 2;  // and must have been seen by as many of them
constexpr std::size_t kFuseNeighbours = 10;
constexpr int kFuseDistance = 50;      // bits
constexpr double kFuseRadius = 3.0;    // pixels at the finest level
constexpr int kMinShared = 15;         // points that make two keyframes neighbours
constexpr std::size_t kMaxFixed = 30;  // keyframes held in the bundle adjustment

}  // namespace

LocalMapper::LocalMapper(const DepthCamera& camera, const SystemOptions& options,
                         const std::vector<float>& scale_factors)
    : camera_(camera), options_(options), scale_factors_(scale_factors) {}

int LocalMapper::predicted_octave(float max_distance, double distance) const {
  const double level =
      std::log(max_distance / distance) / std::log(static_cast<double>(scale_factors_[1]));
  return std::clamp(static_cast<int>(std::ceil(level)), 0,
                    static_cast<int>(scale_factors_.size()) - 1);
}

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
    if (!(features.depths[i] > 0.0F)) continue;
    const cv::Point2f pixel = features.keypoints[i].pt;
    MapPoint point;
    point.position = T_world_cam * camera_.unproject({pixel.x, pixel.y}, features.depths[i]);
    point.color = features.colors[i];
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
  const Eigen::Vector3d centre = keyframe.T_cam_world.inverse().t;
  std::vector<PointId> candidates;
  std::vector<cv::Point2f> pixels;
  std::vector<float> radii;
  std::vector<int> min_octaves, max_octaves;
  std::vector<std::uint8_t> descriptors;
  for (const PointId point_id : points) {
    const MapPoint* point = map.find_point(point_id);
    if (point == nullptr) continue;
    const bool seen = std::any_of(point->observations.begin(), point->observations.end(),
                                  [&](const Observation& o) { return o.keyframe == id; });
    if (seen) continue;
    const auto pixel = camera_.project_into_image(keyframe.T_cam_world * point->position);
    const Eigen::Vector3d ray = point->position - centre;
    const double distance = ray.norm();
    if (!pixel || distance < 0.8 * point->min_distance || distance > 1.2 * point->max_distance ||
        ray.dot(point->normal.cast<double>()) < 0.5 * distance) {
      continue;
    }
    const int octave = predicted_octave(point->max_distance, distance);
    candidates.push_back(point_id);
    pixels.emplace_back(static_cast<float>(pixel->x()), static_cast<float>(pixel->y()));
    radii.push_back(
        static_cast<float>(kFuseRadius * scale_factors_[static_cast<std::size_t>(octave)]));
    min_octaves.push_back(octave - 1);
    max_octaves.push_back(octave);
    descriptors.insert(descriptors.end(), point->descriptor.begin(), point->descriptor.end());
  }
  features::WindowPredictions windows{
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
    const auto feature = static_cast<std::uint32_t>(match.train);
    const PointId candidate = candidates[static_cast<std::size_t>(match.query)];
    if (!map.find_point(candidate)) continue;
    const PointId there = map.keyframe(id).points[feature];
    if (there == kNoId) {
      map.add_observation(candidate, {id, feature});
      map.refresh_point(candidate, scale_factors_);
    } else if (there != candidate) {
      const bool keep_there =
          map.point(there).observations.size() >= map.point(candidate).observations.size();
      const PointId kept = keep_there ? there : candidate;
      // Points metres apart along the ray look alike from here; only near ones are the same.
      const double gap = (map.point(there).position - map.point(candidate).position).norm();
      const double depth = (map.keyframe(id).T_cam_world * map.point(kept).position).z();
      if (gap > 0.05 * depth) continue;
      map.merge_points(keep_there ? candidate : there, kept);
      map.refresh_point(kept, scale_factors_);
    }
  }
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
  std::vector<KeyframeId> keyframes = map.covisible_keyframes(
      id, static_cast<std::size_t>(options_.mapping.bundle_keyframes - 1), kMinShared);
  keyframes.push_back(id);
  std::unordered_map<KeyframeId, std::uint32_t> index;
  for (const KeyframeId keyframe : keyframes) {
    index.emplace(keyframe, static_cast<std::uint32_t>(index.size()));
  }
  const std::size_t free_count = keyframes.size();

  std::vector<PointId> points;
  std::unordered_set<PointId> taken;
  std::map<KeyframeId, int> outside;
  for (const KeyframeId keyframe : std::vector<KeyframeId>(keyframes)) {
    for (const PointId point : map.keyframe(keyframe).points) {
      if (point == kNoId || !taken.insert(point).second) continue;
      points.push_back(point);
      for (const Observation& o : map.point(point).observations) {
        if (index.count(o.keyframe) == 0) ++outside[o.keyframe];
      }
    }
  }
  std::vector<std::pair<int, KeyframeId>> held;
  for (const auto& [keyframe, shared] : outside) held.emplace_back(-shared, keyframe);
  std::sort(held.begin(), held.end());
  if (held.size() > kMaxFixed) held.resize(kMaxFixed);
  for (const auto& entry : held) {
    index.emplace(entry.second, static_cast<std::uint32_t>(keyframes.size()));
    keyframes.push_back(entry.second);
  }

  std::vector<RigidTransform> poses;
  std::vector<std::uint8_t> fixed;
  std::size_t oldest = 0;
  for (std::size_t i = 0; i < keyframes.size(); ++i) {
    poses.push_back(map.keyframe(keyframes[i]).T_cam_world);
    fixed.push_back(i >= free_count);
    if (map.keyframe(keyframes[i]).number < map.keyframe(keyframes[oldest]).number) oldest = i;
  }
  if (held.empty()) fixed[oldest] = 1;

  std::vector<Eigen::Vector3d> positions;
  std::vector<factors::BundleObservation> observations;
  for (const PointId id_of_point : points) {
    const MapPoint& point = map.point(id_of_point);
    for (const Observation& o : point.observations) {
      const auto found = index.find(o.keyframe);
      if (found == index.end()) continue;
      const FrameFeatures& features = *map.keyframe(o.keyframe).features;
      const cv::KeyPoint& keypoint = features.keypoints[o.feature];
      factors::BundleObservation observation;
      observation.keyframe = found->second;
      observation.point = static_cast<std::uint32_t>(positions.size());
      observation.u = keypoint.pt.x;
      observation.v = keypoint.pt.y;
      observation.right_column = features.right_columns[o.feature];
      observation.inverse_sigma = 1.0F / scale_factors_[static_cast<std::size_t>(keypoint.octave)];
      observation.weight = point.static_weight;
      observations.push_back(observation);
    }
    positions.push_back(point.position);
  }

  std::vector<std::uint8_t> inliers(observations.size());
  factors::BundleProblem problem;
  problem.camera = camera_;
  problem.T_cam_world = poses;
  problem.keyframe_fixed = fixed;
  problem.points_world = positions;
  problem.observations = observations;
  problem.inliers = inliers;
  factors::BundleOptions options;
  const factors::BundleSummary summary = factors::optimize_bundle(problem, options, &workspace_);
  if (!factors::usable(summary.status)) return;

  for (std::size_t i = 0; i < free_count; ++i) map.keyframe(keyframes[i]).T_cam_world = poses[i];
  for (std::size_t i = 0; i < points.size(); ++i) map.point(points[i]).position = positions[i];
  for (std::size_t i = 0; i < observations.size(); ++i) {
    const PointId point = points[observations[i].point];
    if (inliers[i] == 0 && map.find_point(point)) {
      map.erase_observation(point, keyframes[observations[i].keyframe]);
    }
  }
  for (const PointId point : points) {
    if (map.find_point(point)) map.refresh_point(point, scale_factors_);
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
