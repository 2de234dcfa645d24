#include "dynslam/core/opencv.hpp"

#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/points.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam {
namespace {

TEST(OpenCvViews, ShareThePixelsOfAMatrixWithARowStride) {
  cv::Mat big(10, 20, CV_8UC1, cv::Scalar(7));
  cv::Mat part = big(cv::Rect(3, 2, 5, 4));
  const GrayView view = as_view<const std::uint8_t>(part);
  EXPECT_EQ(view.data, part.data);
  EXPECT_EQ(view.row(1), big.ptr(3) + 3);
  EXPECT_EQ(view.width, 5);
  EXPECT_EQ(as_mat(view).data, part.data);
  EXPECT_EQ(as_mat(view).step[0], big.step[0]);
}

TEST(OpenCvViews, RefuseAnotherPixelType) {
  const cv::Mat color(4, 4, CV_8UC3);
  EXPECT_THROW(as_view<const std::uint8_t>(color), InvalidArgument);
  EXPECT_THROW(as_view<float>(color), InvalidArgument);
  EXPECT_TRUE(as_view<float>(cv::Mat()).empty());
}

TEST(OpenCvViews, KeyPointsBindAsPointsWithoutACopy) {
  std::vector<cv::KeyPoint> keypoints(3);
  keypoints[2].pt = {3.0F, 4.0F};
  const auto points = as_points<float>(field(keypoints, &cv::KeyPoint::pt));
  EXPECT_EQ(points.data(), &keypoints[0].pt.x);
  EXPECT_EQ(points(1, 2), 4.0F);
  const auto bind = [](Points2f bound) { return bound.data(); };
  EXPECT_EQ(bind(points), &keypoints[0].pt.x);
}

}  // namespace
}  // namespace dynslam
