#include <cmath>
#include <limits>
#include <random>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/numeric_derivative.hpp"
#include "dynslam/core/rigid_transform.hpp"

namespace dynslam {
namespace {

constexpr double kPi = 3.14159265358979323846;
using Vector6 = Vector6d;

Vector6 random_twist(std::mt19937& random, double max_angle) {
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  Vector6 xi;
  for (int i = 0; i < 6; ++i) xi[i] = uniform(random);
  xi.tail<3>() *= max_angle * std::abs(uniform(random)) / xi.tail<3>().norm();
  return xi;
}

double distance(const RigidTransform& a, const RigidTransform& b) {
  return (a.matrix() - b.matrix()).cwiseAbs().maxCoeff();
}

DepthCamera kinect() {
  DepthCamera camera;
  camera.fx = 525;
  camera.fy = 520;
  camera.cx = 319.5;
  camera.cy = 239.5;
  camera.width = 640;
  camera.height = 480;
  return camera;
}

TEST(RigidTransform, LogarithmInvertsTheExponentialUpToPi) {
  std::mt19937 random(1);
  for (double max_angle : {1e-12, 1e-8, 1e-4, 1e-2, 1.0, kPi - 1e-6}) {
    for (int i = 0; i < 100; ++i) {
      const Vector6 xi = random_twist(random, max_angle);
      EXPECT_LT((se3_log(se3_exp(xi)) - xi).norm(), 1e-9) << xi.transpose();
    }
  }
}

TEST(RigidTransform, ExponentialIsARotationAndATranslation) {
  std::mt19937 random(2);
  for (int i = 0; i < 100; ++i) {
    const RigidTransform T = se3_exp(random_twist(random, 10.0));
    EXPECT_LT((T.R * T.R.transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-13);
    EXPECT_NEAR(T.R.determinant(), 1.0, 1e-13);
  }
}

TEST(RigidTransform, ExponentialEqualsThePowerSeriesOfTheMatrix) {
  std::mt19937 random(3);
  for (double angle : {1e-6, 1e-3, 0.009, 0.011, 0.5, 3.0}) {
    const Vector6 xi = random_twist(random, angle);
    Eigen::Matrix4d generator = Eigen::Matrix4d::Zero();
    generator.topLeftCorner<3, 3>() = skew(xi.tail<3>());
    generator.topRightCorner<3, 1>() = xi.head<3>();
    Eigen::Matrix4d term = Eigen::Matrix4d::Identity(), sum = term;
    for (int n = 1; n < 40; ++n) sum += term = (term * generator / n).eval();
    EXPECT_LT((se3_exp(xi).matrix() - sum).cwiseAbs().maxCoeff(), 1e-12) << angle;
  }
}

TEST(RigidTransform, InverseAndCompositionObeyTheGroupAxioms) {
  std::mt19937 random(4);
  for (int i = 0; i < 50; ++i) {
    const RigidTransform a = se3_exp(random_twist(random, 3.0));
    const RigidTransform b = se3_exp(random_twist(random, 3.0));
    const RigidTransform c = se3_exp(random_twist(random, 3.0));
    EXPECT_LT(distance(a * a.inverse(), RigidTransform()), 1e-13);
    EXPECT_LT(distance((a * b) * c, a * (b * c)), 1e-13);
    const Eigen::Vector3d x(1, -2, 3);
    EXPECT_LT(((a * b) * x - a * (b * x)).norm(), 1e-13);
  }
}

TEST(RigidTransform, AdjointMovesATwistThroughATransform) {
  std::mt19937 random(5);
  for (int i = 0; i < 50; ++i) {
    const RigidTransform T = se3_exp(random_twist(random, 3.0));
    const Vector6 xi = random_twist(random, 1.0);
    EXPECT_LT(distance(T * se3_exp(xi) * T.inverse(), se3_exp(se3_adjoint(T) * xi)), 1e-12);
  }
}

TEST(RigidTransform, LeftJacobianIsTheDerivativeOfTheExponential) {
  std::mt19937 random(6);
  for (double angle : {1e-7, 1e-3, 0.02, 1.0, 3.0}) {
    const Eigen::Vector3d omega = random_twist(random, angle).tail<3>();
    const Eigen::Matrix3d inverse_R = so3_exp(omega).transpose();
    const auto moved = [&](const Eigen::Vector3d& d) {
      return so3_log(so3_exp(omega + d) * inverse_R);
    };
    const auto numeric = numeric_jacobian(moved, Eigen::Vector3d::Zero().eval());
    EXPECT_LT(jacobian_difference(so3_left_jacobian(omega), numeric), 1e-9);
    EXPECT_LT(
        (so3_left_jacobian(omega) * so3_left_jacobian_inverse(omega) - Eigen::Matrix3d::Identity())
            .norm(),
        1e-11);
  }
}

TEST(RigidTransform, LogarithmAtPiIsARotationByPi) {
  for (const Eigen::Vector3d& axis : {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0, 1, 0),
                                      Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0.6, 0, 0.8)}) {
    const Eigen::Matrix3d R = so3_exp(kPi * axis);
    EXPECT_NEAR(so3_log(R).norm(), kPi, 1e-9);
    EXPECT_LT((so3_exp(so3_log(R)) - R).norm(), 1e-9);
  }
}

TEST(RigidTransform, MatrixAndQuaternionRoundTrip) {
  std::mt19937 random(7);
  const RigidTransform T = se3_exp(random_twist(random, 3.0));
  EXPECT_LT(distance(RigidTransform::from_matrix(T.matrix()), T), 1e-15);
  EXPECT_LT(distance(RigidTransform(T.quaternion(), T.t), T), 1e-13);
  EXPECT_GE(T.quaternion().w(), 0.0);
}

TEST(RigidTransform, InterpolationPassesThroughBothEnds) {
  std::mt19937 random(8);
  const RigidTransform a = se3_exp(random_twist(random, 2.0));
  const RigidTransform b = se3_exp(random_twist(random, 2.0));
  EXPECT_LT(distance(interpolate(a, b, 0.0), a), 1e-13);
  EXPECT_LT(distance(interpolate(a, b, 1.0), b), 1e-12);
  const RigidTransform middle = interpolate(a, b, 0.5);
  EXPECT_NEAR(rotation_angle(a.R, middle.R), rotation_angle(middle.R, b.R), 1e-12);
}

TEST(RigidTransform, NormalizationRemovesDrift) {
  std::mt19937 random(9);
  RigidTransform T = se3_exp(random_twist(random, 2.0));
  T.R *= 1.0 + 1e-6;
  EXPECT_LT((T.normalized().R * T.normalized().R.transpose() - Eigen::Matrix3d::Identity()).norm(),
            1e-13);
}

TEST(PinholeCamera, ProjectionAndRayAreInverse) {
  const DepthCamera camera = kinect();
  const Eigen::Vector2d pixel(100.25, 400.75);
  EXPECT_LT((camera.project(camera.unproject(pixel, 2.5)) - pixel).norm(), 1e-12);
}

TEST(PinholeCamera, JacobiansAgreeWithNumericDerivatives) {
  const DepthCamera camera = kinect();
  std::mt19937 random(10);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  for (int i = 0; i < 50; ++i) {
    const Eigen::Vector3d X(uniform(random), uniform(random), 2.5 + uniform(random));
    const auto two =
        numeric_jacobian([&](const Eigen::Vector3d& x) { return camera.project(x); }, X);
    const auto three =
        numeric_jacobian([&](const Eigen::Vector3d& x) { return camera.project3(x); }, X);
    EXPECT_LT(jacobian_difference(camera.project_jacobian(X), two), 1e-9);
    EXPECT_LT(jacobian_difference(camera.project3_jacobian(X), three), 1e-9);
  }
}

TEST(PinholeCamera, DomainIsWhatLiesInFront) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(PinholeCamera::in_domain({0, 0, 1}));
  EXPECT_FALSE(PinholeCamera::in_domain({0, 0, 0}));
  EXPECT_FALSE(PinholeCamera::in_domain({0, 0, -1}));
  EXPECT_FALSE(PinholeCamera::in_domain({nan, 0, 1}));
  EXPECT_FALSE(PinholeCamera::in_domain({0, 0, nan}));
  EXPECT_FALSE(kinect().project_into_image({5, 0, 1}).has_value());
  EXPECT_FALSE(kinect().contains({nan, 1.0}));
  ASSERT_TRUE(kinect().project_into_image({0, 0, 1}).has_value());
}

