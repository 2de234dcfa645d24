#include "dynslam/geometry/appearance.hpp"

#include <cmath>
#include <cstdint>
#include <vector>

#include <gtest/gtest.h>

#include "geometry/synthetic.hpp"

namespace dynslam::geometry {
namespace {

using synthetic::kCamera;

constexpr float kWall = 2.0F;  // metres
constexpr int kCellColumns = 160, kCellRows = 120, kCellPixels = 4;

// A painted wall at z = 2 m, seen before from the origin and now from `t_world_cam` beside it.
class Appearance : public ::testing::Test {
 protected:
  Appearance() {
    const std::vector<float> image(640 * 480, kWall);
    build_depth_cells({image.data(), 640, 480}, kCamera, {}, cells_);
    look_from({0.1, 0.05, 0.0});
    now_ = paint(t_world_cam_, 0.0);
    before_ = paint(Eigen::Vector3d::Zero(), 0.0);
  }

  void look_from(const Eigen::Vector3d& t_world_cam) {
    t_world_cam_ = t_world_cam;
    reference_ = {RigidTransform(Eigen::Matrix3d::Identity(), -t_world_cam), &cells_, 0.5};
  }

  /// Grey cells of the wall, its paint `slid` metres to the right.
  static std::vector<std::uint8_t> paint(const Eigen::Vector3d& t_world_cam, double slid) {
    std::vector<std::uint8_t> gray(kCellColumns * kCellRows);
    for (int y = 0; y < kCellRows; ++y) {
      for (int x = 0; x < kCellColumns; ++x) {
        const Eigen::Vector3d X =
            t_world_cam + kWall * kCamera.bearing({kCellPixels * x + 1.5, kCellPixels * y + 1.5});
        const double u = X.x() - slid, v = X.y();
        const double level =
            std::sin(31.0 * u + 7.0 * v) + std::sin(47.0 * v - 11.0 * u) + std::sin(23.0 * u * v);
        gray[static_cast<std::size_t>(y * kCellColumns + x)] =
            static_cast<std::uint8_t>(std::lround(128.0 + 30.0 * level));
      }
    }
    return gray;
  }

  /// What is added to each cell's evidence, of which there was `known`.
  std::vector<float> votes(const AppearanceOptions& options = {}, float known = 0.0F) {
    DepthEvidence evidence;
    const std::vector<float> depth(640 * 480, depth_now_);
    judge_depth({depth.data(), 640, 480}, kCamera, {}, {}, evidence);
    evidence.log_odds.assign(evidence.log_odds.size(), known);
    const MaskView gray =
        before_.empty() ? MaskView() : MaskView(before_.data(), kCellColumns, kCellRows);
    add_appearance(kCamera, {now_.data(), kCellColumns, kCellRows}, {&reference_, 1}, {&gray, 1},
                   {}, options, workspace_, evidence);
    for (float& odds : evidence.log_odds) odds -= known;
    return evidence.log_odds;
  }

  static double share(const std::vector<float>& votes, float sign) {
    double count = 0;
    for (const float vote : votes) count += vote * sign > 0.0F;
    return count / static_cast<double>(votes.size());
  }

