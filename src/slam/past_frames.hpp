// Frames whose poses are estimated once more when more is known.
#pragma once

#include <cstddef>
#include <deque>
#include <vector>

#include <opencv2/core/mat.hpp>

#include "dynslam/slam/map.hpp"

#include "frame_log.hpp"
#include "tracked_frame.hpp"
#include "tracker.hpp"

namespace dynslam::slam {

/// Frames of the last second, the keyframes among them left out.
///
/// A frame is tracked against a map that knows little: points stand where a keyframe or two saw
/// them, and what walks is not known yet, above all when a map begins. A second later its points
/// have been refined or are known to have moved. Then its pose is estimated once more, and the
/// trajectory of the log has that one; what was returned for the frame stays as it was. The frames
/// that a map begins with keep their images as well and are matched anew, as their features were
/// spent on what turned out to move. Memory: the features of a second, and some 2 MB for each of
/// the first frames of a map.
class PastFrames {
 public:
  /// A map begins with the frame of this time.
  void begin(double timestamp);

  /// Takes a frame that is to be the next of the log, with the points that its features were
  /// matched with, by feature, whether or not they agreed. `frame` may have sought features.
  void add(const TrackedFrame& frame, std::vector<PointId> matched, std::size_t index);

  /// Estimates the frames once more that are old enough by then. The caller holds the map. O(1)
  /// frames a frame.
  void revise(double now, const Map& map, Tracker& tracker, FrameLog& log);

  /// Lets go of all frames: what they were matched with means nothing any more.
  void clear() { frames_.clear(); }

 private:
  struct PastFrame {
    std::size_t index = 0;  // in the log
    TrackedFrame frame;
    std::vector<cv::Mat> pyramid;  // what the levels of the frame are views of
  };
  static void keep_images(const TrackedFrame& frame, PastFrame& past);

  std::deque<PastFrame> frames_;  // oldest first
  double began_ = 0.0;
};

}  // namespace dynslam::slam
