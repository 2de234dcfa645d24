#include "slam/mover_detector.hpp"

#include <cstdint>
#include <memory>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "slam/frame_images.hpp"
#include "slam/vga_camera.hpp"

namespace dynslam::slam {
namespace {

constexpr float kWall = 3.0F;  // metres

// The camera stands still before a wall; frames are 0.5 s apart.
class MoverDetectorTest : public ::testing::Test {
 protected:
  MoverDetectorTest() : detector_(depth_camera()) {}

  static DepthCamera depth_camera() {
    DepthCamera depth_camera;
    static_cast<PinholeCamera&>(depth_camera) = camera();
    return depth_camera;
  }
  static cv::Mat wall() { return {480, 640, CV_32FC1, cv::Scalar(kWall)}; }

  // A painted cloth over the whole image, `slid` cells to the right of where it hung first.
  static cv::Mat painted_cells(int slid) {
    cv::Mat cells(480 / kSurfaceCell, 640 / kSurfaceCell, CV_8UC1);
    for (int y = 0; y < cells.rows; ++y) {
      for (int x = 0; x < cells.cols; ++x) {
        const auto patch = static_cast<std::uint32_t>(x - slid) * 2654435761U +
                           static_cast<std::uint32_t>(y) * 2246822519U;
        cells.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>((patch ^ patch >> 15) >> 24);
      }
    }
    return cells;
  }

  // Judges the next frame, with `mask` unless it is empty, and keeps it as a reference.
  cv::Mat show(const cv::Mat& depth, const cv::Mat& mask = {}, const cv::Mat& gray_cells = {}) {
    TrackedFrame frame;
    frame.reset(std::make_shared<FrameFeatures>(), time_ += 0.5);
    frame.gray = cv::Mat(depth.size(), CV_8UC1, cv::Scalar(128));
    frame.gray_cells = gray_cells;
    if (gray_cells.empty()) {
      frame.gray_cells = cv::Mat(depth.size() / kSurfaceCell, CV_8UC1, cv::Scalar(128));
    }
    frame.mask = mask;
    if (mask.empty()) {
      frame.depth = depth;
    } else {
      split_depth(depth, mask, frame.depth, frame.hidden_depth);
    }
    detector_.detect(frame, {});
    detector_.remember(frame);
    return detector_.complete(frame, {});
  }

  static double share(const cv::Mat& mask, const cv::Rect& of) {
    return cv::countNonZero(mask(of)) / static_cast<double>(of.area());
  }

