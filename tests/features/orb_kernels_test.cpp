// Every kernel on every kind of vector instructions against the plain loops, and those against
// OpenCV or against a definition.
#include "features/orb_kernels.hpp"

#include <cmath>
#include <cstring>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/features2d.hpp>

#include "features/orb_reference.hpp"
#include "features/support.hpp"

namespace dynslam::features::detail {
namespace {

using testing::for_each_target;
using testing::noise;
using testing::texture;
using testing::uniform;

/// An image with the slack around it that kernels ask for, filled with `slack`.
class Padded {
 public:
  Padded(int width, int height, std::uint8_t slack = 0xAA)
      : stride_(width + kRowSlack + 5),
        bytes_(static_cast<std::size_t>(stride_ * height + 2 * kRowSlack), slack),
        width_(width),
        height_(height) {}
  explicit Padded(const cv::Mat& image, std::uint8_t slack = 0xAA)
      : Padded(image.cols, image.rows, slack) {
    for (int y = 0; y < height_; ++y) {
      std::memcpy(block().row(y), image.ptr(y), static_cast<std::size_t>(width_));
    }
  }
  MutablePixelBlock block() { return {bytes_.data() + kRowSlack, stride_, width_, height_}; }
  PixelBlock view() const { return {bytes_.data() + kRowSlack, stride_, width_, height_}; }
  cv::Mat mat() const {
    return cv::Mat(height_, width_, CV_8UC1, const_cast<std::uint8_t*>(bytes_.data()) + kRowSlack,
                   static_cast<std::size_t>(stride_))
        .clone();
  }

 private:
  std::ptrdiff_t stride_;
  std::vector<std::uint8_t> bytes_;
  int width_, height_;
};

struct Axis {
  std::vector<std::int32_t> first;
  std::vector<std::uint16_t> weight;

