#include "dynslam/factors/weighted_reprojection.hpp"

#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include "dynslam/core/numeric_derivative.hpp"
#include "dynslam/factors/lie_jacobians.hpp"

#include "factors/synthetic.hpp"

namespace dynslam::factors {
namespace {

constexpr double kTolerance = 1e-7;

// One random observation with everything a factor takes.
template <int Rows>
struct Case {
  DepthCamera camera = synthetic::kinect();
  RigidTransform T;
  Eigen::Vector3d X;
  Eigen::Matrix<double, Rows, 1> measured;
  Eigen::Matrix<double, Rows, Rows> L;
  double phi = 0.7;

  explicit Case(unsigned seed) {
    std::mt19937 rng(seed);
    std::uniform_real_distribution<double> uniform(-1.0, 1.0);
    T = se3_exp(synthetic::random_twist(rng, 2.0, 1.5));
    const Eigen::Vector3d in_camera =
        synthetic::random_direction(rng) + Eigen::Vector3d(0.0, 0.0, 2.0);
    X = T.inverse() * in_camera;
    for (int k = 0; k < Rows; ++k) measured[k] = 200.0 + 100.0 * uniform(rng);
    if constexpr (Rows == 3) {
      L = depth_sqrt_information(1.3, camera.bf, in_camera.z(), kinect_depth_sigma(in_camera.z()));
    } else {
      L = mono_sqrt_information(1.3);
    }
  }

