// Settings of the whole system.
#pragma once

#include <cstdint>

#include "dynslam/factors/pose_optimizer.hpp"
#include "dynslam/features/orb.hpp"
#include "dynslam/slam/loop_options.hpp"
#include "dynslam/slam/stereo_matcher.hpp"

namespace dynslam::slam {

/// What the camera gives beside its image.
enum class Sensor {
  kRgbd,    ///< a depth image registered to it
  kStereo,  ///< the rectified image of a second camera to the right, DepthCamera::bf away
  kMono,    ///< nothing: the map starts from two frames and has no scale of its own
};

/// "rgbd", "stereo" or "mono".
const char* to_string(Sensor sensor);

/// How frames are tracked against the map.
struct TrackingOptions {
  /// Features of each image. With SystemOptions::geometry up to 1.55 times `max_features`, where
  /// movers and masks hide much.
  features::OrbOptions orb;
  /// Sensor::kRgbd: depths beyond this are not used, metres, > 0. Engineering: Kinect's noise grows
  /// with the square of the distance (6 cm at 6 m).
  double max_depth = 6.0;
  /// Sensor::kStereo: points farther than this many baselines are not made from one frame, > 0;
  /// their disparity still counts in pose and bundle. Source: Mur-Artal, Tardos 2017 (40).
  double max_depth_baselines = 40.0;
  /// Sensor::kStereo: matching of the two images.
  StereoOptions stereo;
  /// Sensor::kRgbd: baseline of the right camera that stands for measured depth, metres, >= 0; 0
  /// takes the camera's own bf. The longer, the more its columns tell of depth alone, whose noise
  /// is learned, and the more it counts. Engineering: at 0.23 m the depth noise of a Kinect is
  /// worth about 0.2 pixels at all its distances; at 0.5 m what no noise tells (edges,
  /// registration) begins to count for too much.
  double virtual_baseline = 0.23;
  /// Half side of the search window around a point predicted from the last frame, pixels at the
  /// finest level, > 0; doubled once when too little is found. Engineering.
  double frame_radius = 15.0;
  /// Half side of the search window around a map point under the refined pose, pixels at the finest
  /// level, > 0. Engineering.
  double map_radius = 6.0;
  /// Inliers below which a frame is lost, >= 6. Engineering (the field's habit: 30).
  int min_inliers = 20;
  /// Inliers below which a relocalization is not believed, >= min_inliers.
  int min_relocalization_inliers = 35;
  /// Keyframes whose points make the local map, >= 1.
  int local_keyframes = 30;

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// When a frame becomes a keyframe, and what the map keeps.
struct MappingOptions {
  /// A keyframe is made when fewer than this share of the points that the reference keyframe shows
  /// is found again, (0, 1]. Engineering.
  double keyframe_share = 0.80;
  /// The same with Sensor::kMono, (0, 1]: new points need two keyframes there. Engineering (field's
  /// habit: 0.9).
  double mono_keyframe_share = 0.90;
  /// A keyframe is made as well when fewer points are found than this share of the most that a
  /// frame found since the last one, [0, 1); 0 switches that off. Where much is hidden few points
  /// are seen often enough to count in `keyframe_share`. Engineering.
  double remaining_share = 0.5;
  /// Choose keyframes by their looks instead (P-Mixed section 2): a frame becomes one when its
  /// similarity to each of the keyframes around is below this share of its similarity to the frame
  /// before, [0, 1]; 0 switches that off. Similarity: share of features found again by descriptor
  /// alone. The division makes one number serve sharp and blurred, rich and poor images.
  double keyframe_similarity = 0.0;
  /// Most frames between keyframes, >= 1 (field's habit: one second).
  int max_frames = 15;
  /// Fewest frames between keyframes, >= 0.
  int min_frames = 1;
  /// Keyframes that the local bundle adjustment moves, >= 1.
  int bundle_keyframes = 12;
  /// A point is dropped when it is found in less than this share of the frames that should show it,
  /// [0, 1] (field's habit: 0.25).
  double min_found_share = 0.25;
  /// A keyframe is dropped when this share of its points is seen by three others as well, (0, 1];
  /// 1 keeps all (field's habit: 0.9).
  double redundant_share = 0.90;

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Who does what no frame has to wait for: local mapping and loop closing.
enum class Threading {
  kSequential,  ///< `System::track` itself, before it returns: repeatable bit for bit
  kBackground,  ///< two threads that the system starts and ends with itself; for kMono one, for
                ///< loops: its tracking lives on the points of the last keyframe
};

/// Settings of System.
struct SystemOptions {
  /// What FrameInput holds. Depth images are left alone unless kRgbd, right images unless kStereo.
  Sensor sensor = Sensor::kRgbd;
  TrackingOptions tracking;
  MappingOptions mapping;
  /// Find what moves by comparing depth with earlier frames (P-Static section 3.2) and keep it out
  /// of pose and map, as a mask does.
  bool geometry = false;
  /// Reject matches with the last frame that move unlike their surroundings and unlike the camera
  /// (P-Mixed's histogram rejection in the form of matching::DefaultRule).
  bool reject_matches = false;
  /// How static weights take part in the pose: fixed, parameters beside the pose (P-Static section
  /// 4), or eliminated from it.
  factors::WeightMode weights = factors::WeightMode::kFixed;
  /// Refine keyframes and points by bundle adjustment after each keyframe.
  bool bundle_adjustment = true;
  /// Only find the camera in the map that System::start_from was given, and leave that as it is: no
  /// keyframes, no points, no weights. Without such a map no frame gets a pose.
  bool localize_only = false;
  /// Loops and recognition; without Ceres there are none.
  LoopOptions loops;
  /// Who works on keyframes.
  Threading threading = Threading::kSequential;

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

}  // namespace dynslam::slam