  Axis(int source, int target, double step) {
    for (int i = 0; i < target; ++i) {
      const double at = std::min(std::max((i + 0.5) * step - 0.5, 0.0), source - 1.0);
      first.push_back(std::min(static_cast<int>(at), source - 2));
      weight.push_back(static_cast<std::uint16_t>(std::lround((at - first.back()) * 256)));
    }
  }
  ResizeAxis axis() const { return {first.data(), weight.data()}; }
};

cv::Mat resized(const cv::Mat& image, double step, bool plain) {
  const int width = static_cast<int>(std::lround(image.cols / step));
  const int height = static_cast<int>(std::lround(image.rows / step));
  const Padded source(image);
  Padded target(width, height);
  const Axis columns(image.cols, width, step);
  const Axis rows(image.rows, height, step);
  if (plain) {
    reference::resize_level(source.view(), columns.axis(), rows.axis(), target.block());
  } else {
    std::vector<std::uint16_t> scratch(static_cast<std::size_t>(image.cols + kRowSlack));
    resize_level(source.view(), columns.axis(), rows.axis(), target.block(), scratch.data());
  }
  return target.mat();
}

TEST(ResizeLevel, IsTheSameOnAllTargetsForAllRemaindersAndScales) {
  for (const int width : {40, 41, 63, 64, 65, 97, 128, 131, 640, 1226}) {
    for (const double step : {1.01, 1.2, 1.41421356, 1.9, 2.0, 2.7, 4.0}) {
      const cv::Mat image = noise(width, 47, static_cast<unsigned>(width));
      const cv::Mat expected = resized(image, step, true);
      for_each_target([&](const std::string& target) {
        EXPECT_TRUE(testing::same_bytes(resized(image, step, false), expected))
            << target << ", width " << width << ", step " << step;
      });
    }
  }
}

TEST(ResizeLevel, ReproducesALinearRampAtTheCentresOfScaledPixels) {
  cv::Mat ramp(60, 120, CV_8UC1);
  for (int y = 0; y < ramp.rows; ++y) {
    for (int x = 0; x < ramp.cols; ++x)
      ramp.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(x + y);
  }
  const cv::Mat small = resized(ramp, 1.2, false);
  for (int y = 0; y < small.rows; ++y) {
    for (int x = 0; x < small.cols; ++x) {
      const double value = (x + 0.5) * 1.2 - 0.5 + (y + 0.5) * 1.2 - 0.5;
      EXPECT_NEAR(small.at<std::uint8_t>(y, x), value, 0.51) << x << " " << y;
    }
  }
}

cv::Mat blurred(const cv::Mat& image, bool plain) {
  const Padded source(image);
  Padded target(image.cols, image.rows);
  if (plain) {
    reference::blur_level(source.view(), target.block());
  } else {
    std::vector<std::uint16_t> scratch(static_cast<std::size_t>(image.cols + 2 * kRowSlack));
    blur_level(source.view(), target.block(), scratch.data());
  }
  return target.mat();
}

TEST(BlurLevel, IsTheSameOnAllTargetsAndEqualsOpenCvsGaussian) {
  for (const int width : {39, 40, 47, 64, 65, 95, 127, 130, 333}) {
    const cv::Mat image = noise(width, 43, static_cast<unsigned>(width));
    const cv::Mat expected = blurred(image, true);
    cv::Mat opencv;
    cv::GaussianBlur(image, opencv, cv::Size(7, 7), 2.0, 2.0, cv::BORDER_REFLECT_101);
    EXPECT_TRUE(testing::same_bytes(expected, opencv)) << "width " << width;
    for_each_target([&](const std::string& target) {
      EXPECT_TRUE(testing::same_bytes(blurred(image, false), expected)) << target << " " << width;
    });
  }
}

std::vector<Corner> corners_of(const cv::Mat& image, int border, int threshold, bool plain) {
  const Padded level(image);
  std::vector<Corner> corners(
      static_cast<std::size_t>((image.cols + 1) / 2 * ((image.rows + 1) / 2)));
  std::vector<std::uint8_t> scratch(static_cast<std::size_t>(3 * level.view().stride), 0x55);
  const int count =
      plain
          ? reference::fast_corners(level.view(), border, threshold, scratch.data(), corners.data())
          : fast_corners(level.view(), border, threshold, scratch.data(), corners.data());
  corners.resize(static_cast<std::size_t>(count));
  return corners;
}

bool same(const std::vector<Corner>& a, const std::vector<Corner>& b) {
  return a.size() == b.size() &&
         std::equal(a.begin(), a.end(), b.begin(), [](const Corner& p, const Corner& q) {
           return p.x == q.x && p.y == q.y && p.score == q.score && p.dx == q.dx && p.dy == q.dy;
         });
}

TEST(FastCorners, AreTheSameOnAllTargets) {
  for (const int width : {39, 40, 70, 101, 102, 103, 166, 333}) {
    for (const int threshold : {1, 7, 20, 100, 254}) {
      for (const cv::Mat& image : {noise(width, 45, 7), noise(width, 45, 8, 100, 130),
                                   noise(width, 45, 9, 254, 255), texture(width, 45)}) {
        const std::vector<Corner> expected = corners_of(image, 19, threshold, true);
        for_each_target([&](const std::string& target) {
          EXPECT_TRUE(same(corners_of(image, 19, threshold, false), expected))
              << target << ", width " << width << ", threshold " << threshold;
        });
      }
    }
  }
}

TEST(FastCorners, AreFoundInMostPlacesOnNoiseSoThatTheTestAboveTestsSomething) {
  EXPECT_GT(corners_of(noise(333, 45, 7), 19, 7, false).size(), 50U);
  EXPECT_GT(corners_of(texture(333, 145), 19, 20, false).size(), 50U);
}

TEST(FastCorners, ScoreIsTheLargestThresholdAtWhichOpenCvFindsTheCorner) {
  const cv::Mat image = texture(160, 120);
  const std::vector<Corner> corners = corners_of(image, 4, 7, false);
  ASSERT_GT(corners.size(), 50U);
  const auto is_corner = [&](const Corner& corner, int threshold) {
    std::vector<cv::KeyPoint> keypoints;
    cv::FAST(image, keypoints, threshold, false);
    for (const cv::KeyPoint& keypoint : keypoints) {
      if (keypoint.pt == cv::Point2f(corner.x, corner.y)) return true;
    }
    return false;
  };
  for (std::size_t i = 0; i < corners.size(); i += 9) {
    EXPECT_TRUE(is_corner(corners[i], corners[i].score));
    EXPECT_FALSE(is_corner(corners[i], corners[i].score + 1));
  }
}

TEST(FastCorners, PeakOfAParabolaIsLessThanHalfAPixelAway) {
  for (int peak = 1; peak < 255; ++peak) {
    for (int before = 0; before < peak; ++before) {
      for (int after = 0; after <= peak; ++after) {
        const double exact = 0.5 * (after - before) / (2.0 * peak - before - after);
        const double found = kSubpixel * peak_offset(before, peak, after);
        ASSERT_LT(std::abs(found), 0.5);
        ASSERT_NEAR(found, exact, 1.01 * kSubpixel);
      }
    }
  }
}

TEST(FastCorners, HoldAllOfOpenCvsSuppressedCorners) {
  // Ours are a few more: of two equal neighbours OpenCV drops both.
  const cv::Mat image = texture(320, 240);
  cv::Mat found = cv::Mat::zeros(image.size(), CV_8UC1);
  const std::vector<Corner> corners = corners_of(image, 4, 12, false);
  for (const Corner& corner : corners) found.at<std::uint8_t>(corner.y, corner.x) = 1;
  std::vector<cv::KeyPoint> keypoints;
  cv::FAST(image, keypoints, 12, true);
  std::size_t inside = 0;
  for (const cv::KeyPoint& keypoint : keypoints) {
    const cv::Point at = keypoint.pt;
    if (at.x < 4 || at.y < 4 || at.x >= image.cols - 4 || at.y >= image.rows - 4) continue;
    ++inside;
    EXPECT_EQ(found.at<std::uint8_t>(at), 1) << at;
  }
  EXPECT_GT(inside, 300U);
  EXPECT_GE(corners.size(), inside);
  EXPECT_LE(corners.size(), inside + inside / 10);
}

std::vector<Corner> random_corners(int width, int height, int border, int count) {
  std::mt19937 random(5);
  std::vector<Corner> corners;
  for (int i = 0; i < count; ++i) {
    corners.push_back({static_cast<std::uint16_t>(uniform(random, border, width - border - 1)),
                       static_cast<std::uint16_t>(uniform(random, border, height - border - 1)),
                       0});
  }
  corners.push_back({static_cast<std::uint16_t>(border), static_cast<std::uint16_t>(border), 0});
  corners.push_back({static_cast<std::uint16_t>(width - border - 1),
                     static_cast<std::uint16_t>(height - border - 1), 0});
  return corners;
}

TEST(PatchMoments, AreTheSameOnAllTargets) {
  for (const cv::Mat& image : {noise(90, 70, 3), noise(90, 70, 4, 255, 255), texture(90, 70)}) {
    const Padded level(image);
    const std::vector<Corner> corners = random_corners(90, 70, 19, 60);
    const int count = static_cast<int>(corners.size());
    std::vector<std::int32_t> expected10(corners.size()), expected01(corners.size());
    reference::patch_moments(level.view(), corners.data(), count, expected10.data(),
                             expected01.data());
    for_each_target([&](const std::string& target) {
      std::vector<std::int32_t> m10(corners.size()), m01(corners.size());
      patch_moments(level.view(), corners.data(), count, m10.data(), m01.data());
      EXPECT_EQ(m10, expected10) << target;
      EXPECT_EQ(m01, expected01) << target;
    });
  }
}

TEST(PatchMoments, OfAWhiteHalfPointTowardsIt) {
  cv::Mat image = cv::Mat::zeros(41, 41, CV_8UC1);
  image.colRange(21, 41) = 200;
  const Padded level(image);
  const Corner centre = {20, 20, 0};
  std::int32_t m10 = 0;
  std::int32_t m01 = 1;
  patch_moments(level.view(), &centre, 1, &m10, &m01);
  EXPECT_GT(m10, 0);
  EXPECT_EQ(m01, 0);
}

TEST(RotatedBrief, IsTheSameOnAllTargetsAtAnyAngle) {
  const Padded level(noise(90, 70, 6));
  const std::vector<Corner> corners = random_corners(90, 70, 19, 400);
  std::vector<Rotation> rotations;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    // Whole degrees include the angles at which points fall half way between two pixels.
    const float angle = static_cast<float>(i % 360) * static_cast<float>(CV_PI / 180.0);
    rotations.push_back({std::cos(angle), std::sin(angle)});
  }
  const int count = static_cast<int>(corners.size());
  std::vector<std::uint8_t> expected(corners.size() * 32);
  reference::rotated_brief(level.view(), corners.data(), rotations.data(), count, expected.data());
  for_each_target([&](const std::string& target) {
    std::vector<std::uint8_t> descriptors(corners.size() * 32);
    rotated_brief(level.view(), corners.data(), rotations.data(), count, descriptors.data());
    EXPECT_EQ(descriptors, expected) << target;
  });
}

TEST(RotatedBrief, HalvesRoundToTheEvenPixelOnAllTargets) {
  const Padded level(noise(60, 60, 6));
  const Corner centre = {30, 30, 0};
  const Rotation half = {0.5F, 0.5F};  // no rotation, but every odd sum falls half way
  std::vector<std::uint8_t> expected(32);
  reference::rotated_brief(level.view(), &centre, &half, 1, expected.data());
  for_each_target([&](const std::string& target) {
    std::vector<std::uint8_t> descriptor(32);
    rotated_brief(level.view(), &centre, &half, 1, descriptor.data());
    EXPECT_EQ(descriptor, expected) << target;
  });
}

TEST(OrbPattern, ReachesNoFartherThanTheBorderAtAnyAngle) {
  for (int degree = 0; degree < 360; ++degree) {
    const float angle = static_cast<float>(degree) * static_cast<float>(CV_PI / 180.0);
    const Rotation rotation = {std::cos(angle), std::sin(angle)};
    for (const auto& pair : kOrbPattern) {
      for (const int k : {0, 2}) {
        const reference::PatternPoint p = reference::turned(pair[k], pair[k + 1], rotation);
        ASSERT_LE(std::max(std::abs(p.x), std::abs(p.y)), 19);
      }
    }
  }
}

}  // namespace
}  // namespace dynslam::features::detail