  template <typename Distortion>
  Eigen::Matrix<double, Rows, 1> residual(const RigidTransform& pose, const Eigen::Vector3d& point,
                                          double weight, const DepthCamera& lens_camera,
                                          const Distortion& lens) const {
    Eigen::Matrix<double, Rows, 1> e;
    EXPECT_TRUE(
        weighted_reprojection<Rows>(lens_camera, pose, point, measured, L, weight, e, {}, lens));
    return e;
  }
};

template <int Rows, typename Distortion>
void check_all_jacobians(const Distortion& lens) {
  for (unsigned seed = 0; seed < 50; ++seed) {
    const Case<Rows> c(seed);
    constexpr int kIntrinsics = ReprojectionJacobians<Rows>::kIntrinsics;
    Eigen::Matrix<double, Rows, 6> pose;
    Eigen::Matrix<double, Rows, 3> point;
    Eigen::Matrix<double, Rows, 1> weight, e;
    Eigen::Matrix<double, Rows, kIntrinsics> intrinsics;
    ASSERT_TRUE(weighted_reprojection<Rows>(c.camera, c.T, c.X, c.measured, c.L, c.phi, e,
                                            {&pose, &point, &weight, &intrinsics}, lens));
    const auto by_pose = [&](const Vector6d& xi) {
      return c.residual(se3_exp(xi) * c.T, c.X, c.phi, c.camera, lens);
    };
    const auto by_point = [&](const Eigen::Vector3d& x) {
      return c.residual(c.T, x, c.phi, c.camera, lens);
    };
    const auto by_weight = [&](const Eigen::Matrix<double, 1, 1>& w) {
      return c.residual(c.T, c.X, w[0], c.camera, lens);
    };
    const auto by_intrinsics = [&](const Eigen::Matrix<double, kIntrinsics, 1>& k) {
      DepthCamera camera = c.camera;
      camera.fx = k[0], camera.fy = k[1], camera.cx = k[2], camera.cy = k[3];
      if (kIntrinsics == 5) camera.bf = k[kIntrinsics - 1];
      return c.residual(c.T, c.X, c.phi, camera, lens);
    };
    Eigen::Matrix<double, kIntrinsics, 1> k;
    k.head(4) << c.camera.fx, c.camera.fy, c.camera.cx, c.camera.cy;
    if (kIntrinsics == 5) k[kIntrinsics - 1] = c.camera.bf;
    const Eigen::Matrix<double, 1, 1> phi(c.phi);
    EXPECT_LT(jacobian_difference(pose, numeric_jacobian(by_pose, Vector6d(Vector6d::Zero()))),
              kTolerance);
    EXPECT_LT(jacobian_difference(point, numeric_jacobian(by_point, c.X)), kTolerance);
    EXPECT_LT(jacobian_difference(weight, numeric_jacobian(by_weight, phi)), kTolerance);
    EXPECT_LT(jacobian_difference(intrinsics, numeric_jacobian(by_intrinsics, k)), kTolerance);
  }
}

TEST(WeightedReprojection, MonoJacobiansMatchNumericOnes) {
  check_all_jacobians<2>(NoDistortion{});
}

TEST(WeightedReprojection, DepthJacobiansMatchNumericOnes) {
  check_all_jacobians<3>(NoDistortion{});
}

TEST(WeightedReprojection, JacobiansThroughALensMatchNumericOnes) {
  const RadialTangentialDistortion lens{0.26, -0.95, -0.005, 0.0026, 1.16};
  check_all_jacobians<2>(lens);
  check_all_jacobians<3>(lens);
}

TEST(WeightedReprojection, IsZeroWhereThePointIsSeen) {
  const DepthCamera camera = synthetic::kinect();
  const Eigen::Vector3d X(0.3, -0.2, 2.5);
  const RigidTransform T;
  Eigen::Vector3d e3;
  ASSERT_TRUE(weighted_reprojection<3>(camera, T, X, camera.project3(X),
                                       stereo_sqrt_information(1.0), 1.0, e3));
  EXPECT_LT(e3.norm(), 1e-12);
  const PinholeCamera pinhole = camera;
  Eigen::Vector2d e2;
  const Eigen::Vector2d off = camera.project(X) + Eigen::Vector2d(2.0, -1.0);
  ASSERT_TRUE(weighted_reprojection<2>(pinhole, T, X, off, mono_sqrt_information(2.0), 0.5, e2));
  EXPECT_LT((e2 - Eigen::Vector2d(0.5, -0.25)).norm(), 1e-12);
}

TEST(WeightedReprojection, LeavesOutputsAloneBehindTheCamera) {
  const DepthCamera camera = synthetic::kinect();
  const Eigen::Vector2d p(1.0, 2.0);
  for (const Eigen::Vector3d& X :
       {Eigen::Vector3d(0.0, 0.0, -1.0), Eigen::Vector3d(0.0, 0.0, 0.5 * kMinDepth),
        Eigen::Vector3d(std::nan(""), 0.0, 1.0)}) {
    Eigen::Vector2d e(7.0, 7.0);
    Eigen::Matrix<double, 2, 6> J;
    J.setConstant(7.0);
    EXPECT_FALSE(weighted_reprojection<2>(camera, RigidTransform(), X, p,
                                          mono_sqrt_information(1.0), 1.0, e, {&J}));
    EXPECT_EQ(e, Eigen::Vector2d(7.0, 7.0));
    EXPECT_EQ(J(0, 0), 7.0);
  }
}

TEST(DepthSqrtInformation, WhitensColumnAndDepthNoise) {
  const double sigma = 1.2, bf = 40.0, z = 3.0, sigma_z = 0.02;
  const double sigma_d = bf / (z * z) * sigma_z;
  Eigen::Matrix3d S = Eigen::Matrix3d::Identity() * sigma * sigma;
  S(0, 2) = S(2, 0) = sigma * sigma;  // u_R repeats the error of u
  S(2, 2) = sigma * sigma + sigma_d * sigma_d;
  const Eigen::Matrix3d L = depth_sqrt_information(sigma, bf, z, sigma_z);
  EXPECT_LT((L * S * L.transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-12);
}

TEST(NoiseModels, GrowWithLevelAndDepth) {
  EXPECT_DOUBLE_EQ(pyramid_sigma(0), 1.0);
  EXPECT_NEAR(pyramid_sigma(3, 1.2, 2.0), 3.456, 1e-12);
  EXPECT_NEAR(kinect_depth_sigma(0.4), 0.0012, 1e-15);
  EXPECT_NEAR(kinect_depth_sigma(4.4), 0.0012 + 0.0019 * 16.0, 1e-15);
}

TEST(LieJacobians, OfSe3AndSim3MatchNumericOnes) {
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  for (int i = 0; i < 30; ++i) {
    Vector7d xi;
    for (int k = 0; k < 7; ++k) xi[k] = uniform(rng) * (k < 3 ? 5.0 : 1.7);
    const Vector6d rigid = xi.head<6>();
    const auto log6 = [&](const Vector6d& d) { return se3_log(se3_exp(d) * se3_exp(rigid)); };
    const auto log7 = [&](const Vector7d& d) { return sim3_log(sim3_exp(d) * sim3_exp(xi)); };
    EXPECT_LT(jacobian_difference(left_jacobian_inverse<6>(se3_bracket(rigid)),
                                  numeric_jacobian(log6, Vector6d(Vector6d::Zero()))),
              1e-6);
    EXPECT_LT(jacobian_difference(left_jacobian_inverse<7>(sim3_bracket(xi)),
                                  numeric_jacobian(log7, Vector7d(Vector7d::Zero()))),
              1e-6);
  }
}

TEST(Similarity, LogarithmUndoesTheExponential) {
  std::mt19937 rng(4);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  for (int i = 0; i < 200; ++i) {
    Vector7d xi;
    for (int k = 0; k < 7; ++k) xi[k] = uniform(rng) * (k < 3 ? 10.0 : 1.8);
    if (i % 4 == 0) xi.tail<4>() *= 1e-7;
    if (i % 5 == 0) xi[6] = 0.0;
    const Vector7d back = sim3_log(sim3_exp(xi));
    EXPECT_LT((back - xi).norm(), 1e-9 * (1.0 + xi.norm()));
    if (xi[6] == 0.0) {
      const RigidTransform T = se3_exp(xi.head<6>());
      EXPECT_LT((T.t - sim3_exp(xi).t).norm(), 1e-12 * (1.0 + xi.norm()));
    }
  }
}

TEST(Similarity, AdjointMovesATwistThroughIt) {
  Vector7d a, b;
  a << 0.4, -2.0, 1.0, 0.5, -0.3, 0.9, 0.4;
  b << 0.02, 0.01, -0.03, 0.01, 0.03, -0.02, 0.015;
  const Similarity S = sim3_exp(a);
  const Similarity left = S * sim3_exp(b) * S.inverse();
  const Vector7d moved = sim3_log(left);
  EXPECT_LT((moved - sim3_adjoint(S) * b).norm(), 1e-12);
}

}  // namespace
}  // namespace dynslam::factors