TEST(DepthCamera, RightColumnIsTheThirdCoordinateOfTheProjection) {
  const DepthCamera camera = kinect();
  const Eigen::Vector3d X(0.3, -0.2, 1.7);
  const Eigen::Vector3d p = camera.project3(X);
  EXPECT_NEAR(p.z(), camera.right_column(p.x(), X.z()), 1e-12);
  EXPECT_NEAR(camera.baseline(), 40.0 / 525.0, 1e-15);
}

TEST(DepthCamera, ValidationNamesTheBrokenParameter) {
  const auto message = [](auto change) {
    DepthCamera camera = kinect();
    change(camera);
    try {
      camera.validate();
    } catch (const InvalidArgument& error) {
      return std::string(error.what());
    }
    return std::string("nothing thrown");
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NE(message([](DepthCamera& c) { c.fx = 0; }).find("fx"), std::string::npos);
  EXPECT_NE(message([](DepthCamera& c) { c.fy = -1; }).find("fy"), std::string::npos);
  EXPECT_NE(message([&](DepthCamera& c) { c.cx = nan; }).find("cx"), std::string::npos);
  EXPECT_NE(message([&](DepthCamera& c) { c.cy = nan; }).find("cy"), std::string::npos);
  EXPECT_NE(message([](DepthCamera& c) { c.width = 0; }).find("width"), std::string::npos);
  EXPECT_NE(message([](DepthCamera& c) { c.height = -3; }).find("height"), std::string::npos);
  EXPECT_NE(message([](DepthCamera& c) { c.bf = 0; }).find("bf"), std::string::npos);
  EXPECT_NO_THROW(kinect().validate());
}

TEST(NumericDerivative, OfNanIsNanWhichNoBoundPasses) {
  Eigen::Matrix2d a = Eigen::Matrix2d::Identity(), b = a;
  b(0, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(jacobian_difference(b, a) < 1.0);
  EXPECT_FALSE(jacobian_difference(a, b) < 1.0);
}

}  // namespace
}  // namespace dynslam
