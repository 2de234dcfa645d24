#include "slam/pose_estimation.hpp"

#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/rigid_transform.hpp"

#include "slam/residual_noise.hpp"
#include "slam/vga_camera.hpp"

namespace dynslam::slam {
namespace {

DepthCamera depth_camera() {
  DepthCamera camera;
  static_cast<PinholeCamera&>(camera) = slam::camera();
  return camera;
}

// Points in front of a camera at the origin, seen with `noise` pixels, and `wrong` pixels off to
// the right every tenth of them. With `disparity_noise` pixels they have disparities, too.
struct View {
  DepthCamera camera = depth_camera();
  FrameFeatures features;
  std::vector<PointMatch> matches;

  explicit View(double noise, float wrong = 0.0F, double disparity_noise = -1.0,
                unsigned seed = 7) {
    camera.bf = 0.2 * camera.fx;
    std::mt19937 random(seed);
    std::normal_distribution<double> error(0.0, noise);
    std::uniform_real_distribution<double> u(20.0, 620.0), v(20.0, 460.0), z(1.0, 4.0);
    for (std::uint32_t i = 0; i < 300; ++i) {
      const Eigen::Vector2d pixel(u(random), v(random));
      const double depth = z(random);
      matches.push_back({i, i, camera.unproject(pixel, depth), 1.0F});
      cv::KeyPoint keypoint;
      keypoint.pt = {static_cast<float>(pixel.x() + error(random)) + (i % 10 == 0 ? wrong : 0.0F),
                     static_cast<float>(pixel.y() + error(random))};
      keypoint.octave = 0;
      features.keypoints.push_back(keypoint);
      features.right_columns.push_back(std::numeric_limits<float>::quiet_NaN());
      if (disparity_noise < 0.0) continue;
      const double disparity = camera.bf / depth + disparity_noise / noise * error(random);
      features.right_columns.back() = keypoint.pt.x - static_cast<float>(disparity);
    }
  }

