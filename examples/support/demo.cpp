#include "demo.hpp"

#include <cstdio>
#include <exception>

#include "dynslam/core/opencv.hpp"
#include "dynslam/dataset/readers.hpp"
#include "dynslam/dataset/scene.hpp"
#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/segmentation/segmenter_factory.hpp"

#include "truth_segmenter.hpp"

namespace dynslam::examples {
namespace {

constexpr std::size_t kSceneFrames = 60;  // two seconds
constexpr double kTrackedShare = 0.9;     // of the frames, for an example to have worked

std::unique_ptr<dataset::Sequence> open_sequence(int argc, char** argv) {
  if (argc > 1) return dataset::open_tum(argv[1]);
  dataset::SceneOptions options;
  options.frames = kSceneFrames;
  return dataset::make_scene("room_walking", options);
}

}  // namespace

Demo::Demo(int argc, char** argv) : sequence_(open_sequence(argc, argv)) {
  if (argc > 2) {
    segmenter_ = segmentation::make_segmenter(argv[2]);
  } else {
    segmenter_ = std::make_unique<TruthSegmenter>(*sequence_);
  }
}

void Demo::for_each_frame(const std::function<void(const dataset::Frame&)>& visit) const {
  for (std::size_t i = 0; i < sequence_->size(); ++i) visit(sequence_->read(i));
}

int Demo::judge(const std::string& name, const slam::System& system) const {
  const Trajectory trajectory = system.trajectory();
  std::printf("%-24s %4zu of %4zu frames tracked, %3zu keyframes, %5zu points", name.c_str(),
              trajectory.size(), sequence_->size(), system.map().keyframe_count(),
              system.map().point_count());
  if (!sequence_->truth().empty()) {
    std::printf(", ATE RMSE %.4f m", evaluation::ate(sequence_->truth(), trajectory).error.rmse);
  }
  std::printf("\n");
  return static_cast<double>(trajectory.size()) >=
                 kTrackedShare * static_cast<double>(sequence_->size())
             ? 0
             : 1;
}

segmentation::FrameInfo info_of(const dataset::Frame& frame) {
  segmentation::FrameInfo info;
  info.index = frame.index;
  info.timestamp = frame.timestamp;
  info.name = frame.name;
  info.depth = as_view<const float>(frame.depth);
  return info;
}

slam::FrameInput input_of(const dataset::Frame& frame, const cv::Mat& mask) {
  slam::FrameInput input;
  input.timestamp = frame.timestamp;
  input.image = frame.color;
  input.depth = frame.depth;
  input.mask = mask;
  input.right = frame.right;
  return input;
}

int run_demo(int argc, char** argv, const std::function<int(Demo&)>& example) {
  try {
    Demo demo(argc, argv);
    return example(demo);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", argv[0], error.what());
    return 1;
  }
}

}  // namespace dynslam::examples
