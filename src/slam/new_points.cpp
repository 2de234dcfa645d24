#include "new_points.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "dynslam/core/so3.hpp"
#include "dynslam/features/hamming.hpp"

#include "median_depth.hpp"

namespace dynslam::slam {
namespace {

constexpr double kMinBaselineShare = 0.01;  // of the median depth: less gives no depth
constexpr int kMaxLineDistance = 50;        // bits
constexpr float kLineRatio = 0.8F;          // of the next best along the line
constexpr float kChi2OffLine = 3.841F;      // 95 % of chi^2, 1 degree of freedom
constexpr double kMinParallaxDeg = 1.5;     // surer than the least that is worth anything
constexpr int kMaxOctaveGap = 1;
constexpr double kEpipoleRadius = 10.0;  // pixels: where a line has no direction

}  // namespace

PointTriangulator::PointTriangulator(const PinholeCamera& camera,
                                     const std::vector<float>& scale_factors)
    : camera_(camera), scale_factors_(scale_factors) {
  tests_.min_parallax_deg = kMinParallaxDeg;
  tests_.max_scale_factor = 1.5 * scale_factors[1];
}

void PointTriangulator::collect(const Keyframe& keyframe, Candidates& candidates) const {
  candidates = {};
  candidates.T_cam_world = keyframe.T_cam_world;
  candidates.shared_features = keyframe.features;
  for (std::uint32_t i = 0; i < keyframe.points.size(); ++i) {
    if (keyframe.points[i] != kNoId) continue;
    if (!keyframe.moving.empty() && keyframe.moving[i] != 0) continue;
    const cv::KeyPoint& keypoint = keyframe.features->keypoints[i];
    candidates.features.push_back(i);
    candidates.u.push_back(keypoint.pt.x);
    candidates.v.push_back(keypoint.pt.y);
    candidates.scales.push_back(scale_factors_[static_cast<std::size_t>(keypoint.octave)]);
    candidates.octaves.push_back(keypoint.octave);
  }
}

bool PointTriangulator::is_far_enough(const Map& map, const Keyframe& keyframe,
                                      const Keyframe& neighbour) const {
  const std::optional<double> depth = median_depth(map, neighbour.points, neighbour.T_cam_world);
  const double baseline =
      (keyframe.T_cam_world.inverse().t - neighbour.T_cam_world.inverse().t).norm();
  return depth && baseline > kMinBaselineShare * *depth;
}

// Nearest descriptor among the features near each epipolar line.
void PointTriangulator::match_lines() {
  const RigidTransform T_there_here = there_.T_cam_world * here_.T_cam_world.inverse();
  Eigen::Matrix3d K_inverse;
  K_inverse << 1.0 / camera_.fx, 0.0, -camera_.cx / camera_.fx, 0.0, 1.0 / camera_.fy,
      -camera_.cy / camera_.fy, 0.0, 0.0, 1.0;
  const Eigen::Matrix3d F =
      K_inverse.transpose() * skew(T_there_here.t) * T_there_here.R * K_inverse;
  const bool has_epipole = PinholeCamera::in_domain(T_there_here.t);
  const Eigen::Vector2d epipole =
      has_epipole ? camera_.project(T_there_here.t) : Eigen::Vector2d::Zero();
  std::vector<int> best_of(there_.features.size(), kMaxLineDistance + 1);
  std::vector<std::int32_t> owner(there_.features.size(), -1);
  for (std::size_t i = 0; i < here_.features.size(); ++i) {
    Eigen::Vector3d line = F * Eigen::Vector3d(here_.u[i], here_.v[i], 1.0);
    const double norm = line.head<2>().norm();
    if (!(norm > 0.0)) continue;
    line /= norm;
    const auto a = static_cast<float>(line[0]), b = static_cast<float>(line[1]),
               c = static_cast<float>(line[2]);
    const std::uint8_t* descriptor = here_.shared_features->descriptor(here_.features[i]);
    int best = kMaxLineDistance + 1, second = 257;
    std::size_t found = 0;
    for (std::size_t j = 0; j < there_.features.size(); ++j) {
      const float off = a * there_.u[j] + b * there_.v[j] + c;
      if (off * off > kChi2OffLine * there_.scales[j] * there_.scales[j]) continue;
      if (std::abs(there_.octaves[j] - here_.octaves[i]) > kMaxOctaveGap) continue;
      if (has_epipole && (Eigen::Vector2d(there_.u[j], there_.v[j]) - epipole).norm() <
                             kEpipoleRadius * there_.scales[j]) {
        continue;
      }
      const int distance = features::hamming_distance(
          descriptor, there_.shared_features->descriptor(there_.features[j]), 32);
      if (distance < best) {
        second = best;
        best = distance;
        found = j;
      } else {
        second = std::min(second, distance);
      }
    }
    if (best > kMaxLineDistance ||
        static_cast<float>(best) > kLineRatio * static_cast<float>(second)) {
      continue;
    }
    if (best >= best_of[found]) continue;
    best_of[found] = best;
    owner[found] = static_cast<std::int32_t>(i);
  }
  matches_.clear();
  for (std::size_t j = 0; j < owner.size(); ++j) {
    if (owner[j] >= 0) matches_.push_back({owner[j], static_cast<std::int32_t>(j), 0.0F});
  }
}

PointSighting PointTriangulator::sighting(const Candidates& candidates, std::int32_t index) const {
  const auto i = static_cast<std::size_t>(index);
  return {candidates.T_cam_world, {candidates.u[i], candidates.v[i]}, candidates.scales[i]};
}

bool PointTriangulator::copy_pair(SharedMap& shared, KeyframeId id, KeyframeId other) {
  const BackgroundLock lock(shared.mutex);
  const Keyframe* keyframe = shared.map.find_keyframe(id);
  const Keyframe* neighbour = shared.map.find_keyframe(other);
  if (keyframe == nullptr || neighbour == nullptr) return false;
  if (!is_far_enough(shared.map, *keyframe, *neighbour)) return false;
  collect(*keyframe, here_);
  collect(*neighbour, there_);
  corrections_ = shared.corrections;
  return true;
}

std::vector<PointId> PointTriangulator::grow(SharedMap& shared, KeyframeId id,
                                             std::size_t neighbours,
                                             const std::atomic<bool>& stop) {
  std::vector<PointId> made;
  std::vector<KeyframeId> others;
  {
    const BackgroundLock lock(shared.mutex);
    if (shared.map.find_keyframe(id) == nullptr) return made;
    others = shared.map.covisible_keyframes(id, neighbours);
  }
  for (const KeyframeId other : others) {
    if (stop) return made;
    if (!copy_pair(shared, id, other)) continue;
    match_lines();
    std::vector<TriangulatedPoint> points;
    for (const Match& match : matches_) {
      points.push_back(triangulate(camera_, sighting(here_, match.query),
                                   sighting(there_, match.train), tests_));
    }
    add_points(shared, id, other, points, made);
  }
  return made;
}

// What happened to the map since it was copied is looked at again.
void PointTriangulator::add_points(SharedMap& shared, KeyframeId id, KeyframeId other,
                                   const std::vector<TriangulatedPoint>& points,
                                   std::vector<PointId>& made) const {
  const BackgroundLock lock(shared.mutex);
  Map& map = shared.map;
  const Keyframe* keyframe = map.find_keyframe(id);
  const Keyframe* neighbour = map.find_keyframe(other);
  const bool outdated = shared.corrections != corrections_;
  if (outdated || keyframe == nullptr || neighbour == nullptr) return;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const std::uint32_t feature = here_.features[static_cast<std::size_t>(matches_[i].query)];
    const std::uint32_t theirs = there_.features[static_cast<std::size_t>(matches_[i].train)];
    if (!points[i].ok() || keyframe->points[feature] != kNoId ||
        neighbour->points[theirs] != kNoId) {
      continue;
    }
    MapPoint point;
    point.position = points[i].position;
    point.color = keyframe->features->colors[feature];
    const PointId added = map.add_point(std::move(point));
    map.add_observation(added, {other, theirs});
    map.add_observation(added, {id, feature});
    map.refresh_point(added, scale_factors_);
    made.push_back(added);
  }
}

}  // namespace dynslam::slam
