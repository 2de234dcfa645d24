// What tracking and the background workers share, and the lock over it.
#pragma once

#include <cstdint>

#include "dynslam/slam/map.hpp"

#include "frame_log.hpp"
#include "map_mutex.hpp"

namespace dynslam::slam {

/// Everything here is read and written under `mutex`: by tracking with a TrackingLock, by workers
/// with a BackgroundLock held for a few milliseconds at a time. Ids may die between two holds.
struct SharedMap {
  MapMutex mutex;
  Map map;
  FrameLog log;
  /// Counts corrections that move the map as a whole, loops and their bundle adjustment: who
  /// computed from a copy compares it before writing back, who keeps poses of his own moves them.
  std::uint64_t corrections = 0;
};

}  // namespace dynslam::slam
