#include "dynslam/slam/system.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/scene.hpp"
#include "dynslam/evaluation/metrics.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kFrames = 45;

dataset::SceneOptions small_scene() {
  dataset::SceneOptions options;
  options.camera = dataset::scene_camera(320, 240);
  options.frames = kFrames;
  return options;
}

// Frames are rendered once for all tests.
const std::vector<dataset::Frame>& frames_of(const std::string& name) {
  static std::map<std::string, std::vector<dataset::Frame>> cache;
  std::vector<dataset::Frame>& frames = cache[name];
  if (frames.empty()) {
    const auto scene = dataset::make_scene(name, small_scene());
    for (std::size_t i = 0; i < scene->size(); ++i) frames.push_back(scene->read(i));
  }
  return frames;
}

FrameInput input_of(const dataset::Frame& frame, bool with_mask = false) {
  FrameInput input{frame.timestamp, frame.color, frame.depth, {}};
  if (with_mask) input.mask = frame.mask != 0;
  return input;
}

System make_system() {
  SystemOptions options;
  options.tracking.orb.max_features = 600;
  options.tracking.orb.levels = 4;
  return System(dataset::scene_camera(320, 240), options);
}

double ate(const System& system, const std::vector<dataset::Frame>& frames) {
  Trajectory truth;
  for (const dataset::Frame& frame : frames) truth.push_back({frame.timestamp, *frame.T_world_cam});
  return evaluation::ate(truth, system.trajectory()).error.rmse;
}

TEST(System, TracksAStillRoomToAFewMillimetres) {
  System system = make_system();
  for (const dataset::Frame& frame : frames_of("room_still")) {
    const FrameResult result = system.track(input_of(frame));
    EXPECT_EQ(result.state, TrackingState::kTracked) << "frame " << result.index;
    EXPECT_TRUE(result.T_world_cam.has_value());
  }
  EXPECT_EQ(system.trajectory().size(), kFrames);
  EXPECT_LT(ate(system, frames_of("room_still")), 0.015);
  EXPECT_GE(system.map().keyframe_count(), 2U);
}

TEST(System, TracksASlowCameraByTheShapeOfTheRoom) {
  for (const bool geometry : {false, true}) {
    SystemOptions options = make_system().options();
    options.geometry = geometry;
    System system(dataset::scene_camera(320, 240), options);
    dataset::SceneOptions scene_options = small_scene();
    scene_options.frames = 300;
    const auto scene = dataset::make_scene("room_still", scene_options);
    std::vector<dataset::Frame> frames;
    for (std::size_t i = 0; i < scene->size(); i += 25) {  // 1.2 Hz
      frames.push_back(scene->read(i));
      EXPECT_EQ(system.track(input_of(frames.back())).state, TrackingState::kTracked) << i;
    }
    EXPECT_LT(ate(system, frames), 0.03);
  }
}

TEST(System, MasksKeepWhatMovesOutOfThePose) {
  System masked = make_system();
  for (const dataset::Frame& frame : frames_of("room_walking")) masked.track(input_of(frame, true));
  EXPECT_EQ(masked.trajectory().size(), kFrames);
  EXPECT_LT(ate(masked, frames_of("room_walking")), 0.02);
}

TEST(System, GeometryKeepsMoversOutOfThePoseWithoutMasks) {
  SystemOptions options = make_system().options();
  System plain(dataset::scene_camera(320, 240), options);
  options.geometry = true;
  options.weights = factors::WeightMode::kEliminated;
  System system(dataset::scene_camera(320, 240), options);
  int moving = 0, wrongly = 0;
  for (const dataset::Frame& frame : frames_of("room_walking")) {
    plain.track(input_of(frame));
    EXPECT_TRUE(system.track(input_of(frame)).T_world_cam.has_value());
    const cv::Mat mask = system.movers().mask;
    ASSERT_EQ(mask.size(), frame.mask.size());
    moving += cv::countNonZero(mask & (frame.mask != 0));
    wrongly += cv::countNonZero(mask & (frame.mask == 0));
  }
  EXPECT_LT(ate(system, frames_of("room_walking")), 0.5 * ate(plain, frames_of("room_walking")));
  EXPECT_GT(moving, 3 * wrongly);
}

