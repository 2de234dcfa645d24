// New map points from features that two keyframes show and nobody knows the depth of.
#pragma once

#include <atomic>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/match.hpp"
#include "dynslam/slam/map.hpp"
#include "dynslam/slam/triangulation.hpp"

#include "shared_map.hpp"

namespace dynslam::slam {

/// Searches the epipolar lines of a keyframe's features in its neighbours and triangulates.
class PointTriangulator {
 public:
  PointTriangulator(const PinholeCamera& camera, const std::vector<float>& scale_factors);

  /// Adds the points that `keyframe` and one of its `neighbours` best covisible keyframes give;
  /// returns them. Neighbours whose centre is nearer than `min_baseline_share` of the median depth
  /// that they see are passed over. Holds the map while it copies and while it adds; a raised
  /// `stop` ends it early. O(neighbours * features^2), the square at a nanosecond.
  std::vector<PointId> grow(SharedMap& shared, KeyframeId keyframe, std::size_t neighbours,
                            const std::atomic<bool>& stop);

 private:
  /// A keyframe's features without a point, as arrays to run along.
  struct Candidates {
    RigidTransform T_cam_world;
    FrameFeaturesPtr shared_features;
    std::vector<std::uint32_t> features;
    std::vector<float> u, v, scales;
    std::vector<int> octaves;
  };
  void collect(const Keyframe& keyframe, Candidates& candidates) const;
  bool is_far_enough(const Map& map, const Keyframe& keyframe, const Keyframe& neighbour) const;
  bool copy_pair(SharedMap& shared, KeyframeId keyframe, KeyframeId neighbour);
  void match_lines();
  void add_points(SharedMap& shared, KeyframeId keyframe, KeyframeId neighbour,
                  const std::vector<TriangulatedPoint>& points, std::vector<PointId>& made) const;
  PointSighting sighting(const Candidates& candidates, std::int32_t index) const;

  PinholeCamera camera_;
  std::vector<float> scale_factors_;
  TriangulationOptions tests_;
  Candidates here_, there_;
  std::uint64_t corrections_ = 0;  // of the map that was copied
  std::vector<Match> matches_;
};

}  // namespace dynslam::slam
