// A loop that was closed.
#pragma once

#include <cstddef>

#include "dynslam/core/rigid_transform.hpp"

namespace dynslam::slam {

/// Two frames that show one place, found by their looks and verified by geometry.
struct LoopClosure {
  std::size_t query_frame = 0;  ///< running number of the frame that came back
  std::size_t match_frame = 0;  ///< and of the one that saw the place before
  double query_timestamp = 0.0;
  double match_timestamp = 0.0;
  RigidTransform T_query_match;  ///< motion between the two, as verified, in the unit of the match
  double scale = 1.0;  ///< length at the query of what is 1 long at the match; not 1 without depth
  int inliers = 0;     ///< map points of the old place that the query confirms
  int visible = 0;     ///< of those that it should see
  int shared = 0;      ///< map points that tracking had joined both by already
  double moved = 0.0;  ///< metres by which closing it moved the query
};

}  // namespace dynslam::slam
