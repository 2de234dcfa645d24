// How much a frame looks like others: P-Mixed's score for keyframes.
#pragma once

#include "dynslam/slam/frame.hpp"

namespace dynslam::slam {

/// Share of a frame's corners, 0..1, that another frame shows as well: whose descriptor is, both
/// ways, the nearest and near enough to be the same. 0 for a frame without features. O(N x M).
double similarity(const FrameFeatures& frame, const FrameFeatures& other);

}  // namespace dynslam::slam