  MoverDetector detector_;
  double time_ = 0.0;
};

// A mover under a mask, and beside it something of which nothing is known, `step` of the mover's
// depth behind it. How much of the latter is said to move?
class MoverBesideSomething : public MoverDetectorTest {
 protected:
  double told_of_neighbour(float step) {
    const cv::Rect mover(200, 160, 120, 160), neighbour(320, 160, 60, 160);
    cv::Mat before = wall(), now = wall(), mask = cv::Mat::zeros(480, 640, CV_8UC1);
    before(mover | neighbour).setTo(0.0F);  // too dark to be measured, say
    for (int i = 0; i < 6; ++i) show(before);
    now(mover).setTo(2.0F);
    now(neighbour).setTo(2.0F * (1.0F + step));
    mask(mover).setTo(255);
    const cv::Mat found = show(now, mask);
    EXPECT_GT(share(found, mover), 0.95);
    return share(found, neighbour);
  }
};

TEST_F(MoverBesideSomething, AStepOfTwoPercentOfDepthMakesTwoSurfaces) {
  EXPECT_LT(told_of_neighbour(0.02F), 0.05);
}

TEST_F(MoverBesideSomething, AStepOfOnePercentOfDepthLeavesOneSurface) {
  EXPECT_GT(told_of_neighbour(0.01F), 0.95);
}

TEST_F(MoverDetectorTest, AMaskOverWhatWasThereAllTheTimeIsNotBelieved) {
  const cv::Rect picture(200, 160, 120, 160);  // of a person
  cv::Mat mask = cv::Mat::zeros(480, 640, CV_8UC1);
  mask(picture).setTo(255);
  EXPECT_GT(share(show(wall(), mask), picture), 0.9);
  for (int i = 0; i < 12; ++i) show(wall());
  EXPECT_EQ(cv::countNonZero(show(wall(), mask)), 0);
}

TEST_F(MoverDetectorTest, AMaskOverWhatHasJustArrivedIsBelieved) {
  const cv::Rect person(200, 160, 120, 160);
  cv::Mat now = wall(), mask = cv::Mat::zeros(480, 640, CV_8UC1);
  for (int i = 0; i < 12; ++i) show(wall());
  now(person).setTo(2.0F);
  mask(person).setTo(255);
  const cv::Mat found = show(now, mask);
  EXPECT_GT(share(found, person), 0.99);
  EXPECT_LT(cv::countNonZero(found), 1.05 * person.area());
}

TEST_F(MoverDetectorTest, WhatSlidesWithinItsPlaneIsToldByItsLooksAlone) {
  const cv::Rect curtain(200, 160, 160, 160);
  cv::Mat depth = wall();
  depth(curtain).setTo(2.0F);
  const cv::Rect cells(curtain.x / kSurfaceCell, curtain.y / kSurfaceCell,
                       curtain.width / kSurfaceCell, curtain.height / kSurfaceCell);
  cv::Mat gray_cells = painted_cells(0);
  cv::Mat found;
  for (int i = 0; i < 6; ++i) found = show(depth, {}, gray_cells);
  EXPECT_EQ(cv::countNonZero(found), 0);
  for (int i = 1; i <= 6; ++i) {
    gray_cells = painted_cells(0);
    painted_cells(2 * i)(cells).copyTo(gray_cells(cells));
    found = show(depth, {}, gray_cells);
  }
  EXPECT_EQ(cv::countNonZero(detector_.mask()), 0);
  EXPECT_GT(share(found, curtain), 0.9);
  EXPECT_LT(cv::countNonZero(found), 1.1 * curtain.area());
}

// Where somebody masks people, what tracking itself finds looks at a quarter of the cells.
TEST_F(MoverDetectorTest, WhatSlidesBesideAMaskIsLetGoOfByTracking) {
  const cv::Rect curtain(200, 160, 160, 160), person(400, 160, 80, 240);
  cv::Mat depth = wall(), mask = cv::Mat::zeros(480, 640, CV_8UC1);
  depth(curtain).setTo(2.0F);
  depth(person).setTo(2.0F);
  mask(person).setTo(255);
  const cv::Rect cells(curtain.x / kSurfaceCell, curtain.y / kSurfaceCell,
                       curtain.width / kSurfaceCell, curtain.height / kSurfaceCell);
  const auto boldly_painted = [](int slid) {
    cv::Mat bold;
    const cv::Mat fine = painted_cells(slid);
    cv::resize(fine(cv::Rect(0, 0, fine.cols / 4, fine.rows / 4)), bold, fine.size(), 0, 0,
               cv::INTER_NEAREST);
    return bold;
  };
  for (int i = 0; i < 6; ++i) show(depth, mask, boldly_painted(0));
  EXPECT_EQ(cv::countNonZero(detector_.mask()), 0);
  for (int i = 1; i <= 12; ++i) {
    cv::Mat gray_cells = boldly_painted(0);
    boldly_painted(i)(cells).copyTo(gray_cells(cells));
    show(depth, mask, gray_cells);
  }
  EXPECT_GT(share(detector_.mask(), curtain), 0.9);
  EXPECT_LT(cv::countNonZero(detector_.mask()), 1.2 * curtain.area());
}

TEST_F(MoverDetectorTest, MasksGoWithImagesThatAreNoMultipleOfItsCells) {
  for (const cv::Size size : {cv::Size(636, 476), cv::Size(641, 483), cv::Size(644, 485)}) {
    DepthCamera odd = depth_camera();
    odd.width = size.width;
    odd.height = size.height;
    MoverDetector detector(odd);
    TrackedFrame frame;
    for (int i = 0; i < 3; ++i) {
      frame.reset(std::make_shared<FrameFeatures>(), 0.5 * i);
      frame.gray = cv::Mat(size, CV_8UC1, cv::Scalar(128));
      frame.gray_cells = cv::Mat(size / kSurfaceCell, CV_8UC1, cv::Scalar(128));
      frame.mask = cv::Mat::zeros(size, CV_8UC1);
      split_depth(cv::Mat(size, CV_32FC1, cv::Scalar(kWall)), frame.mask, frame.depth,
                  frame.hidden_depth);
      detector.detect(frame, {});
      detector.remember(frame);
      EXPECT_EQ(cv::countNonZero(detector.complete(frame, {})), 0);
    }
  }
}

}  // namespace
}  // namespace dynslam::slam
