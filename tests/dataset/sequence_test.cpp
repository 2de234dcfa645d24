#include "dynslam/dataset/sequence.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "dynslam/dataset/readers.hpp"

#include "dataset/tiny_folders.hpp"

namespace dynslam::dataset {
namespace {

using testing::TempFolder;

Trajectory two_poses() {
  Vector6d twist;
  twist << 1.0, 0.0, 0.0, 0.0, 0.0, 0.5;
  return {{10.0, RigidTransform()}, {10.1, se3_exp(twist)}};
}

TEST(PoseAt, ReturnsTheStoredPoseAtItsTime) {
  const Trajectory truth = two_poses();
  const auto pose = pose_at(truth, 10.1 + 4e-7);
  ASSERT_TRUE(pose);
  EXPECT_EQ(pose->R, truth[1].T_world_cam.R);
  EXPECT_EQ(pose->t, truth[1].T_world_cam.t);
  EXPECT_TRUE(pose_at(truth, 10.0 - 4e-7));
}

TEST(PoseAt, GoesAlongTheScrewBetweenTwoPoses) {
  const Trajectory truth = two_poses();
  const auto pose = pose_at(truth, 10.025);
  ASSERT_TRUE(pose);
  Vector6d quarter;
  quarter << 0.25, 0.0, 0.0, 0.0, 0.0, 0.125;
  EXPECT_LT(se3_log(se3_exp(quarter).inverse() * *pose).norm(), 1e-9);
}

TEST(PoseAt, KnowsNothingOutsideTheTruthOrInAGap) {
  const Trajectory truth = two_poses();
  EXPECT_FALSE(pose_at(truth, 9.99));
  EXPECT_FALSE(pose_at(truth, 10.11));
  EXPECT_FALSE(pose_at(truth, 10.05, 0.09));
  EXPECT_TRUE(pose_at(truth, 10.05, 0.11));
  EXPECT_FALSE(pose_at(truth, std::nan("")));
  EXPECT_FALSE(pose_at({}, 10.0));
}

TEST(Slice, ShowsAPartWithIndicesOfItsOwn) {
  TempFolder folder;
  testing::write_tiny_tum(folder.path(), 5);
  const auto whole = open_tum(folder.path());
  const auto part = slice(open_tum(folder.path()), 2, 4);
  EXPECT_EQ(part->size(), 2U);
  EXPECT_EQ(part->timestamp(0), whole->timestamp(2));
  EXPECT_EQ(part->frame_name(1), whole->frame_name(3));
  const Frame frame = part->read(1);
  EXPECT_EQ(frame.index, 1U);
  EXPECT_EQ(frame.T_world_cam->t.x(), 3.0);
  EXPECT_EQ(part->truth().size(), 5U);
  EXPECT_EQ(part->camera().fx, whole->camera().fx);
  EXPECT_EQ(part->sensor(), SensorKind::kRgbd);
  EXPECT_EQ(part->fps(), 20.0);
  EXPECT_THROW(part->read(2), InvalidArgument);
  EXPECT_THROW(part->timestamp(2), InvalidArgument);
  EXPECT_THROW(part->frame_name(2), InvalidArgument);
}

TEST(Slice, EndsWithTheSequenceAndRefusesAnEmptyPart) {
  TempFolder folder;
  testing::write_tiny_tum(folder.path(), 3);
  EXPECT_EQ(slice(open_tum(folder.path()), 1)->size(), 2U);
  EXPECT_EQ(slice(open_tum(folder.path()), 1, 100)->size(), 2U);
  EXPECT_THROW(slice(open_tum(folder.path()), 3), InvalidArgument);
  EXPECT_THROW(slice(open_tum(folder.path()), 2, 2), InvalidArgument);
  EXPECT_THROW(slice(nullptr, 0), InvalidArgument);
}

TEST(SensorKind, HasANameOfEachKind) {
  EXPECT_STREQ(to_string(SensorKind::kMono), "mono");
  EXPECT_STREQ(to_string(SensorKind::kRgbd), "rgbd");
  EXPECT_STREQ(to_string(SensorKind::kStereo), "stereo");
}

}  // namespace
}  // namespace dynslam::dataset
