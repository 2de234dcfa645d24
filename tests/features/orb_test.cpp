#include "dynslam/features/orb.hpp"

#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <tuple>
#include <utility>

#include <gtest/gtest.h>
#include <opencv2/features2d.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/features/hamming.hpp"

#include "features/support.hpp"

namespace dynslam::features {
namespace {

using testing::noise;
using testing::same_bytes;
using testing::texture;
using testing::view;

struct Features {
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
};

Features extract(const cv::Mat& image, const cv::Mat& mask = {}, const OrbOptions& options = {}) {
  Features features;
  OrbExtractor extractor(options);
  extractor.extract(view(image), view(mask), features.keypoints, features.descriptors);
  return features;
}

bool same(const Features& a, const Features& b) {
  return same_bytes(a.descriptors, b.descriptors) && a.keypoints.size() == b.keypoints.size() &&
         std::equal(a.keypoints.begin(), a.keypoints.end(), b.keypoints.begin(),
                    [](const cv::KeyPoint& p, const cv::KeyPoint& q) {
                      return p.pt == q.pt && p.angle == q.angle && p.octave == q.octave &&
                             p.response == q.response && p.size == q.size;
                    });
}

int occupied_cells(const std::vector<cv::KeyPoint>& keypoints, cv::Size size) {
  std::set<std::pair<int, int>> cells;
  for (const cv::KeyPoint& k : keypoints) {
    cells.insert({static_cast<int>(k.pt.x * 16 / static_cast<float>(size.width)),
                  static_cast<int>(k.pt.y * 12 / static_cast<float>(size.height))});
  }
  return static_cast<int>(cells.size());
}

TEST(OrbExtractor, FillsItsBudgetExactlyWhereThereIsTexture) {
  const cv::Mat image = texture(640, 480);
  for (const int budget : {1, 2, 3, 10, 100, 999, 1000, 2000}) {
    OrbOptions options;
    options.max_features = budget;
    const Features features = extract(image, {}, options);
    EXPECT_EQ(features.keypoints.size(), static_cast<std::size_t>(budget));
    EXPECT_EQ(features.descriptors.rows, budget);
    EXPECT_EQ(features.descriptors.cols, 32);
    EXPECT_EQ(features.descriptors.type(), CV_8UC1);
  }
}

TEST(OrbExtractor, KeyPointsAreOrderedInsideAndUnique) {
  const cv::Mat image = texture(641, 479);
  const OrbExtractor extractor;
  const Features features = extract(image);
  std::set<std::tuple<int, float, float>> places;
  int octave = 0;
  for (const cv::KeyPoint& k : features.keypoints) {
    ASSERT_GE(k.octave, octave);
    octave = k.octave;
    ASSERT_LT(octave, 8);
    const float scale = extractor.scale_factors()[static_cast<std::size_t>(octave)];
    EXPECT_FLOAT_EQ(k.size, 31.0F * scale);
    EXPECT_GE(k.angle, 0.0F);
    EXPECT_LT(k.angle, 360.0F);
    EXPECT_GE(k.response, 7.0F);
    EXPECT_EQ(k.class_id, -1);
    // A level's size is rounded: its border may lie half a level pixel farther out.
    const float reach = 19.0F * scale;
    EXPECT_GE(k.pt.x, reach - 1.0F);
    EXPECT_GE(k.pt.y, reach - 1.0F);
    EXPECT_LE(k.pt.x, 641.0F - reach + scale);
    EXPECT_LE(k.pt.y, 479.0F - reach + scale);
    EXPECT_TRUE(places.insert({octave, k.pt.x, k.pt.y}).second);
  }
  EXPECT_EQ(octave, 7);
}

TEST(OrbExtractor, NeverReturnsAFeatureOnTheMaskAndSpendsTheBudgetElsewhere) {
  const cv::Mat image = texture(640, 480);
  cv::Mat mask = cv::Mat::zeros(image.size(), CV_8UC1);
  cv::circle(mask, {250, 240}, 150, cv::Scalar(255), cv::FILLED);
  mask(cv::Rect(500, 0, 60, 480)) = 1;  // any value but 0
  const Features features = extract(image, mask);
  EXPECT_EQ(features.keypoints.size(), 1000U);
  for (const cv::KeyPoint& k : features.keypoints) {
    EXPECT_EQ(mask.at<std::uint8_t>(cvRound(k.pt.y), cvRound(k.pt.x)), 0) << k.pt;
  }
}

TEST(OrbExtractor, GivesACrowdABudgetOfItsOwn) {
  const cv::Mat image = texture(640, 480);
  cv::Mat crowd = cv::Mat::zeros(image.size(), CV_8UC1);
  cv::circle(crowd, {250, 240}, 150, cv::Scalar(255), cv::FILLED);
  cv::Mat mask = cv::Mat::zeros(image.size(), CV_8UC1);
  mask(cv::Rect(240, 0, 60, 480)) = 1;  // some of both
  OrbExtractor extractor;
  for (const auto& [elsewhere, there] :
       {std::pair(1500, 250), std::pair(1000, 0), std::pair(1, 700)}) {
    Features features;
    extractor.extract(view(image), view(mask), {elsewhere, view(crowd), there}, features.keypoints,
                      features.descriptors);
    int in_crowd = 0;
    for (const cv::KeyPoint& k : features.keypoints) {
      const cv::Point at(cvRound(k.pt.x), cvRound(k.pt.y));
      EXPECT_EQ(mask.at<std::uint8_t>(at), 0) << k.pt;
      in_crowd += crowd.at<std::uint8_t>(at) != 0;
    }
    EXPECT_EQ(in_crowd, there);
    EXPECT_EQ(features.keypoints.size(), static_cast<std::size_t>(elsewhere + there));
    EXPECT_EQ(features.descriptors.rows, elsewhere + there);
  }
}

TEST(OrbExtractor, BudgetOfOneImageCountsInsteadOfTheOptions) {
  const cv::Mat image = texture(640, 480);
  OrbOptions options;
  options.max_features = 300;
  const Features expected = extract(image, {}, options);
  OrbExtractor extractor;
  Features features;
  extractor.extract(view(image), {}, {300, {}, 0}, features.keypoints, features.descriptors);
  EXPECT_TRUE(same(features, expected));
  const cv::Mat nobody = cv::Mat::zeros(image.size(), CV_8UC1);
  extractor.extract(view(image), {}, {300, view(nobody), 100}, features.keypoints,
                    features.descriptors);
  EXPECT_TRUE(same(features, expected));
  extractor.extract(view(image), {}, features.keypoints, features.descriptors);
  EXPECT_EQ(features.keypoints.size(), 1000U);
}

TEST(OrbExtractor, RefusesBudgetsThatBreakTheirRules) {
  const cv::Mat image = texture(320, 240);
  const cv::Mat narrow = cv::Mat::zeros(240, 319, CV_8UC1);
  OrbExtractor extractor;
  Features features = extract(image);
  const std::size_t before = features.keypoints.size();
  for (const OrbBudget& bad :
       {OrbBudget{0, {}, 0}, OrbBudget{1000, {}, -1}, OrbBudget{1000, view(narrow), 100}}) {
    EXPECT_THROW(extractor.extract(view(image), {}, bad, features.keypoints, features.descriptors),
                 InvalidArgument);
  }
  EXPECT_EQ(features.keypoints.size(), before);
}

TEST(OrbExtractor, KeepsTheMarginOffTheMask) {
  const cv::Mat image = texture(640, 480);
  cv::Mat mask = cv::Mat::zeros(image.size(), CV_8UC1);
  cv::circle(mask, {250, 240}, 90, cv::Scalar(255), cv::FILLED);
  mask.at<std::uint8_t>(0, 0) = 255;
  mask.at<std::uint8_t>(479, 639) = 255;
  std::size_t in_the_margin = 0;
  for (const int margin : {0, 1, 9, 30}) {
    OrbOptions options;
    options.mask_margin = margin;
    const Features features = extract(image, mask, options);
    cv::Mat wide;
    const int side = 2 * margin + 1;
    cv::dilate(mask, wide, cv::getStructuringElement(cv::MORPH_RECT, {side, side}));
    for (const cv::KeyPoint& k : features.keypoints) {
      EXPECT_EQ(wide.at<std::uint8_t>(cvRound(k.pt.y), cvRound(k.pt.x)), 0) << k.pt;
      const double distance = std::hypot(k.pt.x - 250.0, k.pt.y - 240.0);
      in_the_margin += distance < 90 + margin + 5.0;
    }
  }
  EXPECT_GT(in_the_margin, 20U);  // and goes close to it
}

TEST(OrbExtractor, EmptyMaskMaskOfZerosAndMaskWithStrideAreTheSame) {
  const cv::Mat image = texture(320, 240);
  const Features expected = extract(image);
  EXPECT_TRUE(same(extract(image, cv::Mat::zeros(image.size(), CV_8UC1)), expected));
  const cv::Mat wide = cv::Mat::zeros(250, 400, CV_8UC1);
  EXPECT_TRUE(same(extract(image, wide(cv::Rect(7, 3, 320, 240))), expected));
}

TEST(OrbExtractor, FullyMaskedFlatBlackAndTinyImagesHaveNoFeatures) {
  const cv::Mat image = texture(320, 240);
  for (const Features& none :
       {extract(image, cv::Mat(image.size(), CV_8UC1, cv::Scalar(255))),
        extract(cv::Mat::zeros(240, 320, CV_8UC1)),
        extract(cv::Mat(240, 320, CV_8UC1, cv::Scalar(255))), extract(texture(1, 1)),
        extract(texture(38, 300)), extract(texture(300, 38)), extract(noise(2, 2, 1))}) {
    EXPECT_TRUE(none.keypoints.empty());
    EXPECT_TRUE(none.descriptors.empty());
  }
}

TEST(OrbExtractor, LeavesOutLevelsTooSmallForAPatch) {
  const Features smallest = extract(noise(39, 39, 3));
  for (const cv::KeyPoint& k : smallest.keypoints) EXPECT_EQ(k.pt, cv::Point2f(19.0F, 19.0F));
  OrbOptions options;
  options.max_features = 5000;
  const Features small = extract(noise(60, 80, 3), {}, options);
  EXPECT_GT(small.keypoints.size(), 10U);
  for (const cv::KeyPoint& k : small.keypoints) EXPECT_LE(k.octave, 2);  // 60 / 1.2^3 < 39
}

TEST(OrbExtractor, RefusesAnEmptyImageAndAMaskOfAnotherSizeAndLeavesOutputsAlone) {
  OrbExtractor extractor;
  std::vector<cv::KeyPoint> keypoints(3);
  cv::Mat descriptors(3, 32, CV_8UC1, cv::Scalar(7));
  const cv::Mat image = texture(100, 80);
  const cv::Mat mask = cv::Mat::zeros(80, 101, CV_8UC1);
  EXPECT_THROW(extractor.extract({}, {}, keypoints, descriptors), InvalidArgument);
  EXPECT_THROW(extractor.extract(view(image), view(mask), keypoints, descriptors), InvalidArgument);
  const std::uint8_t pixel = 0;
  EXPECT_THROW(extractor.extract(GrayView(&pixel, 70000, 1), {}, keypoints, descriptors),
               InvalidArgument);
  EXPECT_EQ(keypoints.size(), 3U);
  EXPECT_EQ(descriptors.rows, 3);
  EXPECT_EQ(descriptors.at<std::uint8_t>(2, 31), 7);
}

TEST(OrbExtractor, DependsOnTheImageOnlyNotOnWhatItSawBefore) {
  OrbExtractor used;
  Features features;
  for (const cv::Size size : {cv::Size(640, 480), cv::Size(101, 77), cv::Size(333, 222),
                              cv::Size(20, 20), cv::Size(640, 480), cv::Size(333, 222)}) {
    for (const unsigned seed : {1U, 2U}) {
      const cv::Mat image = texture(size.width, size.height, seed);
      used.extract(view(image), {}, features.keypoints, features.descriptors);
      EXPECT_TRUE(same(features, extract(image))) << size << " " << seed;
    }
  }
}

TEST(OrbExtractor, IsTheSameOnAllTargets) {
  const cv::Mat image = texture(333, 251, 4);
  cv::Mat mask = cv::Mat::zeros(image.size(), CV_8UC1);
  mask(cv::Rect(40, 30, 100, 90)) = 255;
  const Features expected = extract(image, mask);
  testing::for_each_target([&](const std::string& target) {
    EXPECT_TRUE(same(extract(image, mask), expected)) << target;
  });
}

TEST(OrbExtractor, IsTheSameWhateverTheRowStrideAndWhatLiesBetweenRows) {
  const cv::Mat image = texture(201, 143, 4);
  cv::Mat wide(143 + 8, 201 + 33, CV_8UC1, cv::Scalar(255));
  cv::Mat part = wide(cv::Rect(9, 4, 201, 143));
  image.copyTo(part);
  EXPECT_TRUE(same(extract(part), extract(image)));
}

TEST(OrbExtractor, WritesItsDescriptorsIntoAPartOfAMatrixWithoutTouchingTheRest) {
  const cv::Mat image = texture(320, 240);
  const Features expected = extract(image);
  cv::Mat wide(static_cast<int>(expected.keypoints.size()), 40, CV_8UC1, cv::Scalar(9));
  Features features;
  features.descriptors = wide.colRange(0, 32);
  OrbExtractor extractor;
  extractor.extract(view(image), {}, features.keypoints, features.descriptors);
  EXPECT_TRUE(same(features, expected));
  EXPECT_EQ(cv::countNonZero(wide != 9), 0);
}

TEST(OrbExtractor, OccupiesAtLeastThirtyPercentMoreCellsThanOpenCv) {
  // Texture of strong contrast on a part of the image, of weak contrast elsewhere.
  cv::Mat image = texture(640, 480, 3);
  cv::Mat calm = image.clone();
  calm = calm / 8 + 100;
  calm(cv::Rect(0, 0, 640, 330)).copyTo(image(cv::Rect(0, 0, 640, 330)));
  std::vector<cv::KeyPoint> opencv;
  cv::ORB::create(1000)->detect(image, opencv);
  const Features ours = extract(image);
  EXPECT_GE(ours.keypoints.size(), opencv.size());
  EXPECT_GE(occupied_cells(ours.keypoints, image.size()),
            1.3 * occupied_cells(opencv, image.size()));
}

TEST(OrbExtractor, TriesTheLowThresholdOnlyInCellsThatTheHighOneLeavesEmpty) {
  cv::Mat image = texture(640, 480, 3);
  image.colRange(0, 320) = image.colRange(0, 320) / 8 + 100;
  OrbOptions options;
  options.max_features = 20000;
  const Features features = extract(image, {}, options);
  ASSERT_LT(features.keypoints.size(), 20000U);  // all corners there are
  using Cell = std::tuple<int, int, int>;
  std::set<Cell> strong;
  std::set<Cell> weak;
  for (const cv::KeyPoint& k : features.keypoints) {
    const float scale = k.size / 31.0F;
    const int x = cvRound((k.pt.x + 0.5F) / scale - 0.5F);
    const int y = cvRound((k.pt.y + 0.5F) / scale - 0.5F);
    (k.response >= 20.0F ? strong : weak).insert({k.octave, x / 32, y / 32});
  }
  EXPECT_GT(strong.size(), 100U);
  EXPECT_GT(weak.size(), 100U);
  for (const Cell& cell : weak) EXPECT_EQ(strong.count(cell), 0U);

  options.min_fast_threshold = options.fast_threshold;
  for (const cv::KeyPoint& k : extract(image, {}, options).keypoints) {
    EXPECT_GE(k.response, 20.0F);
  }
}

TEST(OrbExtractor, OccupiesMoreCellsTheMoreItSpreads) {
  cv::Mat image = texture(640, 480, 3);
  image.rowRange(0, 240) = image.rowRange(0, 240) / 4 + 90;
  int cells = 0;
  for (const float spread : {0.0F, 0.5F, 1.0F}) {
    OrbOptions options;
    options.spread = spread;
    options.max_features = 500;
    const int now = occupied_cells(extract(image, {}, options).keypoints, image.size());
    EXPECT_GT(now, cells + 10) << spread;
    cells = now;
  }
}

TEST(OrbExtractor, PrefersTheStrongestCornersOfANeighbourhood) {
  const cv::Mat image = texture(640, 480, 5);
  OrbOptions few;
  few.max_features = 200;
  OrbOptions all;
  all.max_features = 100000;
  const auto mean_response = [](const Features& features) {
    double sum = 0.0;
    for (const cv::KeyPoint& k : features.keypoints) sum += static_cast<double>(k.response);
    return sum / static_cast<double>(features.keypoints.size());
  };
  EXPECT_GT(mean_response(extract(image, {}, few)), 1.3 * mean_response(extract(image, {}, all)));
}

TEST(OrbExtractor, TakesTheLargestOptions) {
  OrbOptions options;
  options.max_features = std::numeric_limits<int>::max();
  options.cell_size = std::numeric_limits<int>::max();
  options.mask_margin = 1024;
  const cv::Mat image = texture(200, 150);
  const cv::Mat mask = cv::Mat::zeros(image.size(), CV_8UC1);
  for (const int levels : {1, 32}) {
    options.levels = levels;
    EXPECT_GT(extract(image, mask, options).keypoints.size(), 50U);
  }
}

TEST(OrbExtractor, CanBeMoved) {
  OrbExtractor first;
  OrbExtractor second = std::move(first);
  const cv::Mat image = texture(200, 150);
  Features features;
  second.extract(view(image), {}, features.keypoints, features.descriptors);
  EXPECT_TRUE(same(features, extract(image)));
}

// -----------------------------------------------------------------------------------------------
// Repeatability: features of an image and of a warped copy of it.
// -----------------------------------------------------------------------------------------------

struct Repeatability {
  double found = 0.0;  // share of the features with one of the copy's at the same place
  double matched =
      0.0;  // share of those whose nearest descriptor in the copy is in the right place
};

cv::Point2f warped(const cv::Matx23d& warp, cv::Point2f p) {
  return {static_cast<float>(warp(0, 0) * p.x + warp(0, 1) * p.y + warp(0, 2)),
          static_cast<float>(warp(1, 0) * p.x + warp(1, 1) * p.y + warp(1, 2))};
}

Repeatability repeatability(const cv::Mat& image, double angle, double scale) {
  const cv::Matx23d warp = cv::getRotationMatrix2D({319.5F, 239.5F}, angle, scale);
  cv::Mat copy;
  cv::warpAffine(image, copy, warp, image.size(), cv::INTER_AREA, cv::BORDER_REFLECT_101);
  const Features a = extract(image);
  const Features b = extract(copy);
  int visible = 0;
  int found = 0;
  int matched = 0;
  std::vector<std::int32_t> distances(b.keypoints.size());
  for (std::size_t i = 0; i < a.keypoints.size(); ++i) {
    const cv::Point2f place = warped(warp, a.keypoints[i].pt);
    if (place.x < 70 || place.y < 70 || place.x > 570 || place.y > 410) continue;
    ++visible;
    const float tolerance = 2.0F * a.keypoints[i].size / 31.0F;
    const auto near = [&](const cv::KeyPoint& k) {
      return std::hypot(k.pt.x - place.x, k.pt.y - place.y) <= tolerance;
    };
    if (std::none_of(b.keypoints.begin(), b.keypoints.end(), near)) continue;
    ++found;
    hamming_distances(Span<const std::uint8_t>(a.descriptors.ptr(static_cast<int>(i)), 32),
                      as_view<const std::uint8_t>(b.descriptors), distances);
    const auto nearest = std::min_element(distances.begin(), distances.end()) - distances.begin();
    matched += near(b.keypoints[static_cast<std::size_t>(nearest)]);
  }
  EXPECT_GT(visible, 150);
  return {static_cast<double>(found) / visible, static_cast<double>(matched) / found};
}

TEST(OrbExtractor, FindsTheSamePlacesInATurnedImage) {
  const cv::Mat image = texture(640, 480, 6);
  for (const double angle : {10.0, 45.0, 90.0, 155.0}) {
    const Repeatability result = repeatability(image, angle, 1.0);
    EXPECT_GT(result.found, 0.6) << angle;
    EXPECT_GT(result.matched, 0.6) << angle;
  }
}

// RMS distance, in pixels of the level, of features from where the same features lie in a copy that
// is shifted by parts of a pixel and turned.
double placement_error(const cv::Mat& image, const OrbOptions& options) {
  cv::Matx23d warp = cv::getRotationMatrix2D({319.5F, 239.5F}, 4.0, 1.0);
  warp(0, 2) += 2.37;
  warp(1, 2) -= 1.71;
  cv::Mat copy;
  cv::warpAffine(image, copy, warp, image.size(), cv::INTER_CUBIC, cv::BORDER_REFLECT_101);
  const Features a = extract(image, {}, options);
  const Features b = extract(copy, {}, options);
  double sum = 0.0;
  int count = 0;
  for (const cv::KeyPoint& k : a.keypoints) {
    const cv::Point2f place = warped(warp, k.pt);
    double nearest = 1.5;
    for (const cv::KeyPoint& other : b.keypoints) {
      if (other.octave != k.octave) continue;
      nearest =
          std::min(nearest, 31.0 / k.size * std::hypot(other.pt.x - place.x, other.pt.y - place.y));
    }
    if (nearest == 1.5) continue;
    sum += nearest * nearest;
    ++count;
  }
  EXPECT_GT(count, 300);
  return std::sqrt(sum / count);
}

TEST(OrbExtractor, PlacesCornersBetweenPixels) {
  const cv::Mat image = texture(640, 480, 6);
  OrbOptions on_pixels;
  on_pixels.subpixel = false;
  EXPECT_LT(placement_error(image, {}), 0.7 * placement_error(image, on_pixels));
}

TEST(OrbExtractor, WithoutSubpixelPlacesCornersOnPixelsOfTheirLevel) {
  OrbOptions options;
  options.subpixel = false;
  options.levels = 1;
  for (const cv::KeyPoint& k : extract(texture(320, 240), {}, options).keypoints) {
    EXPECT_EQ(k.pt, cv::Point2f(cv::Point(k.pt)));
  }
}

TEST(OrbExtractor, FindsTheSamePlacesInAScaledImage) {
  const cv::Mat image = texture(640, 480, 6);
  for (const double scale : {0.7, 0.85, 1.3, 1.7}) {
    const Repeatability result = repeatability(image, 0.0, scale);
    EXPECT_GT(result.found, 0.5) << scale;
    EXPECT_GT(result.matched, 0.5) << scale;
  }
}

TEST(OrbExtractor, PlacesTheSameCornerAlikeOnAllLevels) {
  // The corner of a bright square, found on every level, must not drift with the level's scale.
  cv::Mat image(480, 640, CV_8UC1, cv::Scalar(60));
  image(cv::Rect(400, 300, 240, 180)) = 200;
  OrbOptions options;
  options.max_features = 5000;
  std::map<int, cv::Point2f> corner;
  for (const cv::KeyPoint& k : extract(image, {}, options).keypoints) corner[k.octave] = k.pt;
  ASSERT_EQ(corner.size(), 8U);
  for (const auto& [octave, place] : corner) {
    const float scale = OrbExtractor().scale_factors()[static_cast<std::size_t>(octave)];
    // FAST peaks within a pixel and a half of the corner, in pixels of the level.
    EXPECT_NEAR(place.x, 400.0F, 1.5F * scale) << octave;
    EXPECT_NEAR(place.y, 300.0F, 1.5F * scale) << octave;
  }
}

}  // namespace
}  // namespace dynslam::features
