#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <set>
#include <utility>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/scene.hpp"

#include "dataset/scene_testing.hpp"

namespace dynslam::dataset {
namespace {

TEST(RenderedScene, SameSeedGivesTheSameBitsInAnyOrder) {
  const RenderedScene a(small(3)), b(small(3));
  const Frame a3 = a.render(3), a50 = a.render(50);
  const Frame b50 = b.render(50);
  b.truth(7);
  b.render(80);
  const Frame b3 = b.render(3);
  EXPECT_TRUE(same_frame(a3, b3));
  EXPECT_TRUE(same_frame(a50, b50));
  EXPECT_TRUE(same_frame(a3, a.render(3)));
  EXPECT_FALSE(same_bits(a3.color, a50.color));
}

TEST(RenderedScene, ThreadsDoNotChangeABit) {
  SceneOptions options = small(2, 200, 150);
  const Frame one = shared_scene(options).render(33);
  options.threads = 3;
  EXPECT_TRUE(same_frame(one, shared_scene(options).render(33)));
}

TEST(RenderedScene, OtherSeedsAreOtherScenes) {
  SceneOptions options = clean(1);
  options.movers = false;
  const RenderedScene a = shared_scene(options);
  options.seed = 2;
  const RenderedScene b = shared_scene(options);
  EXPECT_GT((a.T_world_cam(0).t - b.T_world_cam(0).t).norm(), 1e-3);
  EXPECT_FALSE(same_bits(a.exact_depth(0), b.exact_depth(0)));
  EXPECT_GT(cv::norm(a.render(0).color, b.render(0).color, cv::NORM_L1) / (160.0 * 120.0 * 3.0),
            8.0);
}

TEST(RenderedScene, PointsKeepTheirColoursFromFrameToFrame) {
  const RenderedScene scene = shared_scene(clean(3, 320, 240));
  for (const auto& [from, to] : {std::pair(80U, 82U), std::pair(250U, 247U)}) {
    const Frame a = scene.render(from), b = scene.render(to);
    cv::Mat gray_a, gray_b;
    cv::cvtColor(a.color, gray_a, cv::COLOR_BGR2GRAY);
    cv::cvtColor(b.color, gray_b, cv::COLOR_BGR2GRAY);
    double off[2] = {}, shuffled[2] = {};
    int count[2] = {};
    for (int y = 4; y < 236; y += 5) {
      for (int x = 4; x < 316; x += 5) {
        const auto c = scene.correspondence(from, {x, y}, to);
        if (!c || !c->visible || !scene.camera().contains(c->pixel, 4.0)) continue;
        const int px = static_cast<int>(c->pixel.x()), py = static_cast<int>(c->pixel.y());
        const double fx = c->pixel.x() - px, fy = c->pixel.y() - py;
        const auto g = [&](int dx, int dy) {
          return static_cast<double>(gray_b.at<std::uint8_t>(py + dy, px + dx));
        };
        const double there = (1 - fy) * ((1 - fx) * g(0, 0) + fx * g(1, 0)) +
                             fy * ((1 - fx) * g(0, 1) + fx * g(1, 1));
        const double here = static_cast<double>(gray_a.at<std::uint8_t>(y, x));
        const int k = c->label == kStaticLabel ? 0 : 1;
        off[k] += std::abs(there - here);
        shuffled[k] += std::abs(g(3, 3) - here);
        ++count[k];
      }
    }
    for (int k = 0; k < 2; ++k) {  // the room, the movers
      ASSERT_GT(count[k], 100) << from;
      EXPECT_LT(off[k] / count[k], 7.0) << from << " " << k;
      EXPECT_LT(off[k], 0.5 * shuffled[k]) << from << " " << k;
    }
  }
}

TEST(RenderedScene, CornersAreSpreadOverTheImage) {
  SceneOptions options;
  options.movers = false;
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    options.seed = seed;
    const RenderedScene scene = shared_scene(options);
    for (const std::size_t i : {0U, 150U}) {
      cv::Mat gray, corners;
      cv::cvtColor(scene.render(i).color, gray, cv::COLOR_BGR2GRAY);
      cv::goodFeaturesToTrack(gray, corners, 2000, 0.01, 6.0);
      std::set<int> cells;  // 16 x 12 cells of 40 pixels
      for (int k = 0; k < corners.rows; ++k) {
        const auto& p = corners.at<cv::Point2f>(k);
        cells.insert(static_cast<int>(p.y / 40.0F) * 16 + static_cast<int>(p.x / 40.0F));
      }
      EXPECT_GT(corners.rows, 800) << seed;
      EXPECT_GT(cells.size(), 150U) << seed;
    }
  }
}

TEST(RenderedScene, BlurSmearsAlongTheMotionAndMovesNothing) {
  SceneOptions options = clean(2, 320, 240);
  options.exposure_time = 0.030;
  options.movers = false;
  const RenderedScene sharp_scene = shared_scene(options);
  options.motion_blur = true;
  const RenderedScene blurred_scene = shared_scene(options);
  options.exposure_time = 0.0;
  const Frame sharp = sharp_scene.render(120), blurred = blurred_scene.render(120);
  EXPECT_TRUE(same_bits(sharp.color, shared_scene(options).render(120).color));
  const auto energy = [](const cv::Mat& image) {
    cv::Mat gray, gx;
    cv::cvtColor(image, gray, cv::COLOR_BGR2GRAY);
    cv::Laplacian(gray, gx, CV_32F);
    return cv::norm(gx);
  };
  EXPECT_LT(energy(blurred.color), 0.9 * energy(sharp.color));
  EXPECT_NEAR(cv::mean(blurred.color)[1], cv::mean(sharp.color)[1], 0.7);
  // Neither is ahead of the other: the best shift between them is none.
  cv::Mat a, b;
  cv::cvtColor(sharp.color, a, cv::COLOR_BGR2GRAY);
  cv::cvtColor(blurred.color, b, cv::COLOR_BGR2GRAY);
  a.convertTo(a, CV_32F);
  b.convertTo(b, CV_32F);
  const cv::Point2d shift = cv::phaseCorrelate(a, b);
  EXPECT_LT(std::hypot(shift.x, shift.y), 0.15);
}

TEST(RenderedScene, MaskAndDepthAreThoseOfTheMiddleOfTheExposureWhateverTheBlur) {
  SceneOptions options = small(2);
  options.depth_noise = false;
  const RenderedScene scene = shared_scene(options);
  const Frame frame = scene.render(90);
  const SceneTruth truth = scene.truth(90);
  EXPECT_TRUE(same_bits(frame.depth, truth.depth));
  EXPECT_TRUE(same_bits(frame.mask, truth.mask));
  EXPECT_TRUE(same_bits(truth.depth, scene.exact_depth(90)));
}

TEST(RenderedScene, ExposureDriftsSlowlyByAboutFifteenPercent) {
  SceneOptions options = clean(1, 64, 48);
  options.movers = false;
  options.camera_speed = options.tremor = 0.0;
  options.exposure_drift = true;
  const RenderedScene scene = shared_scene(options);
  double low = 1e9, high = 0.0, before = 0.0;
  for (std::size_t i = 0; i < 900; i += 10) {
    const double light = std::pow(cv::mean(scene.render(i).color)[1], 2.2);
    if (i > 0) {
      EXPECT_LT(std::abs(light / before - 1.0), 0.06) << i;
    }
    before = light;
    low = std::min(low, light);
    high = std::max(high, light);
  }
  EXPECT_GT(high / low, 1.15);
  EXPECT_LT(high / low, 1.45);
}

TEST(RenderedScene, ImageNoiseIsOneToThreeGreyLevelsAndNewInEveryFrame) {
  SceneOptions options = clean(1, 320, 240);
  options.movers = false;
  options.camera_speed = options.tremor = 0.0;
  const Frame quiet = shared_scene(options).render(0);
  options.image_noise = true;
  const RenderedScene scene = shared_scene(options);
  cv::Mat noise[2];
  for (std::size_t k = 0; k < 2; ++k) {
    cv::Mat image;
    scene.render(k).color.convertTo(image, CV_32F);
    cv::Mat base;
    quiet.color.convertTo(base, CV_32F);
    noise[k] = image - base;
    cv::Scalar mean, sigma;
    cv::meanStdDev(noise[k], mean, sigma);
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(mean[c], 0.0, 0.1);
      EXPECT_GT(sigma[c], 0.8);
      EXPECT_LT(sigma[c], 3.0);
    }
  }
  const double product = noise[0].dot(noise[1]) / (cv::norm(noise[0]) * cv::norm(noise[1]));
  EXPECT_LT(std::abs(product), 0.03);
}

