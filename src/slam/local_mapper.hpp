// Grows the map around a new keyframe and keeps it clean.
#pragma once

#include <atomic>
#include <cstddef>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/factors/bundle_adjustment.hpp"
#include "dynslam/slam/options.hpp"

#include "mono_initializer.hpp"
#include "new_points.hpp"
#include "point_fusion.hpp"
#include "shared_map.hpp"
#include "tracked_frame.hpp"

namespace dynslam::slam {

class LocalMapper {
 public:
  LocalMapper(const DepthCamera& camera, const SystemOptions& options,
              const std::vector<float>& scale_factors, SharedMap& shared);

  /// Makes a keyframe of a tracked frame: its matches become observations, its corners with depth
  /// become points, but for those beside a point that was found by its look. `frame.points` then
  /// holds the new points as well. The caller holds the map.
  KeyframeId insert(TrackedFrame& frame, std::size_t frame_index);

  /// Makes keyframes of the two frames that start a map without depth, and points of their matches;
  /// the world is the first one's camera frame. Pose and points of `second` are filled. Returns its
  /// keyframe. The caller holds the map.
  KeyframeId insert_start(const MonoStart& start, TrackedFrame& second, std::size_t frame_index);

  /// Goes on with the map there is: its youngest points stay on trial. Before the first keyframe.
  void adopt_map();

  /// Tidies up around a keyframe: drops bad points, triangulates new ones where the sensor leaves
  /// depths open, joins points seen twice, adjusts the bundle unless that is left out, drops what
  /// is redundant by then. Holds the map for parts of it only; a raised `stop` ends it early.
  void refine(KeyframeId keyframe, bool with_bundle, const std::atomic<bool>& stop);

 private:
  bool is_beside_found(const TrackedFrame& frame, std::size_t corner) const;
  void drop_bad_points();
  void drop_unproven_points(KeyframeId keyframe);
  bool is_rarely_found(const MapPoint& point) const;
  void triangulate(KeyframeId keyframe, const std::atomic<bool>& stop);
  void fuse_neighbours(KeyframeId keyframe, const std::atomic<bool>& stop);
  void adjust_bundle(KeyframeId keyframe, const std::atomic<bool>& stop);
  void drop_redundant(KeyframeId keyframe, const std::atomic<bool>& stop);
  std::vector<KeyframeId> culling_candidates(const Map& map, KeyframeId keyframe);
  double redundancy(const Map& map, KeyframeId candidate) const;

  DepthCamera camera_;
  SystemOptions options_;
  std::vector<float> scale_factors_;
  SharedMap& shared_;
  PointFusion fusion_;
  PointTriangulator triangulator_;
  std::size_t next_to_cull_ = 0;       // where the look at the rest of the map goes on
  std::vector<PointId> young_points_;  // guarded by the map's lock
  factors::BundleWorkspace workspace_;
};

}  // namespace dynslam::slam
