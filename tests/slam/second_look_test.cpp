#include "slam/second_look.hpp"

#include <memory>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "dynslam/core/so3.hpp"
#include "dynslam/dataset/scene.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kLater = 12;  // frames at 30 Hz: 0.4 s
constexpr LastKeyframe kFirst{7, 1};

DepthCamera camera() { return dataset::scene_camera(320, 240); }

// People walk before the camera from the first frame on.
dataset::Frame room(std::size_t index) {
  static const auto scene = [] {
    dataset::SceneOptions options;
    options.camera = camera();
    options.frames = kLater + 1;
    options.seed = 2;
    return dataset::make_scene("room_walking", options);
  }();
  return scene->read(index);
}

TrackedFrame tracked(const dataset::Frame& frame, const RigidTransform& T_cam_world) {
  TrackedFrame result;
  result.reset(std::make_shared<FrameFeatures>(), frame.timestamp);
  result.T_cam_world = T_cam_world;
  result.depth = frame.depth;
  return result;
}

// What a walker who is followed makes of a camera at rest: 0.5 m aside, turned back to the scene.
RigidTransform captured() { return se3_exp((Vector6d() << 0.5, 0, 0, 0, -0.13, 0).finished()); }

class SecondLookTest : public ::testing::Test {
 protected:
  SecondLookTest() : first_(room(0)), later_(room(kLater)), check_(camera()) {
    TrackedFrame first = tracked(first_, RigidTransform());
    check_.begin(first, kFirst);
    truth_ = later_.T_world_cam->inverse() * *first_.T_world_cam;
  }
  dataset::Frame first_, later_;
  SecondLook check_;
  RigidTransform truth_;  // T_cam_world of the later frame
};

TEST_F(SecondLookTest, TakesTheBackgroundsMotionInsteadOfTheMovers) {
  TrackedFrame frame = tracked(later_, captured() * truth_);
  const RigidTransform motions[] = {captured(), truth_.inverse()};
  const auto corrected = check_.contradict(motions, frame);
  ASSERT_TRUE(corrected.has_value());
  EXPECT_LT((corrected->t - truth_.t).norm(), 1e-9);
}

TEST_F(SecondLookTest, IsLeftAloneWhereItWasRight) {
  TrackedFrame frame = tracked(later_, truth_);
  const RigidTransform motions[] = {captured(), (captured() * truth_).inverse()};
  EXPECT_FALSE(check_.contradict(motions, frame).has_value());
}

TEST_F(SecondLookTest, FindsTheBackgroundsMotionByDepthWhereFeaturesDoNot) {
  const Vector6d aside = 0.15 * Vector6d::Unit(0);
  TrackedFrame frame = tracked(later_, se3_exp(aside) * truth_);
  const auto corrected = check_.contradict({}, frame);
  ASSERT_TRUE(corrected.has_value());
  EXPECT_LT((corrected->t - truth_.t).norm(), 0.02);
  EXPECT_LT(so3_log(corrected->R * truth_.R.transpose()).norm(), 0.01);
}

TEST_F(SecondLookTest, IsLeftAloneWhereTheTwoFramesShareNoSurface) {
  TrackedFrame frame = tracked(later_, captured() * truth_);
  frame.depth.setTo(0.5F);  // a hand over the lens
  const RigidTransform motions[] = {truth_.inverse()};
  EXPECT_FALSE(check_.contradict(motions, frame).has_value());
}

TEST_F(SecondLookTest, IsLookedAtTwiceAndNotLate) {
  const double began = first_.timestamp;
  EXPECT_FALSE(check_.is_due(began + 0.1));
  EXPECT_TRUE(check_.is_due(began + 0.2));
  EXPECT_FALSE(check_.is_due(began + 1.0));
  TrackedFrame frame = tracked(later_, truth_);
  check_.contradict({}, frame);
  EXPECT_FALSE(check_.is_due(began + 0.2));
  EXPECT_TRUE(check_.is_due(began + 0.4));
  check_.contradict({}, frame);
  EXPECT_FALSE(check_.is_due(began + 0.4));
}

TEST_F(SecondLookTest, GoesOnFromALaterFrameOnce) {
  constexpr LastKeyframe kLast{9, 3};
  TrackedFrame later = tracked(later_, truth_);
  check_.begin_anew(later, kLast);
  EXPECT_EQ(check_.keyframe().id, kLast.id);
  const double began = later_.timestamp;
  EXPECT_FALSE(check_.is_due(began + 0.1));
  EXPECT_TRUE(check_.is_due(began + 0.2));
  EXPECT_FALSE(check_.is_over(began + 0.2));
  check_.contradict({}, later);
  EXPECT_TRUE(check_.is_over(began + 0.2));
  TrackedFrame blind = tracked(later_, truth_);
  blind.depth.release();
  check_.begin_anew(blind, kLast);
  EXPECT_TRUE(check_.is_over(began)) << "nothing to look back at";
}

TEST_F(SecondLookTest, IsNotInQuestionOnceCancelledOrWithoutDepth) {
  check_.cancel();
  EXPECT_FALSE(check_.is_due(first_.timestamp + 0.2));
  dataset::Frame blind = first_;
  blind.depth.release();
  TrackedFrame first = tracked(blind, RigidTransform());
  check_.begin(first, kFirst);
  EXPECT_FALSE(check_.is_due(first_.timestamp + 0.2));
}

TEST_F(SecondLookTest, IsFilledInEvenlyUpToTheCorrection) {
  const RigidTransform corrected = captured();
  const auto at = [&](double share) {
    return check_.between(first_.timestamp + 0.4 * share, first_.timestamp + 0.4, corrected);
  };
  EXPECT_LT(se3_log(at(0.0)).norm(), 1e-9);
  EXPECT_LT((se3_log(at(0.5)) - 0.5 * se3_log(corrected)).norm(), 1e-9);
  EXPECT_LT((at(1.0).t - corrected.t).norm(), 1e-9);
}

}  // namespace
}  // namespace dynslam::slam
