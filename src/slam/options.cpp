#include "dynslam/slam/options.hpp"

#include "dynslam/core/errors.hpp"

namespace dynslam::slam {

const char* to_string(Sensor sensor) {
  switch (sensor) {
    case Sensor::kRgbd:
      return "rgbd";
    case Sensor::kStereo:
      return "stereo";
    case Sensor::kMono:
      return "mono";
  }
  return "";
}

void TrackingOptions::validate() const {
  constexpr const char* kName = "TrackingOptions";
  orb.validate();
  require(max_depth > 0.0, kName, "max_depth", max_depth, "a positive number of metres");
  require(max_depth_baselines > 0.0, kName, "max_depth_baselines", max_depth_baselines,
          "a positive number");
  stereo.validate();
  require(virtual_baseline >= 0.0, kName, "virtual_baseline", virtual_baseline,
          "a number of metres, or 0");
  require(frame_radius > 0.0, kName, "frame_radius", frame_radius, "a positive number of pixels");
  require(map_radius > 0.0, kName, "map_radius", map_radius, "a positive number of pixels");
  require(min_inliers >= 6, kName, "min_inliers", min_inliers, "at least 6");
  require(min_relocalization_inliers >= min_inliers, kName, "min_relocalization_inliers",
          min_relocalization_inliers, "at least min_inliers");
  require(local_keyframes >= 1, kName, "local_keyframes", local_keyframes, "at least 1");
}

void MappingOptions::validate() const {
  constexpr const char* kName = "MappingOptions";
  require(keyframe_share > 0.0 && keyframe_share <= 1.0, kName, "keyframe_share", keyframe_share,
          "a share in (0, 1]");
  require(mono_keyframe_share > 0.0 && mono_keyframe_share <= 1.0, kName, "mono_keyframe_share",
          mono_keyframe_share, "a share in (0, 1]");
  require(remaining_share >= 0.0 && remaining_share < 1.0, kName, "remaining_share",
          remaining_share, "a share in [0, 1)");
  require(keyframe_similarity >= 0.0 && keyframe_similarity <= 1.0, kName, "keyframe_similarity",
          keyframe_similarity, "a share in [0, 1]");
  require(max_frames >= 1, kName, "max_frames", max_frames, "at least 1");
  require(min_frames >= 0, kName, "min_frames", min_frames, "at least 0");
  require(bundle_keyframes >= 1, kName, "bundle_keyframes", bundle_keyframes, "at least 1");
  require(min_found_share >= 0.0 && min_found_share <= 1.0, kName, "min_found_share",
          min_found_share, "a share in [0, 1]");
  require(redundant_share > 0.0 && redundant_share <= 1.0, kName, "redundant_share",
          redundant_share, "a share in (0, 1]");
}

void LoopOptions::validate() const {
  constexpr const char* kName = "LoopOptions";
  require(first_vocabulary >= 2, kName, "first_vocabulary", first_vocabulary, "at least 2");
  require(consistency >= 1, kName, "consistency", consistency, "at least 1");
  require(min_inliers >= 6, kName, "min_inliers", min_inliers, "at least 6");
  require(min_confirmed >= 0.0 && min_confirmed <= 1.0, kName, "min_confirmed", min_confirmed,
          "a share in [0, 1]");
}

void SystemOptions::validate() const {
  tracking.validate();
  mapping.validate();
  loops.validate();
}

}  // namespace dynslam::slam
