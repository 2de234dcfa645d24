#include "dynslam/dataset/scene.hpp"

#include <limits>
#include <memory>
#include <string>
#include <utility>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "dynslam/core/errors.hpp"

#include "dataset/scene_testing.hpp"

namespace dynslam::dataset {
namespace {

TEST(MakeScene, GivesFramesWithImageDepthMaskAndPose) {
  SceneOptions options = small(3, 120, 90);
  options.frames = 12;
  options.start_time = 1000.0;
  options.fps = 25.0;
  options.exposure_time = 0.005;
  const auto sequence = make_scene("room_walking", options);
  EXPECT_EQ(sequence->name(), "room_walking");
  EXPECT_EQ(sequence->size(), 12U);
  EXPECT_EQ(sequence->sensor(), SensorKind::kRgbd);
  EXPECT_EQ(sequence->fps(), 25.0);
  EXPECT_EQ(sequence->camera().width, 120);
  EXPECT_NO_THROW(sequence->camera().validate());
  ASSERT_EQ(sequence->truth().size(), 12U);
  const Frame frame = sequence->read(5);
  EXPECT_EQ(frame.index, 5U);
  EXPECT_DOUBLE_EQ(frame.timestamp, 1000.2);
  EXPECT_EQ(frame.name, "1000.200000");
  EXPECT_EQ(sequence->frame_name(5), frame.name);
  EXPECT_EQ(sequence->timestamp(5), frame.timestamp);
  EXPECT_EQ(frame.color.type(), CV_8UC3);
  EXPECT_EQ(frame.depth.type(), CV_32FC1);
  EXPECT_EQ(frame.mask.type(), CV_8UC1);
  EXPECT_EQ(frame.color.size(), cv::Size(120, 90));
  EXPECT_EQ(frame.depth.size(), cv::Size(120, 90));
  EXPECT_EQ(frame.mask.size(), cv::Size(120, 90));
  EXPECT_TRUE(frame.right.empty());
  ASSERT_TRUE(frame.T_world_cam.has_value());
  EXPECT_EQ(frame.T_world_cam->t, sequence->truth()[5].T_world_cam.t);
  EXPECT_EQ(sequence->truth()[5].timestamp, frame.timestamp);
}

TEST(MakeScene, KnowsAllItsNames) {
  SceneOptions options = small();
  options.frames = 2;
  for (const std::string& name : scene_names()) {
    EXPECT_EQ(make_scene(name, options)->name(), name);
  }
}

TEST(MakeScene, RoomStillHasNoMovers) {
  SceneOptions options = small();
  options.frames = 100;
  const auto still = make_scene("room_still", options);
  const auto walking = make_scene("room_walking", options);
  EXPECT_EQ(cv::countNonZero(still->read(50).mask), 0);
  EXPECT_EQ(still->truth()[99].T_world_cam.t, walking->truth()[99].T_world_cam.t);
}

TEST(MakeScene, NamesTheScenesThereAreWhenAskedForAnother) {
  try {
    make_scene("kitchen");
    FAIL() << "no exception";
  } catch (const InvalidArgument& error) {
    const std::string text = error.what();
    EXPECT_NE(text.find("kitchen"), std::string::npos) << text;
    EXPECT_NE(text.find("room_walking"), std::string::npos) << text;
  }
}

TEST(MakeScene, RefusesFramesPastTheEnd) {
  SceneOptions options = small();
  options.frames = 3;
  const auto sequence = make_scene("room_still", options);
  EXPECT_THROW(sequence->read(3), InvalidArgument);
  EXPECT_THROW(sequence->timestamp(3), InvalidArgument);
  EXPECT_THROW(sequence->frame_name(3), InvalidArgument);
}

// ---------------------------------------------------------------- options

class BadSceneOption
    : public ::testing::TestWithParam<std::pair<const char*, void (*)(SceneOptions&)>> {};

TEST_P(BadSceneOption, IsRefusedByName) {
  const auto& [name, spoil] = GetParam();
  SceneOptions options;
  options.validate();
  spoil(options);
  try {
    const RenderedScene scene(options);
    FAIL() << name;
  } catch (const InvalidArgument& error) {
    EXPECT_NE(std::string(error.what()).find(name), std::string::npos) << error.what();
  }
}

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

INSTANTIATE_TEST_SUITE_P(
    Options, BadSceneOption,
    ::testing::Values(std::pair(
                          "frames", +[](SceneOptions& o) { o.frames = 0; }),
                      std::pair(
                          "frames", +[](SceneOptions& o) { o.frames = 1000001; }),
                      std::pair(
                          "fps", +[](SceneOptions& o) { o.fps = 0.0; }),
                      std::pair(
                          "fps", +[](SceneOptions& o) { o.fps = kNaN; }),
                      std::pair(
                          "start_time", +[](SceneOptions& o) { o.start_time = kNaN; }),
                      std::pair(
                          "fx", +[](SceneOptions& o) { o.camera.fx = 0.0; }),
                      std::pair(
                          "bf", +[](SceneOptions& o) { o.camera.bf = -1.0; }),
                      std::pair(
                          "camera.width", +[](SceneOptions& o) { o.camera.width = 15; }),
                      std::pair(
                          "camera.height", +[](SceneOptions& o) { o.camera.height = 8193; }),
                      std::pair(
                          "motion",
                          +[](SceneOptions& o) { o.motion = static_cast<CameraMotion>(9); }),
                      std::pair(
                          "camera_speed", +[](SceneOptions& o) { o.camera_speed = -0.1; }),
                      std::pair(
                          "tremor", +[](SceneOptions& o) { o.tremor = 11.0; }),
                      std::pair(
                          "mover_speed", +[](SceneOptions& o) { o.mover_speed = kNaN; }),
                      std::pair(
                          "exposure_time", +[](SceneOptions& o) { o.exposure_time = 0.04; }),
                      std::pair(
                          "exposure_time", +[](SceneOptions& o) { o.exposure_time = -0.01; }),
                      std::pair(
                          "threads", +[](SceneOptions& o) { o.threads = 0; })));

}  // namespace
}  // namespace dynslam::dataset