  factors::PoseResult solve(PoseEstimation& pose) const {
    return pose.solve(matches, features, {});
  }
  // After frames like this one.
  factors::PoseResult solve_learned(PoseEstimation& pose) const {
    for (int i = 0; i < 30; ++i) pose.learn_noise(solve(pose).T_cam_world);
    return solve(pose);
  }
};

PoseEstimation estimation(const View& view) {
  return {view.camera, {1.0F}, factors::WeightMode::kEliminated};
}

double deviation(const factors::PoseResult& result) {
  return std::sqrt(result.covariance->trace());
}

TEST(PoseEstimation, IsAsSureAsTheNoiseOfItsPointsAllows) {
  const View view(0.2);
  PoseEstimation pose = estimation(view);
  const double before = deviation(view.solve(pose));
  const double after = deviation(view.solve_learned(pose));
  EXPECT_NEAR(after / before, 0.23, 0.04) << "0.2, and a little for the weights, which vary by it";
}

TEST(PoseEstimation, TakesNoMoreThanAPixelForNoise) {
  const View view(1.5);
  PoseEstimation pose = estimation(view);
  const double before = deviation(view.solve(pose));
  EXPECT_NEAR(deviation(view.solve_learned(pose)), before, 0.01 * before);
}

TEST(PoseEstimation, IsPulledLessByFeaturesBesideOnceItKnowsTheNoise) {
  const View view(0.1, 1.8F);
  PoseEstimation pose = estimation(view);
  const double before = view.solve(pose).T_cam_world.t.norm();
  const double after = view.solve_learned(pose).T_cam_world.t.norm();
  EXPECT_LT(after, 0.7 * before);
}

// Every other feature is aligned, to 0.05 pixels or 0.4, and says so.
void align_all(View& view, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  for (std::size_t i = 0; i < view.features.size(); ++i) {
    const float sigma = i % 2 == 0 ? 0.05F : 0.4F;
    view.features.alignment_sigmas.push_back(sigma);
    view.features.keypoints[i].pt += cv::Point2f(sigma * normal(random), sigma * normal(random));
  }
}

TEST(PoseEstimation, IsPulledLessByFeaturesThatAreAlignedWorse) {
  double same = 0.0, apart = 0.0;  // squared, of all
  for (unsigned seed = 0; seed < 20; ++seed) {
    View view(0.01, 0.0F, -1.0, seed);
    align_all(view, seed);
    PoseEstimation told = estimation(view);
    apart += view.solve_learned(told).T_cam_world.t.squaredNorm();
    view.features.alignment_sigmas.clear();
    PoseEstimation untold = estimation(view);
    same += view.solve_learned(untold).T_cam_world.t.squaredNorm();
  }
  EXPECT_LT(apart, 0.6 * same);
}

TEST(PoseEstimation, BelievesDepthAsFarAsItsNoiseAllows) {
  double before = 0.0, after = 0.0;  // squared, of all
  for (unsigned seed = 0; seed < 20; ++seed) {
    const View view(0.1, 0.0F, 2.0, seed);
    PoseEstimation pose = estimation(view);
    before += view.solve(pose).T_cam_world.t.squaredNorm();
    after += view.solve_learned(pose).T_cam_world.t.squaredNorm();
  }
  EXPECT_LT(after, 0.2 * before);
}

TEST(PoseEstimation, FindsTheSameInliersWhateverTheNoiseIs) {
  const View view(0.1, 1.8F);
  PoseEstimation pose = estimation(view);
  const int before = view.solve(pose).inliers;
  EXPECT_EQ(before, 300);
  EXPECT_EQ(view.solve_learned(pose).inliers, before);
}

// Of points seen with such errors, every tenth far off.
ResidualNoise residuals(double pixel_error, double disparity_error, double inverse_sigma = 1.0) {
  const DepthCamera camera = depth_camera();
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  ResidualNoise noise;
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3d X(0.3, -0.2, 2.0);
    const double off = i % 10 == 0 ? 50.0 : 0.0;
    const Eigen::Vector2d pixel = camera.project(X) +
                                  pixel_error * Eigen::Vector2d(normal(random), normal(random)) +
                                  Eigen::Vector2d(off, 0.0);
    const double disparity = camera.bf / X.z() + disparity_error * normal(random) + off;
    noise.add(camera, X, pixel, pixel.x() - disparity, inverse_sigma);
  }
  return noise;
}

TEST(ResidualNoise, IsTheStandardDeviationWhateverAFewErrorsAre) {
  const FeatureNoise seen = residuals(0.6, 0.3, 0.5).standard_deviations();
  EXPECT_NEAR(seen.pixels, 0.3, 0.03) << "pixels of a level where one is two";
  EXPECT_NEAR(seen.disparity, 0.3, 0.05) << "pixels of the image";
}

TEST(ResidualNoise, KnowsBounds) {
  const FeatureNoise least = residuals(0.01, 0.01).to_weigh_by();
  EXPECT_EQ(least.pixels, 0.05);
  EXPECT_EQ(least.disparity, 0.05);
  const FeatureNoise great = residuals(2.0, 2.0).to_weigh_by();
  EXPECT_EQ(great.pixels, 1.0);
  EXPECT_NEAR(great.disparity, 2.0, 0.3);
  const FeatureNoise unknown = ResidualNoise().to_weigh_by();
  EXPECT_EQ(unknown.pixels, 1.0);
  EXPECT_EQ(unknown.disparity, 1.0);
}

TEST(ResidualNoise, IsUnknownFromAFewErrorsAndFromPointsBehindTheCamera) {
  const DepthCamera camera = depth_camera();
  const double none = std::numeric_limits<double>::quiet_NaN();
  ResidualNoise noise;
  EXPECT_TRUE(std::isnan(noise.standard_deviations().pixels));
  for (int i = 0; i < 100; ++i) noise.add(camera, {0.0, 0.0, -1.0}, {0.0, 0.0}, 1.0, 1.0);
  EXPECT_TRUE(std::isnan(noise.standard_deviations().pixels));
  for (int i = 0; i < 100; ++i) noise.add(camera, {0.0, 0.0, 1.0}, {0.0, 0.0}, none, 1.0);
  EXPECT_FALSE(std::isnan(noise.standard_deviations().pixels));
  EXPECT_TRUE(std::isnan(noise.standard_deviations().disparity));
  noise.clear();
  EXPECT_TRUE(std::isnan(noise.standard_deviations().pixels));
}

// Of 200 corners and 2000 aligned key points, of sigma 0.02 to 0.2, whose errors are `aligned` and
// `growth` times that.
FeatureNoise noise_by_alignment(double corner, double aligned, double growth) {
  const DepthCamera camera = depth_camera();
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(0.02, 0.2);
  ResidualNoise noise;
  for (int i = 0; i < 2200; ++i) {
    const Eigen::Vector3d X(0.3, -0.2, 2.0);
    const double sigma = i % 11 == 0 ? 0.0 : uniform(random);
    const double error = sigma > 0.0 ? std::hypot(aligned, growth * sigma) : corner;
    const Eigen::Vector2d pixel =
        camera.project(X) + error * Eigen::Vector2d(normal(random), normal(random));
    noise.add(camera, X, pixel, -1.0, 1.0, sigma);
  }
  return noise.to_weigh_by();
}

TEST(ResidualNoise, TellsHowMuchMoreIsToBeHeldOfWhatIsAlignedWell) {
  const FeatureNoise noise = noise_by_alignment(0.35, 0.15, 2.0);
  EXPECT_NEAR(noise.pixels * noise.relative(0.03), std::hypot(0.15, 2.0 * 0.03), 0.03);
  EXPECT_NEAR(noise.pixels * noise.relative(0.18), std::hypot(0.15, 2.0 * 0.18), 0.05);
  EXPECT_NEAR(noise.pixels * noise.relative(0.0), 0.35, 0.04);
}

TEST(ResidualNoise, HoldsAlignedOnesForAlikeWhereAlignmentTellsNothing) {
  const FeatureNoise noise = noise_by_alignment(0.3, 0.3, 0.0);
  EXPECT_NEAR(noise.relative(0.02), 1.0, 0.1);
  EXPECT_NEAR(noise.relative(0.2), 1.0, 0.1);
}

TEST(FeatureNoise, IsNeverFarFromThatOfOthers) {
  const FeatureNoise noise = noise_by_alignment(5.0, 0.01, 4.0);
  EXPECT_EQ(noise.relative(0.0), 2.0);
  EXPECT_GE(noise.relative(0.001), 0.5);
  EXPECT_EQ(noise.relative(100.0), 2.0);
}

TEST(FeatureNoise, OfTheRightColumnIsThatOfBoth) {
  const FeatureNoise noise = {0.3, 0.8};
  EXPECT_NEAR(1.0 / noise.right_inverse_sigma(2.0), 1.0, 1e-12);
}

}  // namespace
}  // namespace dynslam::slam
