#include "dynslam/features/keypoint_grid.hpp"

#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "dynslam/core/errors.hpp"

#include "features/support.hpp"

namespace dynslam::features {
namespace {

using testing::kInfinity;
using testing::kNan;

std::vector<cv::Point2f> random_points(int count, unsigned seed) {
  std::mt19937 random(seed);
  std::vector<cv::Point2f> points;
  // Some lie outside of 640 x 480.
  for (int i = 0; i < count; ++i) {
    points.emplace_back(static_cast<float>(random() % 7000) / 10.0F - 30.0F,
                        static_cast<float>(random() % 5400) / 10.0F - 30.0F);
  }
  return points;
}

std::vector<std::int32_t> by_hand(const std::vector<cv::Point2f>& points, cv::Point2f centre,
                                  float radius) {
  std::vector<std::int32_t> indices;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (std::abs(points[i].x - centre.x) <= radius && std::abs(points[i].y - centre.y) <= radius) {
      indices.push_back(static_cast<std::int32_t>(i));
    }
  }
  return indices;
}

TEST(KeypointGrid, FindsWhatASearchThroughAllPointsFinds) {
  KeypointGrid grid;
  std::vector<std::int32_t> found;
  std::mt19937 random(3);
  for (const int count : {0, 1, 5, 1000}) {
    for (const int cell : {1, 7, 24, 1000}) {
      const std::vector<cv::Point2f> points = random_points(count, 2);
      grid.build(points, 640, 480, cell);
      EXPECT_EQ(grid.size(), points.size());
      for (int i = 0; i < 60; ++i) {
        const cv::Point2f centre(static_cast<float>(random() % 800) - 80.0F,
                                 static_cast<float>(random() % 640) - 80.0F);
        for (const float radius : {0.0F, 0.4F, 12.5F, 80.0F, 2000.0F}) {
          grid.find(centre, radius, found);
          EXPECT_EQ(found, by_hand(points, centre, radius)) << centre << " " << radius;
        }
      }
    }
  }
}

TEST(KeypointGrid, IncludesTheEdgeOfTheWindow) {
  const std::vector<cv::Point2f> points = {{10, 10}, {14, 6}, {14.001F, 10}};
  KeypointGrid grid;
  grid.build(points, 100, 100);
  std::vector<std::int32_t> found;
  grid.find({10, 10}, 4.0F, found);
  EXPECT_EQ(found, (std::vector<std::int32_t>{0, 1}));
}

TEST(KeypointGrid, BindsKeyPointsAndForgetsThemAfterwards) {
  std::vector<cv::KeyPoint> keypoints(3);
  keypoints[2].pt = {30, 40};
  KeypointGrid grid;
  grid.build(field(keypoints, &cv::KeyPoint::pt), 100, 100);
  keypoints[2].pt = {90, 90};
  std::vector<std::int32_t> found;
  grid.find({30, 40}, 1.0F, found);
  EXPECT_EQ(found, std::vector<std::int32_t>{2});
}

TEST(KeypointGrid, NeverFindsPointsWithANanAndFindsInfiniteOnesOnlyInInfiniteWindows) {
  const std::vector<cv::Point2f> points = {{kNan, 5}, {5, kNan}, {5, 5}, {kInfinity, 5}};
  KeypointGrid grid;
  grid.build(points, 10, 10, 2);
  EXPECT_EQ(grid.size(), 4U);
  std::vector<std::int32_t> found;
  grid.find({5, 5}, 1e30F, found);
  EXPECT_EQ(found, std::vector<std::int32_t>{2});
}

TEST(KeypointGrid, FindsNothingForANegativeRadiusOrANan) {
  const std::vector<cv::Point2f> points = {{5, 5}};
  KeypointGrid grid;
  std::vector<std::int32_t> found = {9};
  grid.find({5, 5}, 10.0F, found);
  EXPECT_TRUE(found.empty());  // nothing was built yet
  grid.build(points, 10, 10);
  const std::pair<cv::Point2f, float> windows[] = {
      {{5, 5}, -1.0F}, {{5, 5}, kNan}, {{kNan, 5}, 3.0F}, {{5, kNan}, 3.0F}};
  for (const auto& [centre, radius] : windows) {
    found = {9};
    grid.find(centre, radius, found);
    EXPECT_TRUE(found.empty());
  }
}

TEST(KeypointGrid, VisitsEachPointOfTheWindowOnce) {
  const std::vector<cv::Point2f> points = random_points(300, 4);
  KeypointGrid grid;
  grid.build(points, 640, 480);
  std::vector<int> visits(points.size(), 0);
  grid.visit({300, 200}, 100.0F, [&](std::int32_t i) { ++visits[static_cast<std::size_t>(i)]; });
  int seen = 0;
  for (const int count : visits) {
    EXPECT_LE(count, 1);
    seen += count;
  }
  EXPECT_EQ(seen, static_cast<int>(by_hand(points, {300, 200}, 100.0F).size()));
}

TEST(KeypointGrid, RefusesSizesBelowOne) {
  KeypointGrid grid;
  const std::vector<cv::Point2f> points = {{5, 5}};
  grid.build(points, 10, 10);
  EXPECT_THROW(grid.build({}, 0, 10), InvalidArgument);
  EXPECT_THROW(grid.build({}, 10, 0), InvalidArgument);
  EXPECT_THROW(grid.build({}, 10, 10, 0), InvalidArgument);
  EXPECT_EQ(grid.size(), 1U);  // what was built before is still there
}

}  // namespace
}  // namespace dynslam::features