TEST(RenderedScene, DepthNoiseHasTheStatedSpread) {
  SceneOptions options = small(1, 640, 480);
  const RenderedScene scene = shared_scene(options);
  struct Bin {
    double sum = 0.0, squares = 0.0;
    int count = 0;
  };
  std::map<int, Bin> bins;  // of a quarter of a metre
  for (const std::size_t i : {0U, 40U, 90U, 140U}) {
    const cv::Mat exact = scene.exact_depth(i), measured = scene.render(i).depth;
    for (int y = 0; y < exact.rows; ++y) {
      for (int x = 0; x < exact.cols; ++x) {
        const double z = static_cast<double>(exact.at<float>(y, x));
        const double m = static_cast<double>(measured.at<float>(y, x));
        if (m == 0.0) continue;
        Bin& bin = bins[static_cast<int>(z / 0.25)];
        const double sigma = 0.0012 + 0.0019 * (z - 0.4) * (z - 0.4);
        const double e = (m - z) / sigma;
        bin.sum += e;
        bin.squares += e * e;
        ++bin.count;
      }
    }
  }
  int checked = 0;
  for (const auto& [quarter, bin] : bins) {
    if (bin.count < 5000) continue;
    ++checked;
    const double mean = bin.sum / bin.count;
    EXPECT_NEAR(std::sqrt(bin.squares / bin.count - mean * mean), 1.0, 0.06) << 0.25 * quarter;
    EXPECT_NEAR(mean, 0.0, 0.12) << 0.25 * quarter;
  }
  EXPECT_GE(checked, 8);
}

