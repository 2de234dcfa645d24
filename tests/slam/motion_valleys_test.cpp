#include "slam/motion_valleys.hpp"

#include <algorithm>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/so3.hpp"

#include "two_view_matches.hpp"

namespace dynslam::slam {
namespace {

const RigidTransform kStep(so3_exp({0.02, -0.1, 0.03}), {-0.6, 0.1, 0.15});

std::vector<PixelMatch> pixels(const Matches& matches) {
  std::vector<PixelMatch> pixels(matches.first.size());
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    pixels[i].first = matches.first[i];
    pixels[i].second = matches.second[i];
  }
  return pixels;
}

// Whether a motion is among those found, whatever the sign of its translation.
bool is_among(const std::vector<RigidTransform>& motions, const RigidTransform& T) {
  const RigidTransform forth(T.R, T.t.normalized()), back(T.R, -T.t.normalized());
  return std::any_of(motions.begin(), motions.end(), [&](const RigidTransform& found) {
    return same_valley(found, forth) || same_valley(found, back);
  });
}

// What a motion of either sign explains of the matches.
double likelihood(const Matches& matches, const RigidTransform& T) {
  const std::vector<PixelMatch> seen = pixels(matches);
  return std::max(judge_motion(camera(), seen, T, {}).likelihood,
                  judge_motion(camera(), seen, {T.R, -T.t}, {}).likelihood);
}

TEST(MotionValleys, BeginWithTheTrueMotionInARoom) {
  const Matches matches(Scene::kRoom, kStep, 0.0);
  for (const Eigen::Matrix3d& R : {kStep.R, Eigen::Matrix3d::Identity().eval()}) {
    const auto motions = motion_valleys(camera(), pixels(matches), R, 4);
    ASSERT_FALSE(motions.empty());
    EXPECT_LT(rotation_angle(motions[0].R, kStep.R), 0.005);
    EXPECT_NEAR(motions[0].t.norm(), 1.0, 1e-9);
    EXPECT_TRUE(is_among({motions[0]}, kStep));
  }
}

TEST(MotionValleys, StandFortyPercentOfOutliers) {
  const Matches matches(Scene::kRoom, kStep, 0.4);
  const auto motions = motion_valleys(camera(), pixels(matches), kStep.R, 1);
  ASSERT_EQ(motions.size(), 1U);
  EXPECT_TRUE(is_among(motions, kStep));
}

// H = R + t n' / d = R' + t' n'' / d': a plane has a second motion, R' and t', beside the true one.
TEST(MotionValleys, AreTwoBeforeAWall) {
  const Matches matches(Scene::kSlantedWall, kStep, 0.0);
  const auto motions = motion_valleys(camera(), pixels(matches), kStep.R, 4);
  EXPECT_TRUE(is_among(motions, kStep));
  ASSERT_GE(motions.size(), 2U);
  EXPECT_FALSE(same_valley(motions[0], motions[1]));
  EXPECT_GT(likelihood(matches, motions[1]), 0.98 * likelihood(matches, motions[0]));
}

TEST(MotionValleys, HoldTheTrueMotionOverASmallStep) {
  RigidTransform small = kStep;
  small.t *= 0.2;
  const Matches matches(Scene::kRoom, small, 0.0);
  const auto motions = motion_valleys(camera(), pixels(matches), small.R, 4);
  ASSERT_FALSE(motions.empty());
  // The optimum explains no less than the truth does.
  const RigidTransform truth(small.R, small.t.normalized());
  EXPECT_GT(likelihood(matches, motions[0]), likelihood(matches, truth) - 1.0);
}

TEST(MotionValleys, AreNotMoreThanWanted) {
  const Matches matches(Scene::kSlantedWall, kStep, 0.0);
  EXPECT_EQ(motion_valleys(camera(), pixels(matches), kStep.R, 1).size(), 1U);
  EXPECT_TRUE(motion_valleys(camera(), pixels(matches), kStep.R, 0).empty());
}

}  // namespace
}  // namespace dynslam::slam
