// The system with background workers, and the same stages in sequence.
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/scene.hpp"
#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/slam/system.hpp"

#include "sanitized.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kFrames = 40;

// Frames are rendered once for all tests.
const std::vector<dataset::Frame>& room() {
  static const std::vector<dataset::Frame> frames = [] {
    dataset::SceneOptions options;
    options.camera = dataset::scene_camera(320, 240);
    options.frames = kFrames;
    options.fps = 10.0;  // wide steps: more keyframes
    const auto scene = dataset::make_scene("room_still", options);
    std::vector<dataset::Frame> read;
    for (std::size_t i = 0; i < scene->size(); ++i) read.push_back(scene->read(i));
    return read;
  }();
  return frames;
}

SystemOptions options_with(Threading threading) {
  SystemOptions options;
  options.tracking.orb.max_features = 500;
  options.tracking.orb.levels = 4;
  options.mapping.max_frames = 4;
  options.loops.first_vocabulary = 4;
  options.threading = threading;
  return options;
}

System make_system(Threading threading) {
  return System(dataset::scene_camera(320, 240), options_with(threading));
}

FrameInput input_of(const dataset::Frame& frame) {
  return {frame.timestamp, frame.color, frame.depth, {}};
}

double ate(const System& system) {
  Trajectory truth;
  for (const dataset::Frame& frame : room()) truth.push_back({frame.timestamp, *frame.T_world_cam});
  return evaluation::ate(truth, system.trajectory()).error.rmse;
}

TEST(Threads, TrackAsWellWithWorkersBesideAsInSequence) {
  System system = make_system(Threading::kBackground);
  std::size_t keyframes = 0;
  for (const dataset::Frame& frame : room()) {
    const FrameResult result = system.track(input_of(frame));
    EXPECT_EQ(result.state, TrackingState::kTracked) << result.index;
    keyframes += result.keyframe ? 1 : 0;
  }
  system.finish();
  EXPECT_EQ(system.trajectory().size(), kFrames);
  EXPECT_LT(ate(system), 0.02);
  EXPECT_GE(keyframes, 4U);
  EXPECT_GE(system.map().keyframe_count(), 3U);
  EXPECT_EQ(system.keyframe_trajectory().size(), system.map().keyframe_count());
}

TEST(Threads, TrackingGoesOnAfterFinish) {
  System system = make_system(Threading::kBackground);
  for (const dataset::Frame& frame : room()) {
    system.track(input_of(frame));
    if (frame.index % 10 == 0) system.finish();
  }
  system.finish();
  EXPECT_EQ(system.trajectory().size(), kFrames);
  EXPECT_LT(ate(system), 0.02);
}

TEST(Threads, StopAtAnyMoment) {
  std::mt19937 random(3);
  constexpr int kRuns = dynslam::testing::kSanitized ? 40 : 100;
  for (int run = 0; run < kRuns; ++run) {
    System system = make_system(Threading::kBackground);
    const std::size_t frames = random() % 8;
    for (std::size_t i = 0; i < frames; ++i) system.track(input_of(room()[3 * i]));
    if (run % 5 == 0) system.finish();
    if (run % 3 == 0) {
      EXPECT_LE(system.trajectory().size(), frames);
    }
  }
}

TEST(Threads, SequenceGivesTheSameBitsTwiceWithLoopsAndAVocabularyOfItsOwn) {
  System a = make_system(Threading::kSequential), b = make_system(Threading::kSequential);
  for (const dataset::Frame& frame : room()) {
    a.track(input_of(frame));
    b.track(input_of(frame));
  }
  a.finish();
  const Trajectory first = a.trajectory(), second = b.trajectory();
  ASSERT_EQ(first.size(), second.size());
  for (std::size_t i = 0; i < first.size(); ++i) {
    EXPECT_EQ(first[i].T_world_cam.matrix(), second[i].T_world_cam.matrix());
  }
}

TEST(Threads, TimesOfBackgroundWorkAreToldApart) {
  for (const Threading threading : {Threading::kSequential, Threading::kBackground}) {
    System system = make_system(threading);
    double map = 0.0, loop = 0.0;
    for (const dataset::Frame& frame : room()) {
      const FrameResult result = system.track(input_of(frame));
      map += result.background.map;
      loop += result.background.loop;
    }
    EXPECT_GT(map, 0.0);
    EXPECT_GT(loop, 0.0);
  }
}

TEST(LoopOptions, EveryRuleIsCheckedByName) {
  const auto message = [](auto change) {
    LoopOptions options;
    change(options);
    try {
      options.validate();
    } catch (const InvalidArgument& error) {
      return std::string(error.what());
    }
    return std::string("nothing thrown");
  };
  const auto names = [&](const char* name, auto change) {
    EXPECT_NE(message(change).find(name), std::string::npos) << name;
  };
  names("first_vocabulary", [](LoopOptions& o) { o.first_vocabulary = 1; });
  names("consistency", [](LoopOptions& o) { o.consistency = 0; });
  names("min_inliers", [](LoopOptions& o) { o.min_inliers = 5; });
  names("min_confirmed", [](LoopOptions& o) { o.min_confirmed = 1.5; });
}

}  // namespace
}  // namespace dynslam::slam
