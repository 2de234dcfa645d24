#include "local_map.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <unordered_set>
#include <utility>

namespace dynslam::slam {
namespace {

struct Vote {
  int shared;
  std::size_t number;
  KeyframeId id;
};

// A value for each object of a SlotMap that is alive; their slots differ.
template <typename Value>
class BySlot {
 public:
  Value& operator[](std::uint64_t id) {
    const std::size_t slot = slot_of(id);
    if (slot >= values_.size()) values_.resize(2 * slot + 1);
    return values_[slot];
  }

 private:
  std::vector<Value> values_;
};

// Keyframes that see the frame's points, most first (ties: newer first).
std::vector<Vote> vote(const Map& map, const std::vector<PointId>& points) {
  BySlot<int> counts;
  std::vector<Vote> votes;
  for (const PointId id : points) {
    const MapPoint* point = map.find_point(id);
    if (point == nullptr) continue;
    for (const Observation& observation : point->observations) {
      const KeyframeId keyframe = observation.keyframe;
      if (++counts[keyframe] == 1) votes.push_back({0, map.keyframe(keyframe).number, keyframe});
    }
  }
  for (Vote& entry : votes) entry.shared = counts[entry.id];
  std::sort(votes.begin(), votes.end(), [](const Vote& a, const Vote& b) {
    return a.shared != b.shared ? a.shared > b.shared : a.number > b.number;
  });
  return votes;
}

}  // namespace

void LocalMap::collect(const Map& map, const std::vector<PointId>& points, KeyframeId fallback,
                       int count) {
  const auto wanted = static_cast<std::size_t>(count);
  keyframes.clear();
  for (const Vote& entry : vote(map, points)) {
    if (keyframes.size() < wanted) keyframes.push_back(entry.id);
  }
  if (keyframes.empty() && map.find_keyframe(fallback) != nullptr) keyframes.push_back(fallback);
  reference = keyframes.empty() ? kNoId : keyframes.front();

  std::unordered_set<KeyframeId> taken(keyframes.begin(), keyframes.end());
  const std::size_t direct = keyframes.size();
  for (std::size_t i = 0; i < direct && keyframes.size() < wanted; ++i) {
    for (const KeyframeId neighbour : map.covisible_keyframes(keyframes[i], 5)) {
      if (keyframes.size() < wanted && taken.insert(neighbour).second) {
        keyframes.push_back(neighbour);
      }
    }
  }

  ids.clear();
  positions.clear();
  normals.clear();
  min_distances.clear();
  max_distances.clear();
  weights.clear();
  descriptors.clear();
  BySlot<char> seen;
  for (const KeyframeId keyframe : keyframes) {
    for (const PointId id : map.keyframe(keyframe).points) {
      if (id == kNoId || std::exchange(seen[id], char{1}) != 0) continue;
      const MapPoint& point = map.point(id);
      ids.push_back(id);
      positions.push_back(point.position);
      normals.push_back(point.normal);
      min_distances.push_back(point.min_distance);
      max_distances.push_back(point.max_distance);
      weights.push_back(point.static_weight);
      descriptors.insert(descriptors.end(), point.descriptor.begin(), point.descriptor.end());
    }
  }
}

}  // namespace dynslam::slam
