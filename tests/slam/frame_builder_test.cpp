#include "slam/frame_builder.hpp"

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "dynslam/dataset/scene.hpp"

namespace dynslam::slam {
namespace {

// Corners everywhere, more than any frame is asked for.
cv::Mat crowded_image() {
  cv::RNG random(3);
  cv::Mat image(480, 640, CV_8UC1);
  random.fill(image, cv::RNG::UNIFORM, 0, 256);
  cv::GaussianBlur(image, image, {5, 5}, 1.0);
  return image;
}

SystemOptions with_geometry(bool geometry) {
  SystemOptions options;
  options.geometry = geometry;
  return options;
}

int features_within(const FrameFeatures& features, const cv::Rect& area) {
  int count = 0;
  for (const cv::KeyPoint& keypoint : features.keypoints) {
    count += area.contains({cvRound(keypoint.pt.x), cvRound(keypoint.pt.y)});
  }
  return count;
}

FrameInput frame_of(const cv::Mat& image, const cv::Mat& mask = {}) {
  FrameInput frame;
  frame.image = image;
  frame.mask = mask;
  return frame;
}

TEST(FrameBuilder, SpreadsFeaturesOffWhatMovedAndLeavesSomeThere) {
  const cv::Mat image = crowded_image();
  const cv::Rect moved(0, 0, 128, 480);  // a fifth of the image
  KnownMovers before{cv::Mat::zeros(image.size(), CV_8UC1), 0.1};
  before.mask(moved) = 255;
  FrameBuilder builder(dataset::scene_camera(), with_geometry(true));
  const FrameFeaturesPtr features = builder.build(frame_of(image), before);
  const int there = features_within(*features, moved);
  EXPECT_GT(there, 150);
  EXPECT_LE(there, 250);                                            // a quarter of 1000
  EXPECT_EQ(static_cast<int>(features->size()), 1200 + 250);        // 1000 (1 + 2 / 10), and those
  EXPECT_EQ(features_within(*features, {136, 0, 504, 480}), 1200);  // 8 pixels beside it
}

TEST(FrameBuilder, AsksForMoreWhereAMaskHidesMuch) {
  const cv::Mat image = crowded_image();
  cv::Mat mask = cv::Mat::zeros(image.size(), CV_8UC1);
  mask(cv::Rect(0, 0, 64, 480)) = 255;
  FrameBuilder builder(dataset::scene_camera(), with_geometry(true));
  EXPECT_EQ(builder.build(frame_of(image, mask), {})->size(), 1200U);
  mask(cv::Rect(0, 0, 480, 480)) = 255;
  EXPECT_EQ(builder.build(frame_of(image, mask), {})->size(), 1300U);
  EXPECT_EQ(builder.build(frame_of(image), {})->size(), 1000U);
}

TEST(FrameBuilder, WithoutGeometryFeaturesAreAsManyAsAskedFor) {
  const cv::Mat image = crowded_image();
  cv::Mat mask = cv::Mat::zeros(image.size(), CV_8UC1);
  mask(cv::Rect(0, 0, 320, 480)) = 255;
  FrameBuilder builder(dataset::scene_camera(), with_geometry(false));
  EXPECT_EQ(builder.build(frame_of(image, mask), {})->size(), 1000U);
  EXPECT_EQ(builder.build(frame_of(image), {mask, 0.5})->size(), 1000U);
}

}  // namespace
}  // namespace dynslam::slam
