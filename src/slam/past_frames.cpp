#include "past_frames.hpp"

#include <optional>
#include <utility>

#include "dynslam/core/opencv.hpp"

namespace dynslam::slam {
namespace {

constexpr double kHindsight = 1.0;  // seconds after which a frame is looked at again
constexpr double kBeginning = 0.3;  // seconds from the first frame of a map on: what walks is found

}  // namespace

void PastFrames::begin(double timestamp) {
  clear();
  began_ = timestamp;
}

// The buffers of a frame belong to the next one soon.
void PastFrames::keep_images(const TrackedFrame& frame, PastFrame& past) {
  past.frame.depth = frame.depth.clone();
  for (const GrayView& level : frame.levels) {
    past.pyramid.push_back(as_mat(level).clone());
    past.frame.levels.push_back(as_view<const std::uint8_t>(past.pyramid.back()));
  }
}

void PastFrames::add(const TrackedFrame& frame, std::vector<PointId> matched, std::size_t index) {
  PastFrame past;
  past.index = index;
  past.frame.reset(frame.features, frame.timestamp);
  past.frame.corners = frame.corners;
  past.frame.points = std::move(matched);
  past.frame.moving = frame.moving;
  past.frame.staticness = frame.staticness;
  if (!frame.depth.empty() && frame.timestamp - began_ < kBeginning) {
    keep_images(frame, past);
    past.frame.cell_trust = frame.cell_trust;
  }
  frames_.push_back(std::move(past));
}

void PastFrames::revise(double now, const Map& map, Tracker& tracker, FrameLog& log) {
  while (!frames_.empty() && now - frames_.front().frame.timestamp >= kHindsight) {
    const std::size_t index = frames_.front().index;
    TrackedFrame& frame = frames_.front().frame;
    if (const auto T_cam_world = log.pose(map, index)) {
      frame.T_cam_world = *T_cam_world;
      if (tracker.estimate_again(map, log.reference_of(index), frame)) {
        log.set_pose(map, index, frame.T_cam_world);
      }
    }
    frames_.pop_front();
  }
}

}  // namespace dynslam::slam
