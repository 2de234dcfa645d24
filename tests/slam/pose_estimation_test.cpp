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

// Points in front of a camera at the origin, seen with `noise` pixels, and `wrong` pixels off to
// the right every tenth of them.
struct View {
  DepthCamera camera;
  FrameFeatures features;
  std::vector<PointMatch> matches;

  explicit View(double noise, float wrong = 0.0F) {
    static_cast<PinholeCamera&>(camera) = slam::camera();
    std::mt19937 random(7);
    std::normal_distribution<double> error(0.0, noise);
    std::uniform_real_distribution<double> u(20.0, 620.0), v(20.0, 460.0), z(1.0, 4.0);
    for (std::uint32_t i = 0; i < 300; ++i) {
      const Eigen::Vector2d pixel(u(random), v(random));
      matches.push_back({i, i, camera.unproject(pixel, z(random)), 1.0F});
      cv::KeyPoint keypoint;
      keypoint.pt = {static_cast<float>(pixel.x() + error(random)) + (i % 10 == 0 ? wrong : 0.0F),
                     static_cast<float>(pixel.y() + error(random))};
      keypoint.octave = 0;
      features.keypoints.push_back(keypoint);
      features.right_columns.push_back(std::numeric_limits<float>::quiet_NaN());
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
  EXPECT_NEAR(after / before, 0.5, 0.06) << "2.5 times the noise of 0.2 pixels";
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

TEST(PoseEstimation, FindsTheSameInliersWhateverTheNoiseIs) {
  const View view(0.1, 1.8F);
  PoseEstimation pose = estimation(view);
  const int before = view.solve(pose).inliers;
  EXPECT_EQ(before, 300);
  EXPECT_EQ(view.solve_learned(pose).inliers, before);
}

TEST(ResidualNoise, IsTheStandardDeviationWhateverAFewErrorsAre) {
  const PinholeCamera camera = slam::camera();
  std::mt19937 random(3);
  std::normal_distribution<double> error(0.0, 0.6);
  ResidualNoise noise;
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3d X(0.3, -0.2, 2.0);
    const double off = i % 10 == 0 ? 50.0 : 0.0;
    const Eigen::Vector2d pixel =
        camera.project(X) + Eigen::Vector2d(error(random) + off, error(random));
    noise.add(camera, X, pixel, 0.5);
  }
  EXPECT_NEAR(noise.standard_deviation(), 0.3, 0.03);
}

double noise_to_weigh_by(double deviation) {
  const PinholeCamera camera = slam::camera();
  std::mt19937 random(5);
  std::normal_distribution<double> error(0.0, deviation);
  ResidualNoise noise;
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3d X(0.1, 0.2, 1.5);
    noise.add(camera, X, camera.project(X) + Eigen::Vector2d(error(random), error(random)), 1.0);
  }
  return noise.noise_to_weigh_by();
}

TEST(ResidualNoise, LeavesRoomForErrorsThatDoNotShowButKnowsBounds) {
  EXPECT_NEAR(noise_to_weigh_by(0.2), 0.5, 0.03);
  EXPECT_EQ(noise_to_weigh_by(0.01), 0.15);
  EXPECT_EQ(noise_to_weigh_by(2.0), 1.0);
  EXPECT_EQ(ResidualNoise().noise_to_weigh_by(), 1.0) << "nothing is known";
}

TEST(ResidualNoise, IsUnknownFromAFewErrorsAndFromPointsBehindTheCamera) {
  ResidualNoise noise;
  EXPECT_TRUE(std::isnan(noise.standard_deviation()));
  for (int i = 0; i < 100; ++i) noise.add(slam::camera(), {0.0, 0.0, -1.0}, {0.0, 0.0}, 1.0);
  EXPECT_TRUE(std::isnan(noise.standard_deviation()));
}

}  // namespace
}  // namespace dynslam::slam