TEST(RenderedScene, MeasuredDisparitiesAreWholeSteps) {
  const Frame frame = shared_scene(small()).render(5);
  int measured = 0;
  for (int y = 0; y < frame.depth.rows; ++y) {
    for (int x = 0; x < frame.depth.cols; ++x) {
      const double z = static_cast<double>(frame.depth.at<float>(y, x));
      if (z == 0.0) continue;
      const double steps = 8.0 * 575.0 * 0.075 / z;
      ASSERT_NEAR(steps, std::round(steps), 1e-3);
      ++measured;
    }
  }
  EXPECT_GT(measured, 160 * 120 / 2);
}

TEST(RenderedScene, DepthIsMissingLeftOfForegroundEdgesAndOutOfRange) {
  const RenderedScene scene = shared_scene(small(1, 320, 240));
  int left = 0, left_lost = 0, right = 0, right_lost = 0, holes = 0, pixels = 0;
  for (const std::size_t i : {30U, 100U, 170U}) {
    const cv::Mat measured = scene.render(i).depth;
    const SceneTruth truth = scene.truth(i);
    for (int y = 0; y < measured.rows; ++y) {
      for (int x = 3; x + 3 < measured.cols; ++x) {
        const float z = truth.depth.at<float>(y, x);
        const float m = measured.at<float>(y, x);
        if (z < 0.5F || z > 8.0F) {
          ASSERT_EQ(m, 0.0F);
        }
        ASSERT_TRUE(m == 0.0F || (m > 0.45F && m < 9.5F));
        ++pixels;
        holes += m == 0.0F ? 1 : 0;
        if (truth.mask.at<std::uint8_t>(y, x) != kStaticLabel) continue;
        // Two pixels left or right of a person who stands a metre nearer.
        const auto before = [&](int at) {
          return truth.mask.at<std::uint8_t>(y, at) != kStaticLabel &&
                 truth.depth.at<float>(y, at) < z - 1.0F;
        };
        if (before(x + 2)) ++left, left_lost += m == 0.0F ? 1 : 0;
        if (before(x - 2)) ++right, right_lost += m == 0.0F ? 1 : 0;
      }
    }
  }
  ASSERT_GT(left, 200);
  ASSERT_GT(right, 200);
  EXPECT_GT(left_lost, left * 8 / 10);
  EXPECT_LT(right_lost, right * 3 / 10);
  EXPECT_GT(holes, pixels / 300);
  EXPECT_LT(holes, pixels / 5);
}

}  // namespace
}  // namespace dynslam::dataset
