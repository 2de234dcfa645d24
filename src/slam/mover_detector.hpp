// What moves, found from depth alone: the geometric half of P-Static.
#pragma once

#include <deque>
#include <functional>
#include <vector>

#include <opencv2/core/mat.hpp>
#include <opencv2/core/types.hpp>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/geometry/appearance.hpp"
#include "dynslam/geometry/depth_consistency.hpp"
#include "dynslam/geometry/reference_choice.hpp"
#include "dynslam/geometry/region_grow.hpp"
#include "dynslam/geometry/static_memory.hpp"
#include "dynslam/geometry/verdict.hpp"

#include "tracked_frame.hpp"

namespace dynslam::slam {

/// Compares each depth image with what earlier frames saw, and saw through.
class MoverDetector {
 public:
  explicit MoverDetector(const DepthCamera& camera);

  /// Share of the depth image (CV_32FC1 metres, 0 = none or masked) that agrees with earlier frames
  /// if it was taken from this pose, 0..1: a pose that follows a mover breaks the background. A
  /// coarse look, 1/16 of the cost of `detect`.
  double static_share(const cv::Mat& depth, const RigidTransform& T_cam_world, double timestamp);

  /// Judges a frame seen from a pose that movers have not captured, by its depth image and by what
  /// is known of its features. Without earlier frames nothing moves.
  void detect(const TrackedFrame& frame, Span<const geometry::FeatureVerdict> verdicts);

  /// Keeps the frame just judged as a reference for later ones, under its final pose.
  void remember(const TrackedFrame& frame);

  /// Forgets all references: the poses they were seen from mean nothing any more.
  void clear();
  /// Takes the references along when the world is laid out anew.
  void move_world(const RigidTransform& T_before_after);
  /// Gives the references after a time other poses, T_cam_world by timestamp, and forgets what was
  /// found under the old ones.
  void repose(double after, const std::function<RigidTransform(double)>& pose);

  /// The mask of the frame that `detect` was last given, with what is likely besides: what
  /// continues a mover behind something else, what does not look as earlier frames saw it there,
  /// and what is under the frame's own mask, fitted to the depth, unless earlier frames saw the
  /// same there. For users; tracking loses more by a static feature let go than by a moving one,
  /// whose weight falls soon.
  const cv::Mat& complete(const TrackedFrame& frame, Span<const geometry::FeatureVerdict> verdicts);

  /// Result of `detect`: CV_8UC1, 0 static, 255 dynamic.
  const cv::Mat& mask() const { return mask_; }
  /// How much more than chance each cell of kSurfaceCell pixels is believed to stand still,
  /// CV_32FC1 in [0, 1]; 0 under the mask.
  cv::Mat trust() const;
  /// CV_8UC1, 255 where `detect` came to a verdict.
  cv::Mat judged() const;
  /// Share of the image under the mask.
  double masked_share() const { return masked_share_; }
  /// Belief in [0, 1] that what is seen at a pixel stands still; 0.5 = no idea.
  float staticness(cv::Point2f pixel) const;

 private:
  struct Reference {
    double timestamp = 0.0;
    RigidTransform T_cam_world;
    geometry::DepthCells cells;
    cv::Mat gray_cells;
    cv::Mat gray_quarter;  // at half of their size, of a frame with a mask
  };
  void choose_references(const RigidTransform& T_cam_world, double timestamp);
  void thin_out();
  // Writes depth and evidence of the whole frame, what is under its mask included.
  void add_hidden(const TrackedFrame& frame);
  // Writes what the looks of a quarter of the cells that no mask hides add to their evidence.
  void look_at_quarter(const TrackedFrame& frame);
  // Adds to the evidence of the whole frame how its cells look in the references chosen.
  void add_looks(const TrackedFrame& frame);

  DepthCamera camera_;
  geometry::DepthCellsOptions cells_options_;
  geometry::DepthReferenceOptions choice_options_;
  geometry::DepthConsistencyOptions consistency_options_;
  geometry::RegionGrowOptions grow_options_;
  std::deque<Reference> references_;  // oldest first
  std::vector<geometry::DepthReference> chosen_;
  std::vector<MaskView> chosen_gray_, chosen_quarters_;  // by reference chosen
  geometry::AppearanceOptions quarter_options_;
  geometry::DepthEvidence evidence_, quarter_, coarse_, hidden_, whole_;
  geometry::CellMemory memory_;
  geometry::RegionGrowWorkspace workspace_;
  geometry::AppearanceWorkspace looks_;
  cv::Mat mask_, completed_, hidden_depth_, whole_depth_;
  double masked_share_ = 0.0;
};

}  // namespace dynslam::slam
