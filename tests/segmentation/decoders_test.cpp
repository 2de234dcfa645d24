// Decoders against straightforward references.
#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/decoders/detection.hpp"
#include "dynslam/segmentation/decoders/prototype_mask.hpp"
#include "dynslam/segmentation/decoders/yolo.hpp"

namespace dynslam::segmentation {
namespace {

Detection box(float left, float top, float right, float bottom, float score, int class_id = 0,
              int index = 0) {
  return {class_id, score, left, top, right, bottom, index};
}

TEST(BoxIou, IsIntersectionOverUnion) {
  EXPECT_FLOAT_EQ(box_iou(box(0, 0, 2, 2, 1), box(0, 0, 2, 2, 1)), 1.0F);
  EXPECT_FLOAT_EQ(box_iou(box(0, 0, 2, 2, 1), box(1, 0, 3, 2, 1)), 1.0F / 3.0F);
  EXPECT_FLOAT_EQ(box_iou(box(0, 0, 2, 2, 1), box(2, 0, 3, 2, 1)), 0.0F);
}

TEST(SuppressNonMaxima, KeepsWhatTheSlowDefinitionKeeps) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> uniform(0.0F, 1.0F);
  std::vector<Detection> all;
  for (int i = 0; i < 300; ++i) {
    const float x = 100 * uniform(random);
    const float y = 100 * uniform(random);
    all.push_back(box(x, y, x + 10 + 30 * uniform(random), y + 10 + 30 * uniform(random),
                      std::round(20 * uniform(random)) / 20, i % 3, i));
  }
  // A box stays if no box that stays, of its class and better, overlaps it.
  std::vector<bool> stays(all.size(), false), decided(all.size(), false);
  const auto better = [&](std::size_t a, std::size_t b) {
    return all[a].score != all[b].score ? all[a].score > all[b].score : a < b;
  };
  for (std::size_t round = 0; round < all.size(); ++round) {
    std::size_t best = all.size();
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (!decided[i] && (best == all.size() || better(i, best))) best = i;
    }
    decided[best] = stays[best] = true;
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (i != best && stays[i] && all[i].class_id == all[best].class_id &&
          box_iou(all[i], all[best]) > 0.4F) {
        stays[best] = false;
        break;
      }
    }
  }
  std::vector<Detection> fast = all;
  suppress_non_maxima(fast, 0.4F, 1000);
  std::size_t expected = 0;
  for (const bool stay : stays) expected += stay ? 1 : 0;
  ASSERT_EQ(fast.size(), expected);
  for (std::size_t i = 0; i < fast.size(); ++i) {
    EXPECT_TRUE(stays[static_cast<std::size_t>(fast[i].index)]);
    if (i > 0) {
      EXPECT_GE(fast[i - 1].score, fast[i].score);
    }
  }
  suppress_non_maxima(fast, 0.4F, 5);
  EXPECT_EQ(fast.size(), 5U);
}

TEST(DecodeYolo, PassesOverWhatIsNotABox) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float inf = std::numeric_limits<float>::infinity();
  const float rows[6][6] = {{5, 5, 4, 4, 0.9F, 0.9F},   {nan, 5, 4, 4, 0.9F, 0.9F},
                            {5, 5, inf, 4, 0.9F, 0.9F}, {5, 5, 0, 4, 0.9F, 0.9F},
                            {5, 5, 4, -4, 0.9F, 0.9F},  {5, 5, 4, 4, nan, 0.9F}};
  std::vector<Detection> found;
  decode_yolov5(MatrixView(&rows[0][0], 6, 6), 1, 0.3F, found);
  ASSERT_EQ(found.size(), 1U);
  EXPECT_FLOAT_EQ(found[0].score, 0.81F);
  EXPECT_FLOAT_EQ(found[0].left, 3.0F);
  EXPECT_FLOAT_EQ(found[0].bottom, 7.0F);
}

TEST(DecodeYolo, RowsAndColumnsOfTheSameCandidatesAgree) {
  constexpr int kCount = 700, kClasses = 7;
  std::mt19937 random(5);
  std::uniform_real_distribution<float> uniform(0.0F, 1.0F);
  std::vector<float> rows(kCount * (5 + kClasses)), columns((4 + kClasses) * kCount);
  for (int i = 0; i < kCount; ++i) {
    float* row = rows.data() + i * (5 + kClasses);
    for (int v = 0; v < 4; ++v) row[v] = 10 + 50 * uniform(random);
    row[4] = 1.0F;
    for (int c = 0; c < kClasses; ++c) row[5 + c] = uniform(random);
    for (int v = 0; v < 4; ++v) columns[static_cast<std::size_t>(v * kCount + i)] = row[v];
    for (int c = 0; c < kClasses; ++c) {
      columns[static_cast<std::size_t>((4 + c) * kCount + i)] = row[5 + c];
    }
  }
  std::vector<Detection> by_rows, by_columns;
  decode_yolov5(MatrixView(rows.data(), 5 + kClasses, kCount), kClasses, 0.8F, by_rows);
  decode_yolov8(MatrixView(columns.data(), kCount, 4 + kClasses), kClasses, 0.8F, by_columns);
  ASSERT_EQ(by_rows.size(), by_columns.size());
  ASSERT_GT(by_rows.size(), 100U);
  for (std::size_t i = 0; i < by_rows.size(); ++i) {
    EXPECT_EQ(by_rows[i].index, by_columns[i].index);
    EXPECT_EQ(by_rows[i].class_id, by_columns[i].class_id);
    EXPECT_EQ(by_rows[i].score, by_columns[i].score);
    EXPECT_EQ(by_rows[i].right, by_columns[i].right);
  }
}