  DepthCells cells_;
  Eigen::Vector3d t_world_cam_;
  DepthReference reference_;
  std::vector<std::uint8_t> now_, before_;
  float depth_now_ = kWall;
  AppearanceWorkspace workspace_;
};

TEST_F(Appearance, WhatStandsStillLooksAsItDidFromElsewhere) {
  const std::vector<float> found = votes();
  EXPECT_GT(share(found, -1.0F), 0.85);  // the rest was outside of the reference's image
  EXPECT_EQ(share(found, 1.0F), 0.0);
}

TEST_F(Appearance, ASurfaceThatSlidesWithinItselfIsAccused) {
  const std::vector<std::uint8_t> slid = paint(t_world_cam_, 0.1);
  for (std::size_t i = 0; i < slid.size(); ++i) {
    if (i % kCellColumns < kCellColumns / 2) now_[i] = slid[i];  // the left half of the wall
  }
  const std::vector<float> found = votes();
  EXPECT_GT(share(found, 1.0F), 0.6 / 2);
  EXPECT_GT(share(found, -1.0F), 0.85 / 2);
}

TEST_F(Appearance, AccusesLessWhereEverythingIsUnlike) {
  now_ = paint(t_world_cam_, 0.04);  // as under a wrong pose
  AppearanceOptions regardless;
  regardless.below = 0.0;
  const float still = -1.0F;
  EXPECT_LT(share(votes({}, still), 1.0F), share(votes(regardless, still), 1.0F));
}

TEST_F(Appearance, LightThatChangesDoesNotMatter) {
  for (std::uint8_t& level : now_) level = static_cast<std::uint8_t>(30 + level / 2);
  EXPECT_GT(share(votes(), -1.0F), 0.85);
}

TEST_F(Appearance, SaysNothingWhereThereIsNothingToSee) {
  now_.assign(now_.size(), 90);
  before_.assign(before_.size(), 140);
  EXPECT_EQ(share(votes(), 1.0F) + share(votes(), -1.0F), 0.0);
}

TEST_F(Appearance, SaysNothingWhereDepthsDisagreeOrAreMissing) {
  depth_now_ = 1.5F;
  EXPECT_EQ(share(votes(), 1.0F) + share(votes(), -1.0F), 0.0);
  depth_now_ = synthetic::kNaN;
  EXPECT_EQ(share(votes(), 1.0F) + share(votes(), -1.0F), 0.0);
}

TEST_F(Appearance, SkipsReferencesWithoutLooksOrCells) {
  before_.clear();
  EXPECT_EQ(share(votes(), -1.0F), 0.0);
  before_ = now_;
  reference_.cells = nullptr;
  EXPECT_EQ(share(votes(), -1.0F), 0.0);
}

TEST_F(Appearance, IsTheFormulaWrittenOut) {
  look_from(Eigen::Vector3d::Zero());
  std::uint32_t state = 1;
  for (auto* gray : {&now_, &before_}) {
    for (std::uint8_t& level : *gray) {
      state = state * 1664525U + 1013904223U;
      level = static_cast<std::uint8_t>(100 + (state >> 27));
    }
  }
  AppearanceOptions options;
  options.scale = 2.0;  // no clamping
  options.neutral = -0.5;
  options.below = 0.0;
  const std::vector<float> found = votes(options);
  const int r = options.radius;
  for (const int y : {r + 1, 40, kCellRows - 3 - r}) {
    for (const int x : {r + 1, 77, kCellColumns - 3 - r}) {
      double n = 0, a = 0, b = 0, aa = 0, bb = 0, ab = 0;
      for (int v = y - r; v <= y + r; ++v) {
        for (int u = x - r; u <= x + r; ++u) {
          const double p = now_[static_cast<std::size_t>(v * kCellColumns + u)];
          const double q = before_[static_cast<std::size_t>(v * kCellColumns + u)];
          n += 1, a += p, b += q, aa += p * p, bb += q * q, ab += p * q;
        }
      }
      const double var_a = aa / n - a * a / n / n + options.noise * options.noise;
      const double var_b = bb / n - b * b / n / n + options.noise * options.noise;
      const double likeness = (ab / n - a * b / n / n) / std::sqrt(var_a * var_b);
      EXPECT_NEAR(found[static_cast<std::size_t>(y * kCellColumns + x)],
                  options.evidence * (options.neutral - likeness) / options.scale, 2e-2);
    }
  }
}

TEST_F(Appearance, RefusesWhatDoesNotFit) {
  const MaskView gray(before_.data(), kCellColumns, kCellRows), small(before_.data(), 80, 60);
  const auto add = [&](const MaskView& now, Span<const MaskView> grays, DepthEvidence& evidence) {
    add_appearance(kCamera, now, {&reference_, 1}, grays, {}, {}, workspace_, evidence);
  };
  DepthEvidence evidence, none;
  const std::vector<float> depth(640 * 480, kWall);
  judge_depth({depth.data(), 640, 480}, kCamera, {}, {}, evidence);
  EXPECT_THROW(add(gray, {&gray, 1}, none), InvalidArgument);
  EXPECT_THROW(add(small, {&gray, 1}, evidence), InvalidArgument);
  EXPECT_THROW(add({}, {&gray, 1}, evidence), InvalidArgument);
  EXPECT_THROW(add(gray, {}, evidence), InvalidArgument);
  EXPECT_THROW(add(gray, {&small, 1}, evidence), InvalidArgument);
  for (const float odds : evidence.log_odds) ASSERT_EQ(odds, 0.0F);
}

TEST(AppearanceOptions, RefusesEachInvalidOption) {
  const auto refused = [](auto member, auto value) {
    AppearanceOptions options;
    options.*member = value;
    EXPECT_THROW(options.validate(), InvalidArgument);
  };
  EXPECT_NO_THROW(AppearanceOptions().validate());
  refused(&AppearanceOptions::radius, 0);
  refused(&AppearanceOptions::radius, 17);
  for (const double bad : {0.0, std::nan("")}) {
    refused(&AppearanceOptions::noise, bad);
    refused(&AppearanceOptions::scale, bad);
    refused(&AppearanceOptions::evidence, bad);
    refused(&AppearanceOptions::least_seen, bad);
  }
  refused(&AppearanceOptions::least_seen, 1.1);
  refused(&AppearanceOptions::texture, -1.0);
  refused(&AppearanceOptions::below, -0.1);
  refused(&AppearanceOptions::neutral, 1.0);
  refused(&AppearanceOptions::neutral, -1.0);
}

}  // namespace
}  // namespace dynslam::geometry
