// A frame on its way through the tracker.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include <opencv2/core/mat.hpp>

#include "dynslam/core/image_view.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/slam/frame.hpp"
#include "dynslam/slam/map.hpp"
#include "dynslam/slam/system.hpp"

#include "depth_alignment.hpp"

namespace dynslam::slam {

/// Features of a frame, its pose, and which map point each feature shows.
struct TrackedFrame {
  FrameFeaturesPtr features;
  FrameFeaturesPtr corners;  ///< the features without sought ones; null while there are none
  double timestamp = 0.0;
  RigidTransform T_cam_world;
  cv::Mat depth;                       ///< copy of the depth image; 0 under the mask
  cv::Mat mask;                        ///< copy of the given mask, CV_8UC1; empty without
  cv::Mat hidden_depth;                ///< the depth under the mask (`split_depth`); likewise
  cv::Mat gray;                        ///< CV_8UC1
  std::vector<GrayView> levels;        ///< its pyramid, while it is the newest frame; may be empty
  cv::Mat gray_cells;                  ///< the image at a quarter of its size, CV_8UC1
  cv::Mat cell_trust;                  ///< MoverDetector::trust; may be empty
  SurfaceGrid surface;                 ///< of depth and gray_cells once `ensure_surface` is called
  std::vector<PointId> points;         ///< by feature; kNoId = none
  std::vector<std::uint8_t> moving;    ///< by feature: 1 when geometry says that it moves
  std::vector<float> staticness;       ///< by feature: what geometry believes, 0..1; NaN = no idea
  std::vector<std::int32_t> previous;  ///< by feature: the same in the frame before, -1 = none
  std::vector<std::uint8_t> rejected;  ///< by feature: 1 when its match disagreed with the pose

  void reset(FrameFeaturesPtr new_features, double time) {
    features = std::move(new_features);
    corners = nullptr;
    timestamp = time;
    cell_trust.release();
    surface.clear();
    points.assign(features->size(), kNoId);
    rejected.assign(features->size(), 0);
    previous.assign(features->size(), -1);
    moving.assign(features->size(), 0);
    staticness.assign(features->size(), std::numeric_limits<float>::quiet_NaN());
  }

  /// Forgets all that was found out with its corners.
  void start_over() {
    drop_sought();
    reset(features, timestamp);
  }

  /// Takes features that were sought by the looks of points beside those it has, which come first.
  void add_sought(FrameFeaturesPtr with_sought);
  /// Lets go of them again: the next frame is matched with corners.
  void drop_sought();

 private:
  void resize_to_features();
};

/// Builds the surface of a frame, unless it is there already; false without depth. O(pixels).
bool ensure_surface(const PinholeCamera& camera, TrackedFrame& frame);

/// What became of the features of a frame that was tracked.
FeaturesView view_of(const TrackedFrame& frame);

}  // namespace dynslam::slam
