// Against published recordings; skipped where they are not.
#include <algorithm>
#include <cstdlib>
#include <filesystem>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "dynslam/dataset/readers.hpp"

namespace dynslam::dataset {
namespace {

namespace fs = std::filesystem;

fs::path data_folder(const char* name) {
  const char* root = std::getenv("DYNSLAM_DATA");
  return fs::path(root != nullptr ? root : DYNSLAM_DEFAULT_DATA_DIR) / name;
}

#define DYNSLAM_NEED(folder)                                                              \
  if (!fs::exists(folder)) {                                                              \
    GTEST_SKIP() << "no " << (folder) << "; set DYNSLAM_DATA to the folder of data sets"; \
  }

TEST(RealData, KitchenStaticIs350FramesOf640By480With15Hertz) {
  const fs::path folder = data_folder("kitchen_static");
  DYNSLAM_NEED(folder);
  const auto sequence = open_sequence(folder);
  ASSERT_EQ(sequence->size(), 350U);
  EXPECT_EQ(sequence->sensor(), SensorKind::kRgbd);
  EXPECT_EQ(sequence->fps(), 15.0);
  EXPECT_EQ(sequence->camera().fx, 525.0);
  EXPECT_EQ(sequence->camera().bf, 40.0);
  EXPECT_EQ(sequence->truth().size(), 350U);
  for (const std::size_t i : {0U, 175U, 349U}) {
    const Frame frame = sequence->read(i);
    EXPECT_EQ(frame.color.size(), cv::Size(640, 480));
    EXPECT_EQ(frame.color.type(), CV_8UC3);
    ASSERT_TRUE(frame.T_world_cam);
    EXPECT_EQ(frame.T_world_cam->t, sequence->truth()[i].T_world_cam.t);
    double most = 0.0;
    cv::minMaxLoc(frame.depth, nullptr, &most);
    EXPECT_GT(most, 1.0);
    EXPECT_LT(most, 13.2);
    EXPECT_GT(cv::countNonZero(frame.depth), 640 * 480 / 3);
  }
}

TEST(RealData, KitchenTruthInterpolatesCloseToThePoseLeftOut) {
  const fs::path folder = data_folder("kitchen_static");
  DYNSLAM_NEED(folder);
  const auto sequence = open_sequence(folder);
  double worst = 0.0;
  for (std::size_t i = 1; i + 1 < sequence->truth().size(); ++i) {
    const Trajectory around = {sequence->truth()[i - 1], sequence->truth()[i + 1]};
    const StampedPose& left_out = sequence->truth()[i];
    const auto pose = pose_at(around, left_out.timestamp);
    ASSERT_TRUE(pose);
    worst = std::max(worst, (pose->t - left_out.T_world_cam.t).norm());
  }
  EXPECT_LT(worst, 0.03);  // a hand does not jump 3 cm between two frames
  EXPECT_GT(worst, 0.0);
}

TEST(RealData, KitchenWalkingHasLabelsOfPersonAndPanel) {
  const fs::path folder = data_folder("kitchen_walking");
  DYNSLAM_NEED(folder);
  const auto sequence = open_sequence(folder);
  ASSERT_EQ(sequence->size(), 240U);
  int people = 0, panels = 0;
  for (std::size_t i = 0; i < sequence->size(); i += 40) {
    const cv::Mat mask = sequence->read(i).mask;
    ASSERT_EQ(mask.size(), cv::Size(640, 480));
    people += cv::countNonZero(mask == 1);
    panels += cv::countNonZero(mask == 2);
    EXPECT_EQ(cv::countNonZero(mask > 2), 0);
  }
  EXPECT_GT(people, 1000);
  EXPECT_GT(panels, 1000);
}

TEST(RealData, Fr3CabinetHasItsOwnCameraFile) {
  const fs::path folder = data_folder("fr3_cabinet");
  DYNSLAM_NEED(folder);
  const auto sequence = open_sequence(folder);
  EXPECT_EQ(sequence->size(), 58U);
  EXPECT_EQ(sequence->camera().fy, 539.2);
  EXPECT_EQ(sequence->fps(), 1.5);
  for (std::size_t i = 0; i < sequence->size(); ++i) {
    const Frame frame = sequence->read(i);
    EXPECT_EQ(frame.color.size(), cv::Size(640, 480));
    EXPECT_EQ(frame.depth.size(), cv::Size(640, 480));
    EXPECT_TRUE(frame.T_world_cam) << i;
  }
}

TEST(RealData, Kitti06StartDrivesForward) {
  const fs::path folder = data_folder("kitti_06_start");
  DYNSLAM_NEED(folder);
  const auto sequence = open_sequence(folder);
  ASSERT_EQ(sequence->size(), 51U);
  EXPECT_EQ(sequence->sensor(), SensorKind::kMono);
  EXPECT_EQ(sequence->camera().width, 1226);
  EXPECT_EQ(sequence->camera().height, 370);
  EXPECT_DOUBLE_EQ(sequence->camera().fx, 707.0912);
  EXPECT_EQ(sequence->truth().size(), 51U);
  const Frame last = sequence->read(50);
  EXPECT_EQ(last.color.type(), CV_8UC1);
  EXPECT_GT(last.T_world_cam->t.z(), 30.0);
}

}  // namespace
}  // namespace dynslam::dataset
