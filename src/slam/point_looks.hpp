// How map points look, and where a frame shows them by that.
#pragma once

#include <cstddef>
#include <cstdint>
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
/// more, or the feature lies too near to a border. O(1), 2 us with depth.
std::shared_ptr<const PointLook> point_look(const PinholeCamera& camera, const TrackedFrame& frame,
                                            std::size_t feature, const Eigen::Vector3d& position,
                                            const std::vector<float>& scale_factors);

/// A point of the map that a frame should show, on which level of its pyramid, and how many
/// keyframes have seen it.
struct SoughtPoint {
  std::uint32_t source = 0;  ///< the caller's index of the point
  PointId id = kNoId;
  int octave = 0;
  std::size_t observations = 0;
};

/// Finds points in a frame by how they look in the map. Its pose has to be known to a few pixels.
///
/// A corner is found anew in every image, to a third of a pixel of its level, or is not. A look is
/// found to a tenth, and always the same place of it, so that what is left of its error does not
/// change from frame to frame; and it needs no corner.
class LookFinder {
 public:
  LookFinder(const DepthCamera& camera, const std::vector<float>& scale_factors)
      : camera_(camera), scale_factors_(scale_factors) {}

  /// Moves the key points of matches to where their points look as they do in the map. Matches show
  /// the points ids[match.source]. Features are shared and never change, so those of the frame are
  /// replaced. Key points stay whose point has no look, or one from more than 14 degrees aside, or
  /// is found neither within a pixel of the level from the key point nor, where that lies within
  /// three of it, from the place that the pose tells. Notes how well places are known
  /// (FrameFeatures::alignment_sigmas). Returns how many were moved. O(matches), 0.3 us each.
  int align(const Map& map, const std::vector<PointMatch>& matches, const std::vector<PointId>& ids,
            TrackedFrame& frame) const;

  /// Finds points, the first `most` of them, where no corner was, within a pixel of the level from
  /// where the pose tells, and adds a feature for each (TrackedFrame::add_sought), with the
  /// descriptor of the point and the depth that the frame has there. That has to be the point's
  /// within a twentieth: what hides it is nearer, and masked places have none. Where the frame has
  /// opinions on what stands still (`cell_trust`) it has to be one that does. Without a depth image
  /// nothing is found. Returns the matches, with positions and weight 1. O(points), 0.3 us each.
  std::vector<PointMatch> seek(const Map& map, const std::vector<SoughtPoint>& points,
                               std::size_t most, TrackedFrame& frame) const;

 private:
  // Where the look of a point is to be expected on a level of the frame, and how warped.
  struct Expected {
    Eigen::Matrix2f A_look_level;
    Eigen::Vector2f at;  // pixels of the level
  };
  std::optional<Expected> expect(const MapPoint& point, const TrackedFrame& frame,
                                 std::size_t octave) const;
  // A place in a frame, and its standard deviation, pixels of the level.
  struct Found {
    cv::Point2f at;
    float sigma;
  };
  std::optional<Found> find(const MapPoint& point, const TrackedFrame& frame,
                            const cv::KeyPoint& keypoint) const;
  std::optional<Found> find_near(const PointLook& look, const Expected& expected,
                                 const Eigen::Vector2f& start, const TrackedFrame& frame,
                                 std::size_t octave) const;
  void add_feature(const MapPoint& point, const cv::KeyPoint& keypoint, float depth, float sigma,
                   FrameFeatures& features) const;

  DepthCamera camera_;
  std::vector<float> scale_factors_;
};

}  // namespace dynslam::slam
