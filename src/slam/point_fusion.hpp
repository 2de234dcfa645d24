// Joins points that are one in the world.
#pragma once

#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/match.hpp"
#include "dynslam/core/span.hpp"

#include "shared_map.hpp"

namespace dynslam::slam {

/// How near two points must be to be one.
struct FusionOptions {
  double radius = 3.0;  ///< pixels at the finest level around where a point should be seen
  /// Distance between two points that may be one, as a share of their depth.
  double max_gap = 0.05;
  int max_distance = 50;  ///< bits between the descriptors
};

/// Looks for map points in the image of a keyframe that does not show them yet: what is found at a
/// free feature becomes an observation, what is found at another point becomes one with it.
class PointFusion {
 public:
  PointFusion(const DepthCamera& camera, const std::vector<float>& scale_factors)
      : camera_(camera), scale_factors_(scale_factors) {}

  /// Takes the lock of the map twice, to look and to write; matches without it. Returns how many
  /// observations or joints were made.
  int fuse(SharedMap& shared, Span<const PointId> points, KeyframeId keyframe,
           const FusionOptions& options = {});

  /// A point was found at a feature: it gets the observation, or is the same as the point there.
  /// False if nothing was done. The caller holds the map; the keyframe is in it.
  bool join(Map& map, PointId candidate, const Observation& at,
            const FusionOptions& options = {}) const;

 private:
  FrameFeaturesPtr gather(const Map& map, Span<const PointId> points, KeyframeId keyframe,
                          const FusionOptions& options);

  DepthCamera camera_;
  std::vector<float> scale_factors_;
  std::vector<PointId> candidates_;
  std::vector<cv::Point2f> pixels_;
  std::vector<float> radii_;
  std::vector<int> min_octaves_, max_octaves_;
  std::vector<std::uint8_t> descriptors_;
  std::vector<Match> matches_;
};

}  // namespace dynslam::slam
