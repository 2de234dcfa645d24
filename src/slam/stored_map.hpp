// Whether a map from a file suits the system that is to go on with it.
#pragma once

#include "dynslam/core/camera.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/slam/map_io.hpp"

namespace dynslam::slam {

/// Throws InvalidArgument in the name of `function` unless the map has keyframes, made with this
/// camera (its bf apart) and these scale factors.
void require_suitable(const char* function, const StoredMap& stored, const DepthCamera& camera,
                      Span<const float> scale_factors);

/// Computes the right columns of all features with depth anew if they were made with another bf.
void convert_right_columns(StoredMap& stored, double bf);

}  // namespace dynslam::slam
