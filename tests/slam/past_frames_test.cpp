#include "slam/past_frames.hpp"

#include <cmath>
#include <memory>
#include <optional>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/dataset/scene.hpp"
#include "dynslam/slam/compositions.hpp"
#include "dynslam/slam/system.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kFrames = 60;  // 2 s
constexpr std::size_t kFirst = 8;    // frames in which walkers come to light

DepthCamera camera() { return dataset::scene_camera(640, 480); }

// Poses T_world_cam of the first frames: as they were told at once, as the trajectory has them in
// the end, and the truth.
struct Beginning {
  std::vector<RigidTransform> told, revised, truth;
};

Beginning track_beginning(unsigned seed) {
  dataset::SceneOptions scene_options;
  scene_options.camera = camera();
  scene_options.frames = kFrames;
  scene_options.seed = seed;
  const auto scene = dataset::make_scene("room_walking", scene_options);
  System system(camera(), composition("p-static").options);
  Beginning beginning;
  for (std::size_t i = 0; i < kFrames; ++i) {
    const dataset::Frame frame = scene->read(i);
    const FrameResult result = system.track({frame.timestamp, frame.color, frame.depth, {}});
    EXPECT_TRUE(result.T_world_cam.has_value()) << i;
    if (i > kFirst || !result.T_world_cam) continue;
    beginning.told.push_back(*result.T_world_cam);
    beginning.truth.push_back(*frame.T_world_cam);
  }
  for (const auto& pose : system.trajectory()) beginning.revised.push_back(pose.T_world_cam);
  return beginning;
}

// Root mean square distance from where the camera was, seen from the first frame, metres.
double error(const std::vector<RigidTransform>& poses, const std::vector<RigidTransform>& truth) {
  double sum = 0.0;
  for (std::size_t i = 1; i <= kFirst; ++i) {
    const RigidTransform moved = poses[0].inverse() * poses[i];
    sum += (moved.t - (truth[0].inverse() * truth[i]).t).squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(kFirst));
}

// Who walks is not known when a map begins; the poses of those frames know of it in the end.
TEST(PastFrames, ABeginningAmongWalkersIsMendedAfterwards) {
  for (const unsigned seed : {1U, 4U}) {
    const Beginning beginning = track_beginning(seed);
    ASSERT_EQ(beginning.told.size(), kFirst + 1);
    ASSERT_EQ(beginning.revised.size(), kFrames);
    const double told = error(beginning.told, beginning.truth);
    EXPECT_GT(told, 0.002) << "seed " << seed << ": nothing to mend";
    EXPECT_LT(error(beginning.revised, beginning.truth), 0.5 * told) << "seed " << seed;
  }
}

class PastFramesTest : public ::testing::Test {
 protected:
  PastFramesTest() {
    Keyframe keyframe;
    keyframe.features = std::make_shared<FrameFeatures>();
    keyframe.T_cam_world.t = {0.0, 0.0, 1.0};
    reference_ = map_.add_keyframe(keyframe);
    log_.reference = reference_;
    frame_.reset(std::make_shared<FrameFeatures>(), 0.5);
    pose_.t = {0.1, 0.2, 0.3};
    log_.add(map_, 0.5, pose_);
    log_.add(map_, 0.6, std::nullopt);
  }
  Map map_;
  FrameLog log_;
  KeyframeId reference_ = kNoId;
  TrackedFrame frame_;
  RigidTransform pose_;  // T_cam_world of the first frame
};

TEST_F(PastFramesTest, TheLogTakesAnotherPose) {
  EXPECT_EQ(log_.reference_of(0), reference_);
  EXPECT_EQ(log_.reference_of(1), kNoId);
  EXPECT_FALSE(log_.pose(map_, 1).has_value());
  RigidTransform better = pose_;
  better.t.x() = 0.5;
  log_.set_pose(map_, 0, better);
  EXPECT_LT((log_.pose(map_, 0)->t - better.t).norm(), 1e-12);
  // It hangs on the keyframe still.
  map_.keyframe(reference_).T_cam_world.t.z() += 1.0;
  EXPECT_LT((log_.pose(map_, 0)->t - better.t - Eigen::Vector3d(0, 0, 1)).norm(), 1e-12);
}

TEST_F(PastFramesTest, AFrameOfWhichTooLittleIsKnownKeepsItsPose) {
  Tracker tracker(camera(), composition("p-static").options, std::vector<float>(8, 1.0F));
  PastFrames past;
  past.begin(0.0);
  past.add(frame_, {}, 0);
  past.add(frame_, {}, 1);  // lost
  past.revise(1.0, map_, tracker, log_);
  past.revise(10.0, map_, tracker, log_);
  EXPECT_LT((log_.pose(map_, 0)->t - pose_.t).norm(), 1e-12);
  EXPECT_FALSE(log_.pose(map_, 1).has_value());
}

}  // namespace
}  // namespace dynslam::slam
