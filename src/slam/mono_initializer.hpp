// The first map of a camera without depth, from two of its frames.
#pragma once

#include <cstddef>
#include <vector>

#include <opencv2/core/types.hpp>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/match.hpp"
#include "dynslam/matching/workspace.hpp"
#include "dynslam/slam/two_view.hpp"

#include "tracked_frame.hpp"

namespace dynslam::slam {

/// Two frames that give a map.
struct MonoStart {
  TrackedFrame first;           ///< without pose
  std::size_t first_index = 0;  ///< its number
  std::vector<Match> matches;   ///< its features (query) with those of the second frame (train)
  TwoViewReconstruction reconstruction;  ///< by match
};

/// Holds a frame until a later one shows the same scene from far enough aside.
///
/// The frame held is given up for the present one when too little of it is seen any more, so a
/// camera that turns, or stands in the dark, only starts later.
class MonoInitializer {
 public:
  MonoInitializer(const PinholeCamera& camera, const std::vector<float>& scale_factors);

  /// Offers the next frame, number `index`. True when it and the frame held give a map.
  bool offer(const TrackedFrame& frame, std::size_t index);

  /// What `offer` found when it said true; valid until the next call.
  const MonoStart& start() const { return start_; }

  /// Forgets the frame held.
  void reset() { holding_ = false; }

 private:
  void hold(const TrackedFrame& frame, std::size_t index);
  void match(const TrackedFrame& frame);
  void reconstruct(const TrackedFrame& frame);

  PinholeCamera camera_;
  std::vector<float> scale_factors_;
  bool holding_ = false;
  MonoStart start_;
  std::vector<cv::Point2f> last_seen_;  // by feature held: where it was seen last
  std::vector<std::uint8_t> keep_;
  matching::Workspace rejection_;
};

}  // namespace dynslam::slam
