// The systems of the papers, each as the settings that make it one.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "dynslam/slam/options.hpp"

namespace dynslam::slam {

/// What compositions differ by, and what can be left out of them.
enum class Part {
  kMask,       ///< masks of a segmenter, in FrameInput::mask
  kGeometry,   ///< what moves, by depth and epipolar geometry: SystemOptions::geometry
  kWeights,    ///< static weights in the pose: SystemOptions::weights
  kRejection,  ///< rejected matches: SystemOptions::reject_matches
  kLoops,      ///< loop closing: SystemOptions::loops
};

/// "mask", "geometry", "weights", "rejection", "loops".
const char* to_string(Part part);

/// The part of that name. Throws InvalidArgument listing the names for any other.
Part part_from_name(std::string_view name);

/// All parts, and their names, in the order of the enumeration.
const std::vector<Part>& all_parts();
const std::vector<std::string>& part_names();

/// A system by configuration. Segmentation is the host's: a system that uses masks is given them
/// frame by frame, made by any `segmentation::Segmenter`, at once or late.
struct Composition {
  std::string name;     ///< "p-static"
  std::string summary;  ///< what handles movers, one line
  bool masks = false;   ///< give it masks in FrameInput::mask
  SystemOptions options;

  /// Whether it has the part.
  bool has(Part part) const;
  /// The parts that it has, in the order of the enumeration.
  std::vector<Part> parts() const;
  /// The same system without a part; as it is where it has no such part. The name stays.
  Composition without(Part part) const;
};

/// Nothing handles movers: SLAM, with loop closing as all of these, for a world that stands still.
Composition baseline();

/// Masks; features on them are dropped before tracking (P-Yolo: YOLOv5 beside ORB-SLAM2). The
/// published system drops whole boxes; masks give the same with less of the background lost.
Composition p_yolo();

/// Masks, the weighted geometric constraint with depth for what no network knows, and static
/// weights in the pose (P-Static, sections 3.2 and 4). Departure: the weights are eliminated from
/// the problem rather than parameters of it, which has the same optimum.
Composition p_static();

/// Masks of a network with mixed attention, matches with improbable displacements rejected, frames
/// that look new made keyframes (P-Mixed, sections 2 and 3.2). Any segmenter will do; `dynslam
/// fuse` makes the attention fast.
Composition p_mixed();

/// The names of the four, in the order above.
const std::vector<std::string>& composition_names();

/// The composition of that name. Throws InvalidArgument listing the names for any other.
Composition composition(std::string_view name);

}  // namespace dynslam::slam