// In these rooms someone walks close by from the first frame on. What the first frames show of the
// background differs, so the middle one of them is judged.
TEST(System, GeometryMendsAStartThatFollowedAWalker) {
  std::vector<double> errors;
  for (const std::uint64_t seed : {2U, 3U, 5U}) {
    dataset::SceneOptions scene_options = small_scene();
    scene_options.seed = seed;
    scene_options.frames = 20;
    const auto scene = dataset::make_scene("room_walking", scene_options);
    SystemOptions options = make_system().options();
    options.geometry = true;
    System system(dataset::scene_camera(320, 240), options);
    std::vector<dataset::Frame> frames;
    for (std::size_t i = 0; i < scene->size(); ++i) {
      frames.push_back(scene->read(i));
      EXPECT_TRUE(system.track(input_of(frames.back())).T_world_cam.has_value()) << "frame " << i;
    }
    errors.push_back(ate(system, frames));
  }
  std::sort(errors.begin(), errors.end());
  EXPECT_LT(errors[1], 0.03);
}

TEST(System, MoversHoldTheMaskFittedToTheDepth) {
  SystemOptions options = make_system().options();
  options.geometry = true;
  System system(dataset::scene_camera(320, 240), options);
  int given = 0, found = 0, wrongly = 0;
  for (const dataset::Frame& frame : frames_of("room_walking")) {
    FrameInput input = input_of(frame, true);
    cv::erode(frame.mask != 0, input.mask, cv::Mat::ones(7, 7, CV_8UC1));
    system.track(input);
    const cv::Mat mask = system.movers().mask;
    given += cv::countNonZero(input.mask);
    found += cv::countNonZero(mask & (frame.mask != 0));
    wrongly += cv::countNonZero(mask & (frame.mask == 0));
  }
  EXPECT_GT(found, given);
  EXPECT_LT(wrongly, found / 8);
}

TEST(System, TellsNothingOfMoversWithoutGeometry) {
  System system = make_system();
  for (std::size_t i = 0; i < 3; ++i) system.track(input_of(frames_of("room_walking")[i], true));
  EXPECT_TRUE(system.movers().mask.empty());
  EXPECT_TRUE(system.movers().judged.empty());
}

TEST(System, GeometryTakesNothingInAStillRoomForMoving) {
  SystemOptions options = make_system().options();
  options.geometry = true;
  System system(dataset::scene_camera(320, 240), options);
  double share = 0.0;
  for (const dataset::Frame& frame : frames_of("room_still")) {
    share += static_cast<double>(system.track(input_of(frame)).moving_share) / kFrames;
  }
  EXPECT_LT(share, 0.02);
  EXPECT_LT(ate(system, frames_of("room_still")), 0.015);
}

TEST(System, GeometryJudgesNothingWithoutDepth) {
  SystemOptions options = make_system().options();
  options.geometry = true;
  System system(dataset::scene_camera(320, 240), options);
  const auto& frames = frames_of("room_walking");
  for (std::size_t i = 0; i < 12; ++i) system.track(input_of(frames[i]));
  FrameInput blind = input_of(frames[12]);
  blind.depth.release();
  EXPECT_EQ(system.track(blind).moving_features, 0);
  EXPECT_TRUE(system.track(input_of(frames[13])).T_world_cam.has_value());
}

TEST(System, RejectingMatchesLeavesAStillRoomAsAccurate) {
  SystemOptions options = make_system().options();
  options.reject_matches = true;
  System system(dataset::scene_camera(320, 240), options);
  for (const dataset::Frame& frame : frames_of("room_still")) {
    EXPECT_EQ(system.track(input_of(frame)).state, TrackingState::kTracked);
  }
  EXPECT_LT(ate(system, frames_of("room_still")), 0.015);
}

TEST(System, NoFeatureAndNoMapPointLiesUnderTheMask) {
  System system = make_system();
  const dataset::Frame& frame = frames_of("room_walking")[kFrames - 1];
  const FrameInput input = input_of(frame, true);
  const FrameResult result = system.track(input);
  ASSERT_GT(system.map().point_count(), 0U);
  EXPECT_GT(result.masked_share, 0.0F);
  const DepthCamera camera = dataset::scene_camera(320, 240);
  for (const PointId id : system.map().point_ids()) {
    const Eigen::Vector2d pixel = camera.project(system.map().point(id).position);
    const cv::Point at(static_cast<int>(std::lround(pixel.x())),
                       static_cast<int>(std::lround(pixel.y())));
    EXPECT_EQ(input.mask.at<std::uint8_t>(at), 0);
  }
}

