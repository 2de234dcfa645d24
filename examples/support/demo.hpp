// What the examples of whole systems share: frames, masks, and a judgement at the end.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include <opencv2/core/mat.hpp>

#include "dynslam/dataset/sequence.hpp"
#include "dynslam/segmentation/mask_policy.hpp"
#include "dynslam/segmentation/segmenter.hpp"
#include "dynslam/slam/system.hpp"

namespace dynslam::examples {

/// The frames that an example runs on, and the segmenter it was given:
///
///     example [FOLDER [SEGMENTER]]
///
/// FOLDER in TUM RGB-D layout; without it, a rendered room with two people walking through.
/// SEGMENTER as `segmentation::make_segmenter` takes it; without it, the true masks of the
/// sequence, as a perfect network would give them.
class Demo {
 public:
  Demo(int argc, char** argv);

  const dataset::Sequence& sequence() const { return *sequence_; }
  segmentation::Segmenter& segmenter() { return *segmenter_; }

  /// Reads the frames one after the other.
  void for_each_frame(const std::function<void(const dataset::Frame&)>& visit) const;

  /// Prints what became of the system. Returns the program's exit code: 0 when the system kept
  /// track of the camera.
  int judge(const std::string& name, const slam::System& system) const;

 private:
  std::unique_ptr<dataset::Sequence> sequence_;
  std::unique_ptr<segmentation::Segmenter> segmenter_;
};

/// What a segmenter may want to know of a frame. Its depth is seen, not copied.
segmentation::FrameInfo info_of(const dataset::Frame& frame);

/// The frame as the system takes it, with a mask of what moves.
slam::FrameInput input_of(const dataset::Frame& frame, const cv::Mat& mask = {});

/// Runs an example; an error becomes one line on stderr and exit code 1.
int run_demo(int argc, char** argv, const std::function<int(Demo&)>& example);

}  // namespace dynslam::examples
