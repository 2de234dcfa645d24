#include "dynslam/features/patch_alignment.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "dynslam/features/orb.hpp"

#include "features/support.hpp"

namespace dynslam::features {
namespace {

using testing::texture;

GrayView gray(const cv::Mat& image) { return as_view<const std::uint8_t>(image); }

/// What a camera sees that is moved: pixel x of the result is A x + t of the image.
cv::Mat moved(const cv::Mat& image, const Eigen::Matrix2f& A, const Eigen::Vector2f& t) {
  const cv::Matx23f map(A(0, 0), A(0, 1), t.x(), A(1, 0), A(1, 1), t.y());
  cv::Mat result;
  cv::warpAffine(image, result, map, image.size(), cv::INTER_CUBIC | cv::WARP_INVERSE_MAP,
                 cv::BORDER_REFLECT);
  return result;
}

cv::Mat smooth_texture() {
  cv::Mat image = texture(320, 240);
  cv::GaussianBlur(image, image, cv::Size(5, 5), 1.0);
  return image;
}

std::vector<cv::KeyPoint> corners_of(const cv::Mat& image) {
  OrbOptions options;
  options.levels = 1;
  std::vector<cv::KeyPoint> corners;
  cv::Mat descriptors;
  OrbExtractor(options).extract(gray(image), {}, corners, descriptors);
  return corners;
}

struct Outcome {
  int aligned = 0, asked = 0;
  double worst = 0.0, squares = 0.0;
  double rms() const { return std::sqrt(squares / aligned); }
};

/// Aligns the patches about the corners of `seen` with it, from up to 0.4 pixels beside in x and y.
Outcome align_all(const cv::Mat& image, const cv::Mat& seen, const Eigen::Matrix2f& A,
                  const Eigen::Vector2f& t) {
  Outcome outcome;
  std::mt19937 random(3);
  std::uniform_real_distribution<float> off(-0.4F, 0.4F);
  for (const cv::KeyPoint& corner : corners_of(seen)) {
    const Eigen::Vector2f truth(corner.pt.x, corner.pt.y);
    const auto patch = cut_patch(gray(image), A * truth + t);
    if (!patch) continue;
    ++outcome.asked;
    const Eigen::Vector2f start = truth + Eigen::Vector2f(off(random), off(random));
    const PatchAlignment found = align_patch(*patch, A, gray(seen), start);
    if (!found.ok()) continue;
    ++outcome.aligned;
    const double error = static_cast<double>((found.at - truth).norm());
    outcome.worst = std::max(outcome.worst, error);
    outcome.squares += error * error;
  }
  return outcome;
}

Eigen::Matrix2f turn(float degrees, float scale) {
  const float angle = degrees * static_cast<float>(CV_PI / 180.0);
  return scale * Eigen::Rotation2D<float>(angle).toRotationMatrix();
}

TEST(OrbExtractor, ShowsThePyramidOfTheLastImage) {
  OrbExtractor extractor;
  EXPECT_TRUE(extractor.level(0).empty());
  const cv::Mat image = texture(320, 240);
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  extractor.extract(gray(image), {}, keypoints, descriptors);
  const GrayView first = extractor.level(0);
  ASSERT_EQ(first.width, 320);
  ASSERT_EQ(first.height, 240);
  for (int y = 0; y < 240; ++y) ASSERT_EQ(std::memcmp(first.row(y), image.ptr(y), 320), 0) << y;
  const GrayView third = extractor.level(2);
  EXPECT_EQ(third.width, 222);  // 320 / 1.44
  EXPECT_EQ(third.height, 167);
  EXPECT_TRUE(extractor.level(-1).empty());
  EXPECT_TRUE(extractor.level(8).empty());
}

TEST(CutPatch, HoldsThePixelsAboutAPlace) {
  const cv::Mat image = texture(64, 48);
  const auto patch = cut_patch(gray(image), {20.3F, 17.6F});
  ASSERT_TRUE(patch);
  EXPECT_FLOAT_EQ(patch->offset.x(), 20.3F - 20.0F);
  EXPECT_FLOAT_EQ(patch->offset.y(), 17.6F - 18.0F);
  for (int v = 0; v < Patch::kSide; ++v) {
    for (int u = 0; u < Patch::kSide; ++u) {
      ASSERT_EQ(patch->pixels[static_cast<std::size_t>(v * Patch::kSide + u)],
                image.at<std::uint8_t>(18 - 8 + v, 20 - 8 + u));
    }
  }
}

TEST(CutPatch, RefusesWhatLeavesTheImage) {
  const cv::Mat image = texture(64, 48);
  EXPECT_TRUE(cut_patch(gray(image), {8.0F, 8.0F}));
  EXPECT_TRUE(cut_patch(gray(image), {55.4F, 39.4F}));
  for (const Eigen::Vector2f& at :
       {Eigen::Vector2f(7.4F, 20.0F), Eigen::Vector2f(20.0F, 7.4F), Eigen::Vector2f(55.6F, 20.0F),
        Eigen::Vector2f(20.0F, 39.6F), Eigen::Vector2f(-1e9F, 20.0F), Eigen::Vector2f(1e9F, 20.0F),
        Eigen::Vector2f(testing::kNan, 20.0F), Eigen::Vector2f(20.0F, testing::kInfinity)}) {
    EXPECT_FALSE(cut_patch(gray(image), at)) << at.transpose();
  }
  EXPECT_FALSE(cut_patch(GrayView(), {0.0F, 0.0F}));
}

TEST(AlignPatch, FindsAShiftOnEveryInstructionSet) {
  const cv::Mat image = smooth_texture();
  const Eigen::Vector2f t(3.27F, -1.61F);
  const cv::Mat seen = moved(image, Eigen::Matrix2f::Identity(), t);
  testing::for_each_target([&](const std::string& target) {
    SCOPED_TRACE(target);
    const Outcome outcome = align_all(image, seen, Eigen::Matrix2f::Identity(), t);
    EXPECT_GT(outcome.aligned, outcome.asked / 2);
    EXPECT_LT(outcome.rms(), 0.08);
    EXPECT_LT(outcome.worst, 0.2);
  });
}

TEST(AlignPatch, FindsAPlaceInATurnedAndScaledView) {
  const cv::Mat image = smooth_texture();
  for (const float degrees : {-90.0F, -20.0F, 45.0F}) {
    for (const float scale : {0.8F, 1.0F, 1.15F}) {
      const Eigen::Matrix2f A = turn(degrees, scale);
      const Eigen::Vector2f middle(160.0F, 120.0F);
      const Eigen::Vector2f t = middle - A * middle;
      const Outcome outcome = align_all(image, moved(image, A, t), A, t);
      SCOPED_TRACE(std::to_string(degrees) + " degrees, scale " + std::to_string(scale));
      EXPECT_GT(outcome.aligned, outcome.asked / 2);
      EXPECT_LT(outcome.rms(), 0.08);
    }
  }
}

TEST(AlignPatch, IsNotMisledByBrightnessAndContrast) {
  const cv::Mat image = smooth_texture();
  const Eigen::Vector2f t(0.4F, 0.7F);
  cv::Mat seen = moved(image, Eigen::Matrix2f::Identity(), t);
  seen.convertTo(seen, CV_8U, 0.7, 40.0);
  const Outcome outcome = align_all(image, seen, Eigen::Matrix2f::Identity(), t);
  EXPECT_GT(outcome.aligned, outcome.asked / 2);
  EXPECT_LT(outcome.rms(), 0.08);
}

// Of the places of all corners in an image with noise of so many grey levels: how many of the
// standard deviations that alignment tells they are off, by their median.
double error_in_sigmas(double gray_noise) {
  const cv::Mat image = smooth_texture();
  cv::Mat noise(image.size(), CV_32F), seen;
  cv::RNG(7).fill(noise, cv::RNG::NORMAL, 0.0, gray_noise);
  cv::add(image, noise, seen, cv::noArray(), CV_8U);
  std::vector<double> squares;
  for (const cv::KeyPoint& corner : corners_of(image)) {
    const Eigen::Vector2f truth(corner.pt.x, corner.pt.y);
    const auto patch = cut_patch(gray(image), truth);
    if (!patch) continue;
    const PatchAlignment found =
        align_patch(*patch, Eigen::Matrix2f::Identity(), gray(seen), truth);
    if (!found.ok()) continue;
    squares.push_back(static_cast<double>((found.at - truth).squaredNorm()) /
                      static_cast<double>(found.sigma * found.sigma));
  }
  EXPECT_GT(squares.size(), 100U);
  std::sort(squares.begin(), squares.end());
  return std::sqrt(squares[squares.size() / 2] / (2.0 * std::log(2.0)));  // 1 if normal
}

TEST(AlignPatch, KnowsHowWellItFoundAPlace) {
  for (const double gray_noise : {3.0, 6.0, 12.0}) {
    EXPECT_NEAR(error_in_sigmas(gray_noise), 1.3, 0.15) << gray_noise;
  }
}

Eigen::Vector2f strongest_corner(const cv::Mat& image) {
  std::vector<cv::KeyPoint> corners = corners_of(image);
  const auto weaker = [](const auto& a, const auto& b) { return a.response < b.response; };
  const cv::Point2f at = std::max_element(corners.begin(), corners.end(), weaker)->pt;
  return {at.x, at.y};
}

TEST(AlignPatch, TellsWhyItFails) {
  const cv::Mat image = smooth_texture();
  const Eigen::Matrix2f same = Eigen::Matrix2f::Identity();
  const Eigen::Vector2f place = strongest_corner(image);
  const Patch patch = *cut_patch(gray(image), place);
  const auto status = [&](const Patch& p, const Eigen::Matrix2f& A, const cv::Mat& level,
                          const Eigen::Vector2f& start) {
    return align_patch(p, A, gray(level), start).status;
  };
  ASSERT_EQ(status(patch, same, image, place), PatchStatus::kAligned);
  EXPECT_EQ(status(patch, 2.0F * same, image, place), PatchStatus::kDistorted);
  for (const float wrong : {testing::kNan, testing::kInfinity, -testing::kInfinity}) {
    for (int i = 0; i < 4; ++i) {
      Eigen::Matrix2f A = same;
      A(i / 2, i % 2) = wrong;
      EXPECT_EQ(status(patch, A, image, place), PatchStatus::kDistorted) << A;
    }
  }
  for (const Eigen::Vector2f& start :
       {Eigen::Vector2f(2.0F, 100.0F), Eigen::Vector2f(100.0F, 238.0F),
        Eigen::Vector2f(testing::kNan, 100.0F), Eigen::Vector2f(100.0F, testing::kNan),
        Eigen::Vector2f(-1e9F, 1e9F)}) {
    EXPECT_EQ(status(patch, same, image, start), PatchStatus::kOutside) << start.transpose();
  }
  EXPECT_EQ(align_patch(patch, same, GrayView(), place).status, PatchStatus::kOutside);

  const cv::Mat plain(240, 320, CV_8UC1, cv::Scalar(90));
  EXPECT_EQ(status(*cut_patch(gray(plain), place), same, image, place), PatchStatus::kFlat);
  cv::Mat edge = plain.clone();
  edge.colRange(0, cvRound(place.x())).setTo(200);
  EXPECT_EQ(status(*cut_patch(gray(edge), place), same, edge, place), PatchStatus::kFlat);

  const cv::Mat other = testing::noise(320, 240, 5);
  const PatchStatus strange = status(patch, same, other, place);
  EXPECT_TRUE(strange == PatchStatus::kAstray || strange == PatchStatus::kUnlike);
  PatchAlignmentOptions strict;
  strict.max_shift = 0.3F;
  EXPECT_EQ(
      align_patch(patch, same, gray(image), place + Eigen::Vector2f(0.6F, 0.0F), strict).status,
      PatchStatus::kAstray);
}

}  // namespace
}  // namespace dynslam::features