TEST(DecodeYolo, RefusesMatricesThatAreTooSmall) {
  const float values[24] = {};
  std::vector<Detection> out;
  EXPECT_THROW(decode_yolov5(MatrixView(values, 6, 4), 2, 0.3F, out), InvalidArgument);
  EXPECT_THROW(decode_yolov8(MatrixView(values, 6, 4), 1, 0.3F, out), InvalidArgument);
  EXPECT_THROW(decode_yolov5(MatrixView(values, 6, 4), 0, 0.3F, out), InvalidArgument);
  EXPECT_THROW(decode_yolov8(MatrixView(values, 6, 4), 0, 0.3F, out), InvalidArgument);
  EXPECT_NO_THROW(decode_yolov5(MatrixView(), 2, 0.3F, out));
  EXPECT_NO_THROW(decode_yolov8(MatrixView(), 2, 0.3F, out));
  EXPECT_TRUE(out.empty());
}

TEST(Letterbox, RoundsTheScaledImageAndCentresIt) {
  const Letterbox box = make_letterbox({640, 360}, {640, 480});
  EXPECT_EQ(box.inner, cv::Rect(0, 60, 640, 360));
  EXPECT_EQ(make_letterbox({1241, 376}, {640, 640}).inner, cv::Rect(0, 223, 640, 194));
  EXPECT_EQ(make_letterbox({1241, 376}, {640, 640}, LetterboxPlace::kUpperLeft).inner,
            cv::Rect(0, 0, 640, 194));
  EXPECT_EQ(make_letterbox({1241, 376}, {640, 640}, LetterboxPlace::kStretch).inner,
            cv::Rect(0, 0, 640, 640));
  EXPECT_EQ(make_letterbox({10000, 1}, {64, 64}).inner.height, 1);
  EXPECT_THROW(make_letterbox({0, 5}, {64, 64}), InvalidArgument);
  EXPECT_THROW(make_letterbox({5, 5}, {64, 0}), InvalidArgument);
}

TEST(Letterbox, BringsABoxBackToTheImage) {
  const Letterbox map = make_letterbox({1280, 720}, {640, 480});
  EXPECT_EQ(map.to_image(box(100, 160, 200, 260, 1)), cv::Rect(200, 200, 200, 200));
  EXPECT_EQ(map.to_image(box(-50, 0, 10, 480, 1)), cv::Rect(0, 0, 20, 720));
  EXPECT_TRUE(map.to_image(box(10, 0, 50, 50, 1)).empty()) << "in the border only";
}

TEST(FillInput, GivesPlanesOfScaledPixelsAndABorder) {
  const cv::Mat image(10, 20, CV_8UC3, cv::Scalar(10, 20, 30));
  const Letterbox map = make_letterbox(image.size(), {20, 20});
  std::vector<float> blob;
  std::vector<cv::Mat> scratch;
  PixelScale pixels;
  fill_input(image, map, pixels, blob, scratch);
  ASSERT_EQ(blob.size(), 1200U);
  EXPECT_FLOAT_EQ(blob[10 * 20], 30.0F / 255) << "red first";
  EXPECT_FLOAT_EQ(blob[800 + 10 * 20], 10.0F / 255) << "blue last";
  EXPECT_FLOAT_EQ(blob[0], 114.0F / 255);
  pixels.rgb = false;
  pixels.factor[0] = 2.0F;
  pixels.mean[0] = 4.0F;
  fill_input(image, map, pixels, blob, scratch);
  EXPECT_FLOAT_EQ(blob[10 * 20], (10 - 4) * 2.0F);
  EXPECT_FLOAT_EQ(blob[0], (114 - 4) * 2.0F);
  EXPECT_THROW(fill_input(cv::Mat(5, 5, CV_8UC3), map, pixels, blob, scratch), InvalidArgument);
  EXPECT_THROW(fill_input(cv::Mat(10, 20, CV_32FC3), map, pixels, blob, scratch), InvalidArgument);
}

class PrototypeMask : public ::testing::TestWithParam<cv::Size> {};