TEST(System, MakesKeyframesOfFramesThatLookNewWhenAskedTo) {
  SystemOptions options = make_system().options();
  options.mapping.max_frames = 1000;
  const auto keyframes_at = [&](double similarity) {
    options.mapping.keyframe_similarity = similarity;
    System system(dataset::scene_camera(320, 240), options);
    for (const dataset::Frame& frame : frames_of("room_still")) system.track(input_of(frame));
    EXPECT_EQ(system.trajectory().size(), kFrames);
    EXPECT_LT(ate(system, frames_of("room_still")), 0.015);
    return system.map().keyframes_made();
  };
  const std::size_t few = keyframes_at(0.3), more = keyframes_at(0.8);
  EXPECT_GE(few, 1U);
  EXPECT_GT(more, few);
}

TEST(System, MakesAKeyframeWhenTooLittleIsLeftOfWhatWasFound) {
  SystemOptions options = make_system().options();
  options.mapping.max_frames = 1000;
  options.mapping.keyframe_share = 0.01;
  const auto keyframes_with_half_hidden = [&](double remaining_share) {
    options.mapping.remaining_share = remaining_share;
    System system(dataset::scene_camera(320, 240), options);
    std::size_t keyframes = 0;
    for (std::size_t i = 0; i < 20; ++i) {
      FrameInput input = input_of(frames_of("room_still")[i]);
      if (i >= 10) {
        input.mask = cv::Mat::zeros(input.image.size(), CV_8UC1);
        input.mask.colRange(0, 160) = 255;
      }
      const FrameResult result = system.track(input);
      EXPECT_EQ(result.state, TrackingState::kTracked) << i;
      if (i >= 10) keyframes += result.keyframe;
    }
    return keyframes;
  };
  EXPECT_EQ(keyframes_with_half_hidden(0.0), 0U);
  EXPECT_GE(keyframes_with_half_hidden(0.8), 1U);
}

TEST(System, TellsWhatBecameOfEveryFeature) {
  SystemOptions options = make_system().options();
  options.geometry = true;
  System system(dataset::scene_camera(320, 240), options);
  EXPECT_EQ(system.features().features, nullptr);
  std::map<FeatureVerdict, int> moving, still;  // by what the truth says
  for (const dataset::Frame& frame : frames_of("room_walking")) {
    const FrameResult result = system.track(input_of(frame));
    const FeaturesView view = system.features();
    ASSERT_NE(view.features, nullptr);
    ASSERT_EQ(view.verdicts.size(), static_cast<std::size_t>(result.features));
    int told = 0;
    for (std::size_t i = 0; i < view.verdicts.size(); ++i) {
      const cv::Point at(view.features->keypoints[i].pt);
      ++(frame.mask.at<std::uint8_t>(at) != 0 ? moving : still)[view.verdicts[i]];
      told += view.verdicts[i] == FeatureVerdict::kMoving;
    }
    EXPECT_EQ(told, result.moving_features);
  }
  EXPECT_GT(moving[FeatureVerdict::kMoving], moving[FeatureVerdict::kStatic]);
  EXPECT_GT(still[FeatureVerdict::kStatic], 10 * still[FeatureVerdict::kMoving]);
}

TEST(System, GivesTheSameBitsTwice) {
  System a = make_system(), b = make_system();
  for (const dataset::Frame& frame : frames_of("room_walking")) {
    a.track(input_of(frame));
    b.track(input_of(frame));
  }
  const Trajectory first = a.trajectory(), second = b.trajectory();
  ASSERT_EQ(first.size(), second.size());
  for (std::size_t i = 0; i < first.size(); ++i) {
    EXPECT_EQ(first[i].T_world_cam.matrix(), second[i].T_world_cam.matrix());
  }
}

