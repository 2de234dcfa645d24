#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/scene.hpp"
#include "dynslam/slam/map_io.hpp"
#include "dynslam/slam/system.hpp"

#include "slam/map_check.hpp"
#include "temp_folder.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kFrames = 60;

SystemOptions small_options(bool localize_only) {
  SystemOptions options;
  options.tracking.orb.max_features = 600;
  options.tracking.orb.levels = 4;
  options.localize_only = localize_only;
  return options;
}

DepthCamera camera() { return dataset::scene_camera(320, 240); }

// A map of the room and the frames it was made from, made once.
struct Recording {
  std::vector<dataset::Frame> frames;
  std::string map;

  Recording() {
    dataset::SceneOptions options;
    options.camera = camera();
    options.frames = kFrames;
    const auto scene = dataset::make_scene("room_still", options);
    System system(camera(), small_options(false));
    for (std::size_t i = 0; i < kFrames; ++i) {
      frames.push_back(scene->read(i));
      system.track({frames[i].timestamp, frames[i].color, frames[i].depth, {}});
    }
    const std::string path = dynslam::testing::temp_path("localization.map");
    system.save_map(path);
    StoredMap stored = load_map(path);
    map = serialize_map(stored.map, stored.camera, stored.scale_factors);
  }
  StoredMap load() const {
    return parse_map({reinterpret_cast<const std::uint8_t*>(map.data()), map.size()});
  }
};

const Recording& recording() {
  static const Recording made;
  return made;
}

FrameInput input(std::size_t i) {
  const dataset::Frame& frame = recording().frames[i];
  return {frame.timestamp, frame.color, frame.depth, {}};
}

double error_at(const FrameResult& result) {
  const auto& frames = recording().frames;
  const RigidTransform truth = frames[0].T_world_cam->inverse() *
                               *frames[static_cast<std::size_t>(result.index)].T_world_cam;
  return (truth.t - result.T_world_cam->t).norm();
}

std::string bytes_of(const System& system) {
  const StoredMap stored = recording().load();
  return serialize_map(system.map(), stored.camera, stored.scale_factors);
}

TEST(Localization, FindsItselfInALoadedMapWithinFiveFramesWhereverItStarts) {
  for (const std::size_t first : {0U, 20U, 45U}) {
    System system(camera(), small_options(true));
    system.start_from(recording().load());
    std::size_t frames = 0;
    while (frames < 10 && !system.track(input(first + frames)).T_world_cam) ++frames;
    EXPECT_LT(frames, 5U) << "from frame " << first;
  }
}

TEST(Localization, IsLostUntilItIsFoundAndThenTracksInTheWorldOfTheMap) {
  System system(camera(), small_options(true));
  system.start_from(recording().load());
  FrameInput dark = input(0);
  dark.image = cv::Mat(240, 320, CV_8UC3, cv::Scalar());  // no MatExpr: it writes in place
  EXPECT_EQ(system.track(dark).state, TrackingState::kLost);
  EXPECT_EQ(system.track(input(1)).state, TrackingState::kRelocalized);
  for (std::size_t i = 2; i < kFrames; ++i) {
    const FrameResult result = system.track(input(i));
    ASSERT_EQ(result.state, TrackingState::kTracked) << i;
    EXPECT_LT(error_at(result), 0.03) << i;
    EXPECT_FALSE(result.keyframe);
  }
  EXPECT_EQ(system.trajectory().size(), kFrames - 1);
  EXPECT_TRUE(system.keyframe_trajectory().empty());
}

TEST(Localization, LeavesTheMapAsItIs) {
  System system(camera(), small_options(true));
  system.start_from(recording().load());
  for (std::size_t i = 0; i < kFrames; ++i) system.track(input(i));
  EXPECT_EQ(bytes_of(system), recording().map);
}

TEST(Localization, HasNoPoseWithoutAMap) {
  System system(camera(), small_options(true));
  EXPECT_EQ(system.track(input(0)).state, TrackingState::kNotInitialized);
  EXPECT_EQ(system.map().keyframe_count(), 0U);
}

TEST(Localization, MappingGoesOnInALoadedMap) {
  System system(camera(), small_options(false));
  system.start_from(recording().load());
  const std::size_t made = system.map().keyframes_made();
  for (std::size_t i = 0; i < kFrames; ++i) {
    const FrameResult result = system.track(input(i));
    ASSERT_TRUE(result.T_world_cam.has_value()) << i;
    EXPECT_LT(error_at(result), 0.03) << i;
  }
  EXPECT_GT(system.map().keyframes_made(), made);
  EXPECT_EQ(testing::problem_of(system.map()), "");
  for (const StampedPose& pose : system.keyframe_trajectory()) EXPECT_GE(pose.timestamp, 0.0);
}

TEST(Localization, AMapThatDoesNotSuitIsRefusedByName) {
  const auto message = [](System system, StoredMap stored) -> std::string {
    try {
      system.start_from(std::move(stored));
    } catch (const InvalidArgument& error) {
      EXPECT_EQ(system.map().keyframe_count(), 0U);
      return error.what();
    }
    return "";
  };
  const auto says = [](const std::string& text, const char* what) {
    EXPECT_NE(text.find(what), std::string::npos) << text;
  };
  StoredMap other = recording().load();
  other.camera.fx = 999.0;
  says(message(System(camera(), small_options(true)), other),
       "the map's camera: got 320x240, fx 999");
  SystemOptions levels = small_options(true);
  levels.tracking.orb.levels = 6;
  says(message(System(camera(), levels), recording().load()), "4 pyramid levels");
  says(message(System(camera(), small_options(true)), StoredMap{camera(), {1.0F}, Map()}),
       "no keyframes");
  System running(camera(), small_options(false));
  running.track(input(0));
  EXPECT_THROW(running.start_from(recording().load()), InvalidArgument);
}

TEST(Localization, RightColumnsFollowTheBaselineOfTheOptions) {
  SystemOptions options = small_options(true);
  options.tracking.virtual_baseline = 0.5;
  System system(camera(), options);
  system.start_from(recording().load());
  const KeyframeId first = system.map().keyframe_ids().front();
  const FrameFeatures& features = *system.map().keyframe(first).features;
  for (std::size_t i = 0; i < features.size(); ++i) {
    if (!(features.depths[i] > 0.0F)) continue;
    const double shift = 0.5 * camera().fx / features.depths[i];
    EXPECT_NEAR(features.right_columns[i], features.keypoints[i].pt.x - shift, 1e-3);
  }
  EXPECT_TRUE(system.track(input(0)).T_world_cam.has_value());
}

}  // namespace
}  // namespace dynslam::slam
