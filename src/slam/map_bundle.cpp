#include "map_bundle.hpp"

#include <algorithm>
#include <map>
#include <unordered_set>
#include <utility>

#include "map_correction.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kMaxHeld = 30;  // keyframes held in place

}  // namespace

void MapBundle::collect_around(const Map& map, KeyframeId keyframe, int count,
                               const std::vector<float>& scale_factors) {
  keyframes_ = map.covisible_keyframes(keyframe, static_cast<std::size_t>(count - 1), kMinShared);
  keyframes_.push_back(keyframe);
  free_count_ = keyframes_.size();
  std::unordered_set<PointId> taken;
  for (const KeyframeId id : keyframes_) {
    index_.emplace(id, static_cast<std::uint32_t>(index_.size()));
    for (const PointId point : map.keyframe(id).points) {
      if (point != kNoId && taken.insert(point).second) points_.push_back(point);
    }
  }
  hold_observers(map);
  add_poses(map);
  add_observations(map, scale_factors);
}

void MapBundle::collect_all(const Map& map, const std::vector<float>& scale_factors) {
  keyframes_ = map.keyframe_ids();
  free_count_ = keyframes_.size();
  for (std::size_t i = 0; i < keyframes_.size(); ++i) {
    index_.emplace(keyframes_[i], static_cast<std::uint32_t>(i));
  }
  for (const PointId id : map.point_ids()) {
    if (map.point(id).observations.size() >= 2) points_.push_back(id);
  }
  add_poses(map);
  add_observations(map, scale_factors);
}

// Keyframes that see the points from outside stay where they are.
void MapBundle::hold_observers(const Map& map) {
  std::map<KeyframeId, int> outside;
  for (const PointId point : points_) {
    for (const Observation& o : map.point(point).observations) {
      if (index_.count(o.keyframe) == 0) ++outside[o.keyframe];
    }
  }
  std::vector<std::pair<int, KeyframeId>> held;
  for (const auto& [keyframe, shared] : outside) held.emplace_back(-shared, keyframe);
  std::sort(held.begin(), held.end());
  if (held.size() > kMaxHeld) held.resize(kMaxHeld);
  for (const auto& entry : held) {
    index_.emplace(entry.second, static_cast<std::uint32_t>(keyframes_.size()));
    keyframes_.push_back(entry.second);
  }
}

// Without any that is held the oldest one is, so that the bundle cannot drift as a whole.
void MapBundle::add_poses(const Map& map) {
  const auto older = [&](KeyframeId a, KeyframeId b) {
    return map.keyframe(a).number < map.keyframe(b).number;
  };
  const KeyframeId oldest = *std::min_element(keyframes_.begin(), keyframes_.end(), older);
  const bool free = free_count_ == keyframes_.size();
  for (std::size_t i = 0; i < keyframes_.size(); ++i) {
    poses_.push_back(map.keyframe(keyframes_[i]).T_cam_world);
    fixed_.push_back(i >= free_count_ || (free && keyframes_[i] == oldest));
  }
  before_ = poses_;
}

void MapBundle::add_observations(const Map& map, const std::vector<float>& scale_factors) {
  for (const PointId id : points_) {
    const MapPoint& point = map.point(id);
    for (const Observation& o : point.observations) {
      const auto found = index_.find(o.keyframe);
      if (found == index_.end()) continue;
      const FrameFeatures& features = *map.keyframe(o.keyframe).features;
      const cv::KeyPoint& keypoint = features.keypoints[o.feature];
      factors::BundleObservation observation;
      observation.keyframe = found->second;
      observation.point = static_cast<std::uint32_t>(positions_.size());
      observation.u = keypoint.pt.x;
      observation.v = keypoint.pt.y;
      observation.right_column = features.right_columns[o.feature];
      observation.inverse_sigma = 1.0F / scale_factors[static_cast<std::size_t>(keypoint.octave)];
      observation.weight = point.static_weight;
      alignment_sigmas_.push_back(features.alignment_sigma(o.feature));
      observations_.push_back(observation);
    }
    positions_.push_back(point.position);
  }
}

// Before anything is moved.
FeatureNoise MapBundle::noise(const DepthCamera& camera) const {
  ResidualNoise residuals;
  for (std::size_t i = 0; i < observations_.size(); ++i) {
    const factors::BundleObservation& o = observations_[i];
    residuals.add(camera, poses_[o.keyframe] * positions_[o.point], {o.u, o.v}, o.right_column,
                  o.inverse_sigma, alignment_sigmas_[i]);
  }
  return residuals.to_weigh_by();
}

bool MapBundle::solve(const DepthCamera& camera, factors::BundleWorkspace& workspace,
                      const std::atomic<bool>& stop) {
  inliers_.assign(observations_.size(), 0);
  const FeatureNoise seen = noise(camera);
  for (std::size_t i = 0; i < observations_.size(); ++i) {  // the unit is the noise of key points
    factors::BundleObservation& o = observations_[i];
    o.inverse_sigma /= static_cast<float>(seen.relative(alignment_sigmas_[i]));
    o.right_inverse_sigma =
        static_cast<float>(seen.pixels * seen.right_inverse_sigma(1.0 / o.inverse_sigma));
  }
  factors::BundleProblem problem;
  problem.camera = camera;
  problem.T_cam_world = poses_;
  problem.keyframe_fixed = fixed_;
  problem.points_world = positions_;
  problem.observations = observations_;
  problem.inliers = inliers_;
  factors::BundleOptions options;
  options.loss.scale *= seen.pixels;  // what is far beyond the noise is an error, not noise
  options.abort = &stop;
  return factors::usable(factors::optimize_bundle(problem, options, &workspace).status);
}

void MapBundle::write_back(Map& map) const {
  for (std::size_t i = 0; i < free_count_; ++i) {
    Keyframe* keyframe = map.find_keyframe(keyframes_[i]);
    if (keyframe != nullptr) keyframe->T_cam_world = poses_[i];
  }
  write_points(map);
}

void MapBundle::write_back_and_carry(SharedMap& shared) const {
  MapCorrection correction;
  for (std::size_t i = 0; i < free_count_; ++i) {
    correction.add(keyframes_[i], before_[i], factors::Similarity(poses_[i]));
  }
  correction.apply(shared);
  write_points(shared.map);
}

void MapBundle::write_points(Map& map) const {
  for (std::size_t i = 0; i < points_.size(); ++i) {
    MapPoint* point = map.find_point(points_[i]);
    if (point != nullptr) point->position = positions_[i];
  }
  for (std::size_t i = 0; i < observations_.size(); ++i) {
    const PointId point = points_[observations_[i].point];
    if (inliers_[i] == 0 && map.find_point(point) != nullptr) {
      map.erase_observation(point, keyframes_[observations_[i].keyframe]);
    }
  }
}

}  // namespace dynslam::slam