TEST(System, IsLostInTheDarkAndFoundAgainInTheLight) {
  System system = make_system();
  const auto& frames = frames_of("room_still");
  for (std::size_t i = 0; i < 20; ++i) system.track(input_of(frames[i]));
  const cv::Mat black = cv::Mat::zeros(240, 320, CV_8UC3);
  for (std::size_t i = 20; i < 24; ++i) {
    FrameInput dark = input_of(frames[i]);
    dark.image = black;
    dark.depth = cv::Mat();
    const FrameResult result = system.track(dark);
    EXPECT_EQ(result.state, TrackingState::kLost);
    EXPECT_FALSE(result.T_world_cam.has_value());
  }
  EXPECT_EQ(system.track(input_of(frames[24])).state, TrackingState::kRelocalized);
  EXPECT_EQ(system.track(input_of(frames[25])).state, TrackingState::kTracked);
  EXPECT_EQ(system.trajectory().size(), 22U);
  EXPECT_LT(ate(system, frames), 0.02);
}

TEST(System, FollowsTheDepthWhileTheImageIsDark) {
  System system = make_system();
  const auto& frames = frames_of("room_still");
  for (std::size_t i = 0; i < 30; ++i) {
    FrameInput input = input_of(frames[i]);
    if (i >= 15 && i < 19) input.image = cv::Mat(240, 320, CV_8UC3, cv::Scalar());
    const FrameResult result = system.track(input);
    EXPECT_EQ(result.state, TrackingState::kTracked) << i;
    // The first light frame has no features before it to go by.
    if (i != 19) {
      EXPECT_EQ(result.depth_aligned, i >= 15 && i < 19) << i;
    }
  }
  EXPECT_LT(ate(system, frames), 0.03);
}

TEST(System, WaitsForAFrameWithDepthBeforeItMakesAMap) {
  System system = make_system();
  const auto& frames = frames_of("room_still");
  FrameInput input = input_of(frames[0]);
  input.depth = cv::Mat();
  EXPECT_EQ(system.track(input).state, TrackingState::kNotInitialized);
  input = input_of(frames[1]);
  input.depth = cv::Mat(240, 320, CV_32FC1, std::numeric_limits<float>::quiet_NaN());
  EXPECT_EQ(system.track(input).state, TrackingState::kNotInitialized);
  EXPECT_EQ(system.map().keyframe_count(), 0U);
  EXPECT_EQ(system.track(input_of(frames[2])).state, TrackingState::kTracked);
}

TEST(System, TracksOnWhileDepthIsMissing) {
  System system = make_system();
  const auto& frames = frames_of("room_still");
  for (std::size_t i = 0; i < 20; ++i) {
    FrameInput input = input_of(frames[i]);
    if (i >= 5 && i < 10) input.depth = cv::Mat();
    EXPECT_EQ(system.track(input).state, TrackingState::kTracked) << i;
  }
}

TEST(System, IsLostWhenEverythingIsMasked) {
  System system = make_system();
  const auto& frames = frames_of("room_still");
  system.track(input_of(frames[0]));
  FrameInput input = input_of(frames[1]);
  input.mask = cv::Mat(240, 320, CV_8UC1, cv::Scalar(255));
  const FrameResult result = system.track(input);
  EXPECT_EQ(result.state, TrackingState::kLost);
  EXPECT_EQ(result.features, 0);
}

TEST(System, StartsAnewWhenItIsLostForGoodRightAfterTheStart) {
  System system = make_system();
  const auto& frames = frames_of("room_still");
  system.track(input_of(frames[0]));
  FrameInput dark{0.0, cv::Mat::zeros(240, 320, CV_8UC3), {}, {}};
  for (int i = 1; i <= 4; ++i) {
    dark.timestamp = i;
    system.track(dark);
  }
  FrameInput late = input_of(frames[40]);
  late.timestamp = 10.0;
  // Its pose is a guess, so nobody may take it for tracked from the pose before.
  EXPECT_EQ(system.track(late).state, TrackingState::kRelocalized);
  EXPECT_EQ(system.trajectory().size(), 2U);
  FrameInput next = input_of(frames[41]);
  next.timestamp = 10.0 + 1.0 / 30.0;
  EXPECT_EQ(system.track(next).state, TrackingState::kTracked);
}

