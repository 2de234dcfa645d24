// Descriptors against those of cv::ORB: what keeps existing vocabularies of use.
#include <limits>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/features2d.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/features/orb.hpp"

#include "features/support.hpp"

namespace dynslam::features {
namespace {

using testing::texture;
using testing::view;

double mean_distance(const cv::Mat& a, const cv::Mat& b) {
  return cv::norm(a, b, cv::NORM_HAMMING) / a.rows;
}

cv::Mat describe(OrbExtractor& extractor, const cv::Mat& image,
                 const std::vector<cv::KeyPoint>& keypoints) {
  cv::Mat descriptors;
  extractor.describe(view(image), keypoints, descriptors);
  return descriptors;
}

TEST(OrbDescriptors, OfTheFirstLevelAreOpenCvs) {
  const cv::Mat image = texture(640, 480, 2);
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat expected;
  cv::ORB::create(800, 1.2F, 1)->detectAndCompute(image, cv::noArray(), keypoints, expected);
  ASSERT_GT(keypoints.size(), 400U);
  OrbExtractor extractor;
  // cv::ORB blurs with weights rounded to a sum of 257 instead of cv::GaussianBlur's 256, which
  // decides a few tests of nearly equal pixels differently.
  EXPECT_LT(mean_distance(describe(extractor, image, keypoints), expected), 1.0);
}

TEST(OrbDescriptors, OfAllLevelsDifferFromOpenCvsByAFewBits) {
  const cv::Mat image = texture(640, 480, 2);
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat expected;
  cv::ORB::create(1000)->detectAndCompute(image, cv::noArray(), keypoints, expected);
  ASSERT_GT(keypoints.size(), 700U);
  OrbExtractor extractor;
  const cv::Mat descriptors = describe(extractor, image, keypoints);
  // Different descriptors of the same image are about 128 bits apart. Levels differ by where their
  // pixels lie: ours keep the exact scale, cv::ORB's the ratio of the rounded sizes.
  EXPECT_LT(mean_distance(descriptors, expected), 10.0);
  for (int i = 0; i < descriptors.rows; ++i) {
    EXPECT_LT(cv::norm(descriptors.row(i), expected.row(i), cv::NORM_HAMMING), 50.0);
  }
}

TEST(OrbDescriptors, OfOurKeyPointsComputedByOpenCvDifferByAFewBits) {
  const cv::Mat image = texture(640, 480, 3);
  OrbExtractor extractor;
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  extractor.extract(view(image), {}, keypoints, descriptors);
  // OpenCV drops key points near the border; class_id tells which are left.
  for (std::size_t i = 0; i < keypoints.size(); ++i) keypoints[i].class_id = static_cast<int>(i);
  cv::Mat opencv;
  cv::ORB::create(1000)->compute(image, keypoints, opencv);
  ASSERT_GT(keypoints.size(), 700U);
  double sum = 0.0;
  for (int i = 0; i < opencv.rows; ++i) {
    const int ours = keypoints[static_cast<std::size_t>(i)].class_id;
    sum += cv::norm(opencv.row(i), descriptors.row(ours), cv::NORM_HAMMING);
  }
  EXPECT_LT(sum / opencv.rows, 10.0);
}

TEST(OrbDescriptors, AnglesAreOpenCvs) {
  const cv::Mat image = texture(640, 480, 3);
  OrbOptions options;
  options.levels = 1;
  options.max_features = 5000;
  options.subpixel = false;
  OrbExtractor extractor(options);
  std::vector<cv::KeyPoint> ours;
  cv::Mat descriptors;
  extractor.extract(view(image), {}, ours, descriptors);
  std::vector<cv::KeyPoint> opencv;
  cv::ORB::create(5000, 1.2F, 1)->detect(image, opencv);
  int common = 0;
  for (const cv::KeyPoint& a : ours) {
    for (const cv::KeyPoint& b : opencv) {
      if (a.pt != b.pt) continue;
      ++common;
      EXPECT_EQ(a.angle, b.angle);
    }
  }
  EXPECT_GT(common, 300);
}

TEST(OrbDescribe, GivesBackTheDescriptorsOfExtract) {
  const cv::Mat image = texture(333, 259, 3);
  OrbExtractor extractor;
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  extractor.extract(view(image), {}, keypoints, descriptors);
  ASSERT_GT(keypoints.size(), 300U);
  EXPECT_TRUE(testing::same_bytes(describe(extractor, image, keypoints), descriptors));
  OrbExtractor fresh;
  EXPECT_TRUE(testing::same_bytes(describe(fresh, image, keypoints), descriptors));
}

TEST(OrbDescribe, RepeatsTheBorderPixelsBeyondTheBorder) {
  const cv::Mat image = texture(120, 90, 3);
  OrbOptions options;
  options.levels = 1;
  OrbExtractor extractor(options);
  std::vector<cv::KeyPoint> keypoints;
  for (const cv::Point2f at : {cv::Point2f(0, 0), cv::Point2f(119.4F, 89.4F),
                               cv::Point2f(-0.5F, 40), cv::Point2f(60, 18), cv::Point2f(60, 19)}) {
    keypoints.emplace_back(at, 31.0F, 30.0F, 1.0F, 0);
  }
  cv::Mat blurred;
  cv::GaussianBlur(image, blurred, cv::Size(7, 7), 2.0, 2.0, cv::BORDER_REFLECT_101);
  // A pattern that is blurred already is described by itself: pad it, and the border is far away.
  cv::Mat padded;
  cv::copyMakeBorder(blurred, padded, 40, 40, 40, 40, cv::BORDER_REPLICATE);
  const cv::Mat descriptors = describe(extractor, image, keypoints);
  ASSERT_EQ(descriptors.rows, 5);
  // The fourth and the fifth differ by a row: by the reference one of them is at the border.
  const float angle = 30.0F * static_cast<float>(CV_PI / 180.0);
  for (int i = 0; i < 5; ++i) {
    const int x = std::min(std::max(cvRound(keypoints[static_cast<std::size_t>(i)].pt.x), 0), 119);
    const int y = std::min(std::max(cvRound(keypoints[static_cast<std::size_t>(i)].pt.y), 0), 89);
    const std::uint8_t first = descriptors.at<std::uint8_t>(i, 0);
    // The first test of the pattern: (8, -3) against (9, 5).
    const auto pixel = [&](float px, float py) {
      const int dx = cvRound(px * std::cos(angle) - py * std::sin(angle));
      const int dy = cvRound(px * std::sin(angle) + py * std::cos(angle));
      return padded.at<std::uint8_t>(y + dy + 40, x + dx + 40);
    };
    EXPECT_EQ(first & 1, pixel(8, -3) < pixel(9, 5)) << i;
    EXPECT_EQ((first >> 7) & 1, pixel(-13, -13) < pixel(-11, -8)) << i;
  }
}

TEST(OrbDescribe, RefusesWhatHasNoDescriptorAndLeavesTheOutputAlone) {
  const cv::Mat image = texture(120, 90, 3);
  OrbExtractor extractor;
  cv::Mat descriptors(3, 32, CV_8UC1, cv::Scalar(7));
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const cv::KeyPoint good(60, 40, 31, 0, 1, 0);
  const auto refused = [&](const cv::KeyPoint& bad) {
    const cv::KeyPoint keypoints[] = {good, bad};
    EXPECT_THROW(extractor.describe(view(image), keypoints, descriptors), InvalidArgument);
  };
  refused(cv::KeyPoint(nan, 40, 31, 0, 1, 0));
  refused(cv::KeyPoint(60, nan, 31, 0, 1, 0));
  refused(cv::KeyPoint(60, 40, 31, nan, 1, 0));
  refused(cv::KeyPoint(120, 40, 31, 0, 1, 0));
  refused(cv::KeyPoint(60, -1, 31, 0, 1, 0));
  refused(cv::KeyPoint(60, 40, 31, 0, 1, -1));
  refused(cv::KeyPoint(60, 40, 31, 0, 1, 5));  // 90 / 1.2^5 is too small for a level
  EXPECT_THROW(extractor.describe({}, Span<const cv::KeyPoint>(&good, 1), descriptors),
               InvalidArgument);
  EXPECT_EQ(descriptors.rows, 3);
  EXPECT_EQ(descriptors.at<std::uint8_t>(2, 31), 7);
}

TEST(OrbDescribe, OfNoKeyPointsIsEmpty) {
  OrbExtractor extractor;
  cv::Mat descriptors(3, 32, CV_8UC1);
  extractor.describe(view(texture(120, 90)), {}, descriptors);
  EXPECT_TRUE(descriptors.empty());
}

}  // namespace
}  // namespace dynslam::features
