#include "slam/frame_images.hpp"

#include <cmath>
#include <cstdint>
#include <limits>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace dynslam::slam {
namespace {

cv::Mat noise(cv::Size size, int type, std::uint64_t seed) {
  cv::Mat image(size, type);
  cv::RNG(seed).fill(image, cv::RNG::UNIFORM, 0, 256);
  return image;
}

TEST(MeanOfCells, IsWhatResizingByAreaGives) {
  for (const cv::Size size : {cv::Size(640, 480), cv::Size(76, 8), cv::Size(4, 4)}) {
    const cv::Mat image = noise(size, CV_8UC1, 3);
    cv::Mat expected, cells;
    cv::resize(image, expected, size / 4, 0, 0, cv::INTER_AREA);
    mean_of_cells(image, cells);
    ASSERT_EQ(cells.size(), expected.size());
    EXPECT_EQ(cv::countNonZero(cells != expected), 0) << size;
  }
}

TEST(MeanOfCells, LeavesOutPixelsThatFillNoCell) {
  cv::Mat image(11, 23, CV_8UC1, cv::Scalar(200));
  image(cv::Rect(0, 0, 20, 8)).setTo(7);
  cv::Mat cells;
  mean_of_cells(image, cells);
  ASSERT_EQ(cells.size(), cv::Size(5, 2));
  EXPECT_EQ(cv::countNonZero(cells != 7), 0);
}

TEST(MeanOfCells, ReadsRowsThatAreApart) {
  const cv::Mat wide = noise({300, 40}, CV_8UC1, 5);
  cv::Mat of_part, of_copy;
  mean_of_cells(wide(cv::Rect(3, 5, 132, 24)), of_part);
  mean_of_cells(wide(cv::Rect(3, 5, 132, 24)).clone(), of_copy);
  EXPECT_EQ(cv::countNonZero(of_part != of_copy), 0);
}

TEST(SplitDepth, PartsGiveTheImageAgain) {
  for (const int width : {640, 77, 5}) {
    const cv::Mat depth = noise({width, 31}, CV_32FC1, 11);
    cv::Mat mask = cv::Mat::zeros(depth.size(), CV_8UC1);
    cv::circle(mask, {width / 2, 15}, 9, 255, cv::FILLED);
    mask.at<std::uint8_t>(30, width - 1) = 1;
    cv::Mat seen, hidden;
    split_depth(depth, mask, seen, hidden);
    cv::Mat expected = depth.clone();
    expected.setTo(0.0F, mask);
    EXPECT_EQ(cv::countNonZero(seen != expected), 0) << width;
    hidden.copyTo(seen, mask);
    EXPECT_EQ(cv::countNonZero(seen != depth), 0) << width;
  }
}

TEST(SplitDepth, KeepsWhatIsNoNumberOutsideTheMask) {
  cv::Mat depth(2, 40, CV_32FC1, cv::Scalar(std::numeric_limits<float>::quiet_NaN()));
  cv::Mat mask = cv::Mat::zeros(depth.size(), CV_8UC1);
  mask.at<std::uint8_t>(1, 35) = 255;
  cv::Mat seen, hidden;
  split_depth(depth, mask, seen, hidden);
  EXPECT_TRUE(std::isnan(seen.at<float>(0, 35)));
  EXPECT_TRUE(std::isnan(seen.at<float>(1, 34)));
  EXPECT_EQ(seen.at<float>(1, 35), 0.0F);
  EXPECT_TRUE(std::isnan(hidden.at<float>(1, 35)));
}

TEST(SplitDepth, WritesIntoTheMemoryThatIsThere) {
  const cv::Mat depth(8, 64, CV_32FC1, cv::Scalar(2.0));
  const cv::Mat mask(8, 64, CV_8UC1, cv::Scalar(255));
  cv::Mat seen(8, 64, CV_32FC1), hidden(8, 64, CV_32FC1);
  const std::uint8_t* const seen_memory = seen.data;
  const std::uint8_t* const hidden_memory = hidden.data;
  split_depth(depth, mask, seen, hidden);
  EXPECT_EQ(seen.data, seen_memory);
  EXPECT_EQ(hidden.data, hidden_memory);
  EXPECT_EQ(cv::countNonZero(seen), 0);
  EXPECT_EQ(cv::countNonZero(hidden != depth), 0);
}

}  // namespace
}  // namespace dynslam::slam
