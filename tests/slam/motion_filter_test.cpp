#include "slam/motion_filter.hpp"

#include <cmath>
#include <random>

#include <Eigen/LU>
#include <gtest/gtest.h>

namespace dynslam::slam {
namespace {

constexpr double kStep = 1.0 / 30.0;

Matrix6d covariance(double translation, double rotation) {
  Vector6d v;
  v << Eigen::Vector3d::Constant(translation * translation),
      Eigen::Vector3d::Constant(rotation * rotation);
  return v.asDiagonal();
}

/// A camera whose pose is measured with noise and estimated as a tracker would: under the prior.
class Follower {
 public:
  explicit Follower(const Matrix6d& noise) : noise_(noise) {}

  RigidTransform measured(const RigidTransform& truth) {
    Vector6d e;
    for (int i = 0; i < 6; ++i) e[i] = std::sqrt(noise_(i, i)) * normal_(random_);
    return se3_exp(e) * truth;
  }

  RigidTransform follow(const RigidTransform& measurement) {
    filter.predict(pose_, kStep);
    Matrix6d posterior = noise_;
    pose_ = measurement;
    if (filter.predicted()) {
      const factors::PosePrior prior = filter.prior();
      posterior = (noise_.inverse() + prior.information).inverse();
      const Vector6d off = se3_log(measurement * prior.mean.inverse());
      pose_ = se3_exp(posterior * noise_.inverse() * off) * prior.mean;
    }
    filter.update(pose_, posterior);
    return pose_;
  }

  MotionFilter filter;

 private:
  Matrix6d noise_;
  RigidTransform pose_;
  std::mt19937 random_{7};
  std::normal_distribution<double> normal_;
};

/// Pose of a camera that glides and turns.
RigidTransform gliding(double t) {
  return {so3_exp({0.1 * t, 0.3 * t, 0.0}), Eigen::Vector3d(0.4 * t, -0.1 * t, 0.2 * t)};
}

double distance(const RigidTransform& a, const RigidTransform& b) {
  return se3_log(a * b.inverse()).head<3>().norm();
}

TEST(MotionFilter, ExpectsNothingBeforeTheFirstPose) {
  MotionFilter filter;
  filter.predict({}, kStep);
  EXPECT_FALSE(filter.predicted());
}

TEST(MotionFilter, ExpectsASteadyCameraWhereItWillBe) {
  Follower camera(covariance(1e-4, 1e-4));
  for (int i = 0; i < 60; ++i) camera.follow(gliding(i * kStep));
  camera.filter.predict(gliding(59 * kStep), kStep);
  EXPECT_LT(distance(camera.filter.prior().mean, gliding(60 * kStep)), 2e-4);
}

TEST(MotionFilter, HalvesTheJitterOfAGlidingCamera) {
  Follower camera(covariance(0.02, 0.001));
  double raw = 0.0, filtered = 0.0;
  for (int i = 0; i < 300; ++i) {
    const RigidTransform truth = gliding(i * kStep), measurement = camera.measured(truth);
    const RigidTransform pose = camera.follow(measurement);
    if (i < 30) continue;
    raw += std::pow(distance(measurement, truth), 2);
    filtered += std::pow(distance(pose, truth), 2);
  }
  EXPECT_LT(filtered, 0.25 * raw);
}

TEST(MotionFilter, LearnsThatACameraIsBrisk) {
  Follower camera(covariance(0.003, 0.001));
  double latest = 0.0;
  const auto shaken = [](double t) {  // 10 m/s^2, ten times what hands do without haste
    return RigidTransform{Eigen::Matrix3d::Identity(), {0.1 * std::sin(10.0 * t), 0.0, 0.0}};
  };
  for (int i = 0; i < 300; ++i) {
    const double off =
        distance(camera.follow(camera.measured(shaken(i * kStep))), shaken(i * kStep));
    if (i >= 200) latest = std::max(latest, off);
  }
  EXPECT_LT(latest, 0.02);
}

TEST(MotionFilter, TakesAMeasuredStepInTheDirectionsItCovers) {
  MotionFilter filter;
  filter.update({}, covariance(1e-3, 1e-3));
  filter.predict({}, kStep);
  Matrix6d along_x = Matrix6d::Zero();
  along_x(0, 0) = 1e12;
  const RigidTransform stepped{Eigen::Matrix3d::Identity(), {0.01, 0.02, 0.0}};
  filter.observe_step(stepped, along_x);
  const Eigen::Vector3d mean = filter.prior().mean.t;
  EXPECT_NEAR(mean.x(), 0.01, 1e-4);
  EXPECT_NEAR(mean.y(), 0.0, 1e-4);
}

TEST(MotionFilter, IsNeverSurerOfAStepThanOfTheLastPose) {
  const Matrix6d noise = covariance(0.01, 0.01);
  MotionFilter filter;
  filter.update({}, noise);
  filter.predict({}, kStep);
  filter.observe_step({}, 1e12 * Matrix6d::Identity());
  const Matrix6d expected = filter.prior().information.inverse();
  for (int i = 0; i < 6; ++i) EXPECT_NEAR(expected(i, i), noise(i, i), 1e-8);
}

TEST(MotionFilter, BeginsAnewAfterAFrameWithoutAPose) {
  Follower camera(covariance(1e-4, 1e-4));
  for (int i = 0; i < 30; ++i) camera.follow(gliding(i * kStep));
  camera.filter.predict(gliding(29 * kStep), kStep);
  camera.filter.predict(gliding(29 * kStep), 2 * kStep);
  EXPECT_FALSE(camera.filter.predicted());
  camera.filter.update(gliding(0.0), covariance(1e-4, 1e-4));
  camera.filter.predict(gliding(0.0), kStep);
  ASSERT_TRUE(camera.filter.predicted());
  EXPECT_LT(distance(camera.filter.prior().mean, gliding(0.0)), 1e-12);
}

TEST(MotionFilter, ExpectsNothingWhereTimeStandsStill) {
  MotionFilter filter;
  filter.update({}, covariance(0.01, 0.01));
  filter.predict({}, 0.0);
  EXPECT_FALSE(filter.predicted());
}

}  // namespace
}  // namespace dynslam::slam
