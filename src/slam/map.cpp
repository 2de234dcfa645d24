#include "dynslam/slam/map.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "dynslam/features/hamming.hpp"

namespace dynslam::slam {
namespace {

auto observation_of(std::vector<Observation>& observations, KeyframeId keyframe) {
  return std::find_if(observations.begin(), observations.end(),
                      [&](const Observation& o) { return o.keyframe == keyframe; });
}

}  // namespace

KeyframeId Map::add_keyframe(Keyframe keyframe) {
  keyframe.number = keyframes_made_;
  return restore_keyframe(std::move(keyframe));
}

KeyframeId Map::restore_keyframe(Keyframe keyframe) {
  keyframe.points.assign(keyframe.features->size(), kNoId);
  keyframe.covisible.clear();
  keyframes_made_ = keyframe.number + 1;
  return keyframes_.emplace(std::move(keyframe));
}

PointId Map::add_point(MapPoint point) {
  point.born_keyframe = keyframes_made_;
  return restore_point(std::move(point));
}

PointId Map::restore_point(MapPoint point) {
  point.observations.clear();
  return points_.emplace(std::move(point));
}

void Map::count_covisibility(const MapPoint& point, KeyframeId id, int change) {
  Keyframe& keyframe = keyframes_.at(id);
  for (const Observation& other : point.observations) {
    if (other.keyframe == id) continue;
    Keyframe& neighbour = keyframes_.at(other.keyframe);
    const int shared = keyframe.covisible[other.keyframe] += change;
    neighbour.covisible[id] = shared;
    if (shared <= 0) {
      keyframe.covisible.erase(other.keyframe);
      neighbour.covisible.erase(id);
    }
  }
}

bool Map::add_observation(PointId id, Observation observation) {
  MapPoint& point = points_.at(id);
  Keyframe& keyframe = keyframes_.at(observation.keyframe);
  if (keyframe.points[observation.feature] != kNoId) return false;
  if (observation_of(point.observations, observation.keyframe) != point.observations.end()) {
    return false;
  }
  count_covisibility(point, observation.keyframe, +1);
  point.observations.push_back(observation);
  keyframe.points[observation.feature] = id;
  return true;
}

void Map::erase_observation(PointId id, KeyframeId keyframe) {
  MapPoint& point = points_.at(id);
  const auto found = observation_of(point.observations, keyframe);
  if (found == point.observations.end()) return;
  count_covisibility(point, keyframe, -1);
  keyframes_.at(keyframe).points[found->feature] = kNoId;
  point.observations.erase(found);
  if (point.observations.empty()) points_.erase(id);
}

void Map::erase_point(PointId id) {
  while (points_.contains(id) && !points_.at(id).observations.empty()) {
    erase_observation(id, points_.at(id).observations.back().keyframe);
  }
  points_.erase(id);
}

void Map::erase_keyframe(KeyframeId id) {
  const std::vector<PointId> points = keyframes_.at(id).points;
  for (const PointId point : points) {
    if (point != kNoId) erase_observation(point, id);
  }
  keyframes_.erase(id);
}

void Map::merge_points(PointId from, PointId into) {
  if (from == into) return;
  const MapPoint old = points_.at(from);
  erase_point(from);
  for (const Observation& observation : old.observations) add_observation(into, observation);
  MapPoint& point = points_.at(into);
  point.visible += old.visible;
  point.found += old.found;
}

std::vector<KeyframeId> Map::keyframe_ids() const {
  std::vector<std::pair<std::size_t, KeyframeId>> numbered;
  keyframes_.for_each(
      [&](KeyframeId id, const Keyframe& keyframe) { numbered.emplace_back(keyframe.number, id); });
  std::sort(numbered.begin(), numbered.end());
  std::vector<KeyframeId> ids;
  for (const auto& entry : numbered) ids.push_back(entry.second);
  return ids;
}

std::vector<PointId> Map::point_ids() const {
  std::vector<PointId> ids;
  points_.for_each([&](PointId id, const MapPoint&) { ids.push_back(id); });
  return ids;
}

std::vector<KeyframeId> Map::covisible_keyframes(KeyframeId id, std::size_t count,
                                                 int min_shared) const {
  struct Neighbour {
    int shared;
    std::size_t number;
    KeyframeId id;
  };
  std::vector<Neighbour> neighbours;
  for (const auto& [other, shared] : keyframes_.at(id).covisible) {
    if (shared >= min_shared) neighbours.push_back({shared, keyframes_.at(other).number, other});
  }
  std::sort(neighbours.begin(), neighbours.end(), [](const Neighbour& a, const Neighbour& b) {
    return a.shared != b.shared ? a.shared > b.shared : a.number < b.number;
  });
  if (neighbours.size() > count) neighbours.resize(count);
  std::vector<KeyframeId> ids;
  for (const Neighbour& neighbour : neighbours) ids.push_back(neighbour.id);
  return ids;
}

void Map::refresh_point(PointId id, Span<const float> scale_factors) {
  MapPoint& point = points_.at(id);
  if (point.observations.empty()) return;
  const std::size_t n = point.observations.size();
  std::vector<const std::uint8_t*> descriptors(n);
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < n; ++i) {
    const Observation& observation = point.observations[i];
    const Keyframe& keyframe = keyframes_.at(observation.keyframe);
    descriptors[i] = keyframe.features->descriptor(observation.feature);
    direction += (point.position - keyframe.T_cam_world.inverse().t).normalized();
  }
  point.normal = direction.normalized().cast<float>();

  // The distance range follows the first observation: the level that saw the point there says how
  // far it may go before the coarsest or the finest level would see it.
  const Observation& first = point.observations.front();
  const Keyframe& keyframe = keyframes_.at(first.keyframe);
  const auto octave = static_cast<std::size_t>(keyframe.features->keypoints[first.feature].octave);
  const double distance = (keyframe.T_cam_world * point.position).norm();
  point.max_distance = static_cast<float>(distance) * scale_factors[octave];
  point.min_distance = point.max_distance / scale_factors[scale_factors.size() - 1];

  // The descriptor with the least median distance to the others stands for all.
  std::size_t best = 0;
  int best_median = 257;
  std::vector<int> distances(n);
  for (std::size_t i = 0; i < n && n > 2; ++i) {
    for (std::size_t j = 0; j < n; ++j) {
      distances[j] = features::hamming_distance(descriptors[i], descriptors[j], 32);
    }
    const auto middle = distances.begin() + static_cast<std::ptrdiff_t>((n - 1) / 2);
    std::nth_element(distances.begin(), middle, distances.end());
    if (*middle < best_median) {
      best_median = *middle;
      best = i;
    }
  }
  std::copy_n(descriptors[best], point.descriptor.size(), point.descriptor.begin());
}

void Map::clear() {
  for (const KeyframeId id : keyframe_ids()) keyframes_.erase(id);
  for (const PointId id : point_ids()) points_.erase(id);
  keyframes_made_ = 0;
}

}  // namespace dynslam::slam
