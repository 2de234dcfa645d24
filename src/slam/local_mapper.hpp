// Grows the map around a new keyframe and keeps it clean.
#pragma once

#include <cstddef>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/factors/bundle_adjustment.hpp"
#include "dynslam/slam/map.hpp"
#include "dynslam/slam/options.hpp"

#include "tracked_frame.hpp"

namespace dynslam::slam {

class LocalMapper {
 public:
  LocalMapper(const DepthCamera& camera, const SystemOptions& options,
              const std::vector<float>& scale_factors);

  /// Makes a keyframe of a tracked frame: its matches become observations, its features with depth
  /// become points. `frame.points` then holds the new points as well.
  KeyframeId insert(Map& map, TrackedFrame& frame, std::size_t frame_index);

  /// Tidies up around a keyframe: drops bad points, joins points seen twice, adjusts the bundle.
  void refine(Map& map, KeyframeId keyframe);

  /// Keyframes near `keyframe` whose points are seen often enough by others; the caller erases them
  /// after it has let go of them.
  std::vector<KeyframeId> redundant_keyframes(const Map& map, KeyframeId keyframe) const;

 private:
  void drop_bad_points(Map& map);
  void fuse_neighbours(Map& map, KeyframeId keyframe);
  void fuse_into(Map& map, const std::vector<PointId>& points, KeyframeId keyframe);
  void join(Map& map, PointId candidate, const Observation& at);
  void adjust_bundle(Map& map, KeyframeId keyframe);

  DepthCamera camera_;
  SystemOptions options_;
  std::vector<float> scale_factors_;
  std::vector<PointId> young_points_;
  factors::BundleWorkspace workspace_;
};

}  // namespace dynslam::slam
