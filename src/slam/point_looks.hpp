// How map points look, and where a frame shows them by that.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/slam/map.hpp"

#include "pose_estimation.hpp"
#include "tracked_frame.hpp"

namespace dynslam::slam {

/// How a feature of a frame shows its point at `position`. Null if the frame has no pyramid any
/// more, or the feature lies too near to a border. O(1).
std::shared_ptr<const PointLook> point_look(const TrackedFrame& frame, std::size_t feature,
                                            const Eigen::Vector3d& position,
                                            const std::vector<float>& scale_factors);

/// Moves key points to where their points look as they do in the map.
///
/// A corner is found anew in every image, to a third of a pixel of its level. The point's look is
/// found to a tenth, and always the same place of it, so that what is left of a key point's error
/// does not change from frame to frame.
class KeypointAligner {
 public:
  KeypointAligner(const PinholeCamera& camera, const std::vector<float>& scale_factors)
      : camera_(camera), scale_factors_(scale_factors) {}

  /// Matches show the points ids[match.source]; the frame's pose has to be known to a few pixels.
  /// Features are shared and never change, so those of the frame are replaced. Key points stay that
  /// move by more than a pixel of their level, or whose point has no look or one from more than 14
  /// degrees aside. Returns how many were moved. O(matches), 0.3 us each.
  int align(const Map& map, const std::vector<PointMatch>& matches, const std::vector<PointId>& ids,
            TrackedFrame& frame) const;

 private:
  std::optional<cv::Point2f> find(const MapPoint& point, const TrackedFrame& frame,
                                  const cv::KeyPoint& keypoint) const;

  PinholeCamera camera_;
  std::vector<float> scale_factors_;
};

}  // namespace dynslam::slam