class SystemContract : public ::testing::Test {
 protected:
  // The message of what `change` makes track() throw; and that the system goes on as if nothing
  // had happened.
  template <typename Change>
  std::string message(const Change& change) {
    System system = make_system();
    const auto& frames = frames_of("room_still");
    system.track(input_of(frames[0]));
    FrameInput input = input_of(frames[1]);
    change(input);
    std::string text = "nothing thrown";
    try {
      system.track(input);
    } catch (const InvalidArgument& error) {
      text = error.what();
    }
    EXPECT_EQ(system.track(input_of(frames[1])).index, 1U);
    return text;
  }
};

TEST_F(SystemContract, NamesAnEmptyImage) {
  EXPECT_NE(message([](FrameInput& input) { input.image = cv::Mat(); }).find("image: got 0x0"),
            std::string::npos);
}

TEST_F(SystemContract, NamesAnImageOfAnotherSizeOrType) {
  EXPECT_NE(message([](FrameInput& input) {
              input.image = cv::Mat(10, 20, CV_8UC3);
            }).find("image: got 20x10"),
            std::string::npos);
  EXPECT_NE(message([](FrameInput& input) {
              input.image = cv::Mat(240, 320, CV_16UC1);
            }).find("expected 320x240 CV_8UC3 or CV_8UC1"),
            std::string::npos);
}

TEST_F(SystemContract, NamesDepthAndMaskThatDoNotFit) {
  EXPECT_NE(message([](FrameInput& input) {
              input.depth = cv::Mat(240, 320, CV_16UC1);
            }).find("depth: got 320x240 CV_16UC1"),
            std::string::npos);
  EXPECT_NE(message([](FrameInput& input) {
              input.mask = cv::Mat(120, 160, CV_8UC1);
            }).find("mask: got 160x120"),
            std::string::npos);
}

TEST_F(SystemContract, NamesATimeThatIsNotAfterTheLast) {
  EXPECT_NE(message([](FrameInput& input) { input.timestamp = 0.0; }).find("timestamp"),
            std::string::npos);
  EXPECT_NE(message([](FrameInput& input) { input.timestamp = std::nan(""); }).find("timestamp"),
            std::string::npos);
}

TEST(SystemOptions, EveryRuleIsCheckedByName) {
  const auto message = [](auto change) {
    SystemOptions options;
    change(options);
    try {
      System system(dataset::scene_camera(), options);
    } catch (const InvalidArgument& error) {
      return std::string(error.what());
    }
    return std::string("nothing thrown");
  };
  const auto names = [&](const char* name, auto change) {
    EXPECT_NE(message(change).find(name), std::string::npos) << name;
  };
  names("max_features", [](SystemOptions& o) { o.tracking.orb.max_features = 0; });
  names("max_depth", [](SystemOptions& o) { o.tracking.max_depth = 0; });
  names("virtual_baseline", [](SystemOptions& o) { o.tracking.virtual_baseline = -1; });
  names("frame_radius", [](SystemOptions& o) { o.tracking.frame_radius = -1; });
  names("map_radius", [](SystemOptions& o) { o.tracking.map_radius = std::nan(""); });
  names("min_inliers", [](SystemOptions& o) { o.tracking.min_inliers = 3; });
  names("min_relocalization_inliers",
        [](SystemOptions& o) { o.tracking.min_relocalization_inliers = 1; });
  names("local_keyframes", [](SystemOptions& o) { o.tracking.local_keyframes = 0; });
  names("keyframe_share", [](SystemOptions& o) { o.mapping.keyframe_share = 1.5; });
  names("remaining_share", [](SystemOptions& o) { o.mapping.remaining_share = 1; });
  names("max_frames", [](SystemOptions& o) { o.mapping.max_frames = 0; });
  names("min_frames", [](SystemOptions& o) { o.mapping.min_frames = -1; });
  names("bundle_keyframes", [](SystemOptions& o) { o.mapping.bundle_keyframes = 0; });
  names("min_found_share", [](SystemOptions& o) { o.mapping.min_found_share = 2; });
  names("redundant_share", [](SystemOptions& o) { o.mapping.redundant_share = 0; });
  EXPECT_THROW(System(DepthCamera{}), InvalidArgument);
}

}  // namespace
}  // namespace dynslam::slam