// The definition, with all cells and OpenCV's interpolation: sum, scale the network's input to the
// image's pixels, threshold, cut.
TEST_P(PrototypeMask, AgreesWithSummingEverythingAndScaling) {
  constexpr int kChannels = 7, kHeight = 30, kWidth = 40;
  std::mt19937 random(11);
  std::normal_distribution<float> normal;
  std::vector<float> values(kChannels * kHeight * kWidth);
  for (float& value : values) value = normal(random);
  const TensorView<const float> prototypes(values.data(), kChannels, kHeight, kWidth);
  const std::vector<float> coefficients = {0.5F, -1.0F, 2.0F, 0.1F, -0.3F, 1.0F, 0.7F};
  const Letterbox map = make_letterbox(GetParam(), {160, 120});

  cv::Mat logits = cv::Mat::zeros(kHeight, kWidth, CV_32F);
  for (int c = 0; c < kChannels; ++c) {
    logits += coefficients[static_cast<std::size_t>(c)] *
              cv::Mat(kHeight, kWidth, CV_32F, const_cast<float*>(prototypes.plane(c)));
  }
  cv::Mat where_x(GetParam(), CV_32F), where_y(GetParam(), CV_32F), reference;
  for (int y = 0; y < where_x.rows; ++y) {
    for (int x = 0; x < where_x.cols; ++x) {
      where_x.at<float>(y, x) =
          static_cast<float>(((x + 0.5) * map.scale_x + map.inner.x) / 4.0 - 0.5);
      where_y.at<float>(y, x) =
          static_cast<float>(((y + 0.5) * map.scale_y + map.inner.y) / 4.0 - 0.5);
    }
  }
  cv::remap(logits, reference, where_x, where_y, cv::INTER_LINEAR, cv::BORDER_REPLICATE);

  PrototypeScratch scratch;
  const cv::Size size = GetParam();
  for (const cv::Rect part :
       {cv::Rect(cv::Point(), size), cv::Rect(size.width / 3, size.height / 4, 20, 9),
        cv::Rect(size.width - 1, size.height - 1, 1, 1), cv::Rect(0, 3, 5, 1)}) {
    const cv::Mat mask = prototype_mask(prototypes, coefficients, map, part, scratch);
    ASSERT_EQ(mask.size(), part.size());
    int wrong = 0;
    for (int y = 0; y < part.height; ++y) {
      for (int x = 0; x < part.width; ++x) {
        const float logit = reference.at<float>(part.y + y, part.x + x);
        // remap interpolates in steps of 1/32 of a cell: near zero it may be on the other side.
        if (std::abs(logit) > 0.2F && (mask.at<std::uint8_t>(y, x) == 255) != (logit > 0)) ++wrong;
        EXPECT_TRUE(mask.at<std::uint8_t>(y, x) == 0 || mask.at<std::uint8_t>(y, x) == 255);
      }
    }
    EXPECT_EQ(wrong, 0) << size << " " << part;
  }
}

INSTANTIATE_TEST_SUITE_P(Sizes, PrototypeMask,
                         ::testing::Values(cv::Size(160, 120), cv::Size(640, 480),
                                           cv::Size(100, 120), cv::Size(333, 77), cv::Size(60, 45)),
                         [](const auto& test) {
                           return std::to_string(test.param.width) + "x" +
                                  std::to_string(test.param.height);
                         });

TEST(PrototypeMaskContract, IsChecked) {
  const std::vector<float> values(2 * 4 * 4);
  const TensorView<const float> prototypes(values.data(), 2, 4, 4);
  const Letterbox map = make_letterbox({16, 16}, {16, 16});
  const std::vector<float> two(2), three(3);
  PrototypeScratch scratch;
  EXPECT_NO_THROW(prototype_mask(prototypes, two, map, {0, 0, 16, 16}, scratch));
  EXPECT_THROW(prototype_mask(prototypes, three, map, {0, 0, 4, 4}, scratch), InvalidArgument);
  EXPECT_THROW(prototype_mask({}, two, map, {0, 0, 4, 4}, scratch), InvalidArgument);
  EXPECT_THROW(prototype_mask(prototypes, two, map, {10, 0, 8, 4}, scratch), InvalidArgument);
  EXPECT_THROW(prototype_mask(prototypes, two, map, {0, 0, 0, 4}, scratch), InvalidArgument);
}

TEST(PrototypeMaskContract, NanIsOutsideTheMask) {
  const std::vector<float> values(16, std::numeric_limits<float>::quiet_NaN());
  const std::vector<float> one = {1.0F};
  PrototypeScratch scratch;
  const cv::Mat mask = prototype_mask(TensorView<const float>(values.data(), 1, 4, 4), one,
                                      make_letterbox({16, 16}, {16, 16}), {0, 0, 16, 16}, scratch);
  EXPECT_EQ(cv::countNonZero(mask), 0);
}

}  // namespace
}  // namespace dynslam::segmentation
