#include "point_fusion.hpp"

#include <algorithm>

#include "dynslam/core/points.hpp"
#include "dynslam/features/matcher.hpp"

#include "visibility.hpp"

namespace dynslam::slam {
namespace {

bool is_seen_by(const MapPoint& point, KeyframeId keyframe) {
  return std::any_of(point.observations.begin(), point.observations.end(),
                     [&](const Observation& o) { return o.keyframe == keyframe; });
}

}  // namespace

int PointFusion::fuse(SharedMap& shared, Span<const PointId> points, KeyframeId keyframe,
                      const FusionOptions& options) {
  FrameFeaturesPtr frame;
  {
    const BackgroundLock lock(shared.mutex);
    frame = gather(shared.map, points, keyframe, options);
  }
  if (frame == nullptr || candidates_.empty()) return 0;
  const features::WindowPredictions windows{
      pixels_, radii_, min_octaves_, max_octaves_,
      DescriptorsView(descriptors_.data(), 32, static_cast<int>(candidates_.size()))};
  features::WindowFeatures features;
  features.grid = &frame->grid;
  features.octaves = field(frame->keypoints, &cv::KeyPoint::octave);
  features.descriptors = frame->descriptors_view();
  features::WindowOptions window_options;
  window_options.max_distance = options.max_distance;
  features::match_windowed(windows, features, window_options, matches_);

  const BackgroundLock lock(shared.mutex);
  if (shared.map.find_keyframe(keyframe) == nullptr) return 0;
  int joined = 0;
  for (const Match& match : matches_) {
    const PointId candidate = candidates_[static_cast<std::size_t>(match.query)];
    const Observation at{keyframe, static_cast<std::uint32_t>(match.train)};
    if (join(shared.map, candidate, at, options)) ++joined;
  }
  return joined;
}

// Copies what matching needs; null if the keyframe is gone.
FrameFeaturesPtr PointFusion::gather(const Map& map, Span<const PointId> points, KeyframeId id,
                                     const FusionOptions& options) {
  candidates_.clear();
  pixels_.clear();
  radii_.clear();
  min_octaves_.clear();
  max_octaves_.clear();
  descriptors_.clear();
  const Keyframe* keyframe = map.find_keyframe(id);
  if (keyframe == nullptr) return nullptr;
  const Visibility visible(camera_, scale_factors_, keyframe->T_cam_world);
  for (const PointId candidate : points) {
    const MapPoint* point = map.find_point(candidate);
    if (point == nullptr || is_seen_by(*point, id)) continue;
    const auto sighting =
        visible(point->position, point->normal, point->min_distance, point->max_distance);
    if (!sighting) continue;
    candidates_.push_back(candidate);
    pixels_.emplace_back(static_cast<float>(sighting->pixel.x()),
                         static_cast<float>(sighting->pixel.y()));
    radii_.push_back(static_cast<float>(
        options.radius * scale_factors_[static_cast<std::size_t>(sighting->octave)]));
    min_octaves_.push_back(sighting->octave - 1);
    max_octaves_.push_back(sighting->octave);
    descriptors_.insert(descriptors_.end(), point->descriptor.begin(), point->descriptor.end());
  }
  return keyframe->features;
}

bool PointFusion::join(Map& map, PointId candidate, const Observation& at,
                       const FusionOptions& options) const {
  if (map.find_point(candidate) == nullptr) return false;
  const Keyframe& keyframe = map.keyframe(at.keyframe);
  const PointId there = keyframe.points[at.feature];
  if (there == candidate) return false;
  if (there == kNoId) {
    const bool added = map.add_observation(candidate, at);
    map.refresh_point(candidate, scale_factors_);
    return added;
  }
  // Points far apart along the ray look alike from here; only near ones are the same.
  const Eigen::Vector3d& position = map.point(there).position;
  const double gap = (position - map.point(candidate).position).norm();
  if (gap > options.max_gap * (keyframe.T_cam_world * position).z()) return false;
  const bool keep_there =
      map.point(there).observations.size() >= map.point(candidate).observations.size();
  const PointId kept = keep_there ? there : candidate;
  map.merge_points(keep_there ? candidate : there, kept);
  map.refresh_point(kept, scale_factors_);
  return true;
}

}  // namespace dynslam::slam
