// Every Ceres cost function against numeric derivatives, by Ceres' own checker.
#include <cmath>
#include <vector>

#include <ceres/gradient_checker.h>
#include <ceres/solver.h>
#include <gtest/gtest.h>

#include "dynslam/factors/ceres.hpp"
#include "dynslam/factors/pose_optimizer.hpp"
#include "dynslam/factors/static_weight.hpp"

#include "factors/ceres_keyframe_cost.hpp"
#include "factors/synthetic.hpp"

namespace dynslam::factors {
namespace {

using synthetic::random_direction;
using synthetic::random_twist;

// Manifolds that are null stand for Euclidean blocks.
void expect_derivatives(const ceres::CostFunction& cost,
                        const std::vector<detail::ManifoldBase*>& manifolds,
                        std::vector<double*> blocks) {
  ceres::NumericDiffOptions options;
  options.ridders_relative_initial_step_size = 1e-3;
  const std::vector<const detail::ManifoldBase*> bases(manifolds.begin(), manifolds.end());
  ceres::GradientChecker checker(&cost, &bases, options);
  ceres::GradientChecker::ProbeResults results;
  EXPECT_TRUE(checker.Probe(blocks.data(), 1e-5, &results)) << results.error_log;
}

template <typename T>
std::vector<double> block_of(T value, int size) {
  const double* first = parameter_block(value);
  return {first, first + size};
}

template <int Rows, typename Distortion>
void check_reprojection(const Distortion& lens) {
  std::mt19937 rng(5);
  PoseManifold pose_manifold;
  for (int i = 0; i < 10; ++i) {
    const DepthCamera camera = synthetic::kinect();
    const RigidTransform T = se3_exp(random_twist(rng, 1.0, 1.0));
    const Eigen::Vector3d in_camera = random_direction(rng) + Eigen::Vector3d(0, 0, 2.5);
    const Eigen::Vector3d X = T.inverse() * in_camera;
    Eigen::Matrix<double, Rows, 1> m =
        camera.project3(in_camera).template head<Rows>() + 3.0 * random_direction(rng).head<Rows>();
    Eigen::Matrix<double, Rows, Rows> L = Eigen::Matrix<double, Rows, Rows>::Identity() / 1.3;
    L(1, 0) = -0.3;  // no derivative is zero but for rounding, which the checker would not forgive
    std::vector<double> pose = block_of(T, kPoseBlock), point = block_of(X, 3);
    auto intrinsics = intrinsics_block<Rows>(camera);
    double phi = 0.6;
    expect_derivatives(ReprojectionCost<Rows, Distortion>(camera, m, L, 0.7, lens),
                       {&pose_manifold, nullptr}, {pose.data(), point.data()});
    expect_derivatives(WeightedReprojectionCost<Rows, Distortion>(camera, m, L, lens),
                       {&pose_manifold, nullptr, nullptr}, {pose.data(), point.data(), &phi});
    expect_derivatives(IntrinsicsReprojectionCost<Rows, Distortion>(m, L, 0.7, lens),
                       {&pose_manifold, nullptr, nullptr},
                       {pose.data(), point.data(), intrinsics.data()});
  }
}

TEST(CeresFactors, ReprojectionDerivativesPassTheCheckerOfCeres) {
  check_reprojection<2>(NoDistortion());
  check_reprojection<3>(NoDistortion());
}

TEST(CeresFactors, DerivativesThroughALensPassTheCheckerOfCeres) {
  const RadialTangentialDistortion lens{0.1, -0.2, 0.003, -0.002, 0.05};
  check_reprojection<2>(lens);
  check_reprojection<3>(lens);
}

TEST(CeresFactors, IntrinsicsThatAreNoCameraFailTheEvaluation) {
  const IntrinsicsReprojectionCost<3> cost({1, 2, 3}, Eigen::Matrix3d::Identity());
  RigidTransform T;
  Eigen::Vector3d X(0, 0, 2), residual;
  for (const int broken : {0, 1, 4}) {
    auto intrinsics = intrinsics_block<3>(synthetic::kinect());
    const double* blocks[] = {parameter_block(T), parameter_block(X), intrinsics.data()};
    EXPECT_TRUE(cost.Evaluate(blocks, residual.data(), nullptr));
    intrinsics[broken] = 0.0;
    EXPECT_FALSE(cost.Evaluate(blocks, residual.data(), nullptr));
  }
}

// Self-calibration through a lens: five frames of known poses and points, the camera is found.
TEST(CeresFactors, IntrinsicsAreFoundThroughALens) {
  const RadialTangentialDistortion lens{-0.2, 0.05, 0.001, -0.001, 0.0};
  const DepthCamera truth = synthetic::kinect();
  auto found = intrinsics_block<3>(truth);
  found += Eigen::Matrix<double, 5, 1>(20.0, -15.0, 8.0, -6.0, 3.0);
  std::mt19937 rng(9);
  std::vector<RigidTransform> poses(5);
  std::vector<Eigen::Vector3d> points;
  ceres::Problem problem;
  for (int i = 0; i < 40; ++i) points.push_back(random_direction(rng) + Eigen::Vector3d(0, 0, 3));
  for (RigidTransform& T : poses) {
    T = se3_exp(random_twist(rng, 0.3, 0.1));
    add_pose_block(problem, T);
    for (Eigen::Vector3d& X : points) {
      Eigen::Vector3d seen;  // residual of measuring nothing: what the camera sees, negated
      ASSERT_TRUE(weighted_reprojection<3>(truth, T, X, Eigen::Vector3d(0, 0, 0),
                                           Eigen::Matrix3d::Identity(), 1.0, seen, {}, lens));
      problem.AddResidualBlock(new IntrinsicsReprojectionCost<3, RadialTangentialDistortion>(
                                   Eigen::Vector3d(-seen), stereo_sqrt_information(1.0), 1.0, lens),
                               new EliminatedWeightLoss(1.0, 9.0), parameter_block(T),
                               parameter_block(X), found.data());
      problem.SetParameterBlockConstant(parameter_block(X));
    }
    problem.SetParameterBlockConstant(parameter_block(T));
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.max_num_iterations = 200;
  options.function_tolerance = 1e-14;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  DepthCamera camera = truth;
  camera.fx = 1.0;
  set_intrinsics<3>(found, camera);
  EXPECT_NEAR(camera.fx, truth.fx, 1e-3);
  EXPECT_NEAR(camera.fy, truth.fy, 1e-3);
  EXPECT_NEAR(camera.cx, truth.cx, 1e-3);
  EXPECT_NEAR(camera.cy, truth.cy, 1e-3);
  EXPECT_NEAR(camera.bf, truth.bf, 1e-3);
}

// The lean factor of the bundle adjustment is weighted_reprojection(), value and derivatives,
// wherever its chart has been moved to.
template <int Rows>
void check_keyframe_cost() {
  std::mt19937 rng(8);
  const DepthCamera camera = synthetic::kinect();
  for (int i = 0; i < 20; ++i) {
    const RigidTransform start = se3_exp(random_twist(rng, 1.0, 1.0));
    CeresKeyframes keyframes(Span<const RigidTransform>(&start, 1));
    CeresKeyframes::State& state = keyframes.states[0];
    state.xi = random_twist(rng, 0.2, 0.2);
    keyframes.PrepareForEvaluation(false, true);
    const RigidTransform T = se3_exp(state.xi) * start;
    EXPECT_LT((state.T.matrix() - T.matrix()).norm(), 1e-12);
    keyframes.PrepareForEvaluation(true, false);
    EXPECT_LT((CeresKeyframes::pose_of(state).matrix() - T.matrix()).norm(), 1e-12);
    const Eigen::Vector3d in_camera = random_direction(rng) + Eigen::Vector3d(0, 0, 2.5);
    const Eigen::Vector3d X = T.inverse() * in_camera;
    const Eigen::Matrix<double, Rows, 1> m =
        camera.project3(in_camera).template head<Rows>() + 3.0 * random_direction(rng).head<Rows>();
    double phi = 0.6;
    const double inverse_sigma = 0.7, right_inverse_sigma = 0.2;
    Eigen::Matrix<double, Rows, Rows> S = Eigen::Matrix<double, Rows, Rows>::Identity();
    S *= inverse_sigma;
    if constexpr (Rows == 3) S(2, 2) = right_inverse_sigma;
    Eigen::Matrix<double, Rows, 1> expected, whitened, residual, by_phi;
    Eigen::Matrix<double, Rows, 6> expected_pose;
    Eigen::Matrix<double, Rows, 3> expected_point;
    ASSERT_TRUE(weighted_reprojection<Rows>(camera, T, X, m, S, phi, expected,
                                            {&expected_pose, &expected_point, &whitened, nullptr}));
    Eigen::Matrix<double, Rows, 6, Eigen::RowMajor> by_pose;
    Eigen::Matrix<double, Rows, 3, Eigen::RowMajor> by_point;
    const double* blocks[] = {state.xi.data(), X.data(), &phi};
    double* J[] = {by_pose.data(), by_point.data(), by_phi.data()};
    const KeyframeCost<Rows, true> cost(camera, state, m, inverse_sigma, right_inverse_sigma);
    ASSERT_TRUE(cost.Evaluate(blocks, residual.data(), J));
    EXPECT_LT((residual - expected).norm(), 1e-10);
    EXPECT_LT((by_pose - expected_pose).norm(), 1e-9);
    EXPECT_LT((by_point - expected_point).norm(), 1e-9);
    EXPECT_LT((by_phi - whitened).norm(), 1e-10);
    // Numeric: the chart stays where it is while the block moves.
    for (int c = 0; c < 6; ++c) {
      Eigen::Matrix<double, Rows, 1> ahead, behind;
      for (const double step : {1e-6, -1e-6}) {
        const Vector6d before = state.xi;
        state.xi[c] += step;
        keyframes.PrepareForEvaluation(false, true);
        cost.Evaluate(blocks, (step > 0.0 ? ahead : behind).data(), nullptr);
        state.xi = before;
      }
      EXPECT_LT((by_pose.col(c) - (ahead - behind) / 2e-6).norm(), 1e-4 * (1.0 + by_pose.norm()));
    }
  }
}

TEST(CeresKeyframeCost, IsTheWeightedReprojectionWithItsDerivatives) {
  check_keyframe_cost<2>();
  check_keyframe_cost<3>();
}

TEST(CeresKeyframeCost, BehindTheCameraPullsAtNothing) {
  const RigidTransform T;
  CeresKeyframes keyframes(Span<const RigidTransform>(&T, 1));
  const KeyframeCost<3, true> cost(synthetic::kinect(), keyframes.states[0], {1, 2, 3}, 1.0, 1.0);
  Eigen::Vector3d X(0, 0, -1), residual, by_phi;
  double phi = 0.5;
  const double* blocks[] = {keyframes.states[0].xi.data(), X.data(), &phi};
  Eigen::Matrix<double, 3, 6, Eigen::RowMajor> by_pose;
  Eigen::Matrix3d by_point;
  double* J[] = {by_pose.data(), by_point.data(), by_phi.data()};
  ASSERT_TRUE(cost.Evaluate(blocks, residual.data(), J));
  EXPECT_NEAR(residual.squaredNorm(), 0.25e6, 1e-3);
  EXPECT_EQ(by_pose.norm() + by_point.norm(), 0.0);
  EXPECT_NEAR(by_phi.squaredNorm(), 1e6, 1e-3);
}

TEST(CeresFactors, PriorAndRelativeDerivativesPassTheCheckerOfCeres) {
  std::mt19937 rng(6);
  PoseManifold pose_manifold;
  SimilarityManifold similarity_manifold;
  double phi = 0.3;
  expect_derivatives(WeightPriorCost(0.5, 9.0), {nullptr}, {&phi});
  for (int i = 0; i < 10; ++i) {
    const RigidTransform A = se3_exp(random_twist(rng, 2.0, 1.0));
    const RigidTransform B = se3_exp(random_twist(rng, 2.0, 1.0));
    const RigidTransform M = se3_exp(random_twist(rng, 0.3, 0.3)) * B * A.inverse();
    Matrix6d L = Matrix6d::Identity();
    L(0, 4) = 0.5, L(2, 2) = 3.0;
    std::vector<double> a = block_of(A, kPoseBlock), b = block_of(B, kPoseBlock);
    expect_derivatives(RelativePoseCost(M, L), {&pose_manifold, &pose_manifold},
                       {a.data(), b.data()});
    expect_derivatives(PosePriorCost(se3_exp(random_twist(rng, 0.3, 0.3)) * A, L), {&pose_manifold},
                       {a.data()});
    const Similarity SA(1.3, A.R, A.t), SB(0.8, B.R, B.t);
    Vector7d xi;
    xi << random_twist(rng, 0.3, 0.3), 0.1;
    const Similarity SM = sim3_exp(xi) * SB * SA.inverse();
    std::vector<double> c = block_of(SA, kSimilarityBlock), d = block_of(SB, kSimilarityBlock);
    expect_derivatives(RelativeSimilarityCost(SM, Matrix7d::Identity()),
                       {&similarity_manifold, &similarity_manifold}, {c.data(), d.data()});
  }
}

#if DYNSLAM_CERES_HAS_MANIFOLD
TEST(CeresManifolds, MinusUndoesPlusAndItsJacobianIsTheInverse) {
  std::mt19937 rng(7);
  const RigidTransform T = se3_exp(random_twist(rng, 2.0, 1.5));
  std::vector<double> x = block_of(T, kPoseBlock), y(kPoseBlock);
  const Vector6d xi = random_twist(rng, 0.5, 0.5);
  const PoseManifold manifold;
  ASSERT_TRUE(manifold.Plus(x.data(), xi.data(), y.data()));
  Vector6d back;
  ASSERT_TRUE(manifold.Minus(y.data(), x.data(), back.data()));
  EXPECT_LT((back - xi).norm(), 1e-12);
  Eigen::Matrix<double, 12, 6, Eigen::RowMajor> plus;
  Eigen::Matrix<double, 6, 12, Eigen::RowMajor> minus;
  ASSERT_TRUE(manifold.PlusJacobian(x.data(), plus.data()));
  ASSERT_TRUE(manifold.MinusJacobian(x.data(), minus.data()));
  EXPECT_LT((minus * plus - Matrix6d::Identity()).norm(), 1e-12);

  const Similarity S = Similarity(1.7, T.R, T.t);
  std::vector<double> s = block_of(S, kSimilarityBlock);
  const SimilarityManifold similar;
  Eigen::Matrix<double, 13, 7, Eigen::RowMajor> splus;
  Eigen::Matrix<double, 7, 13, Eigen::RowMajor> sminus;
  ASSERT_TRUE(similar.PlusJacobian(s.data(), splus.data()));
  ASSERT_TRUE(similar.MinusJacobian(s.data(), sminus.data()));
  EXPECT_LT((sminus * splus - Matrix7d::Identity()).norm(), 1e-12);
}
#endif

TEST(CeresLosses, EqualTheirOwnMathematics) {
  const EliminatedWeightLoss eliminated(0.6, 9.0);
  const RobustLossFunction huber({LossKind::kHuber, 2.0, 1.0}, 0.25);
  for (const double s : {0.0, 1.0, 30.0}) {
    double rho[3];
    eliminated.Evaluate(s, rho);
    EXPECT_NEAR(0.5 * rho[0], eliminated_cost(0.6, s, 9.0), 1e-14);
    const double phi = optimal_weight(0.6, s, 9.0);
    EXPECT_NEAR(rho[1], phi * phi, 1e-14);
    huber.Evaluate(s, rho);
    EXPECT_NEAR(rho[0], 0.25 * (s > 4.0 ? 4.0 * std::sqrt(s) - 4.0 : s), 1e-13);
  }
}

TEST(CeresFactors, APointBehindTheCameraPullsAtNothing) {
  const ReprojectionCost<3> cost(synthetic::kinect(), {1, 2, 3}, Eigen::Matrix3d::Identity());
  RigidTransform T;
  Eigen::Vector3d X(0, 0, -1), residual;
  const double* blocks[] = {parameter_block(T), parameter_block(X)};
  Eigen::Matrix<double, 3, 12, Eigen::RowMajor> by_pose;
  Eigen::Matrix<double, 3, 3, Eigen::RowMajor> by_point;
  double* jacobians[] = {by_pose.data(), by_point.data()};
  ASSERT_TRUE(cost.Evaluate(blocks, residual.data(), jacobians));
  EXPECT_NEAR(residual.squaredNorm(), 1e6, 1e-3);
  EXPECT_EQ(by_pose.norm() + by_point.norm(), 0.0);
}

// A user's own problem: the pose of a frame with one weight per observation, in Ceres.
TEST(CeresFactors, JointWeightsInCeresReachTheOptimumOfThePoseOptimizer) {
  synthetic::FrameOptions o;
  o.points = 80;
  o.movers = 0.3;
  o.start_distance = 0.01;
  o.start_rotation = 0.002;
  synthetic::Frame f = synthetic::make_frame(o, 3);
  PoseOptimizerOptions options;
  options.weights = WeightMode::kEliminated;
  options.step_tolerance = 1e-12;
  options.cost_tolerance = 0.0;
  options.max_iterations = 100;
  PoseOptimizer own(options);
  const PoseResult expected = own.optimize(f.camera, f.view(), f.start);

  RigidTransform T = expected.T_cam_world;
  Vector6d nudge;
  nudge << 1e-3, 1e-3, -1e-3, 1e-4, 1e-4, -1e-4;
  T = se3_exp(nudge) * T;
  std::vector<double> phi(f.points.size());
  ceres::Problem problem;
  add_pose_block(problem, T);
  for (std::size_t i = 0; i < f.points.size(); ++i) {
    phi[i] = own.weights()[i];
    const Eigen::Vector3d m(f.pixels[i].x(), f.pixels[i].y(), f.right[i]);
    add_weight_block(problem, phi[i]);
    const double sigma = 1.0 / f.inverse_sigma[i];
    ceres::CostFunction* cost = nullptr;
    if (f.right[i] < 0.0F) {  // no right column: mono
      cost = new WeightedReprojectionCost<2>(f.camera, m.head<2>(), mono_sqrt_information(sigma));
    } else {
      cost = new WeightedReprojectionCost<3>(f.camera, m, stereo_sqrt_information(sigma));
    }
    problem.AddResidualBlock(cost, nullptr, parameter_block(T), parameter_block(f.points[i]),
                             &phi[i]);
    problem.SetParameterBlockConstant(parameter_block(f.points[i]));
    problem.AddResidualBlock(new WeightPriorCost(f.weights[i], options.lambda), nullptr, &phi[i]);
  }
  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::DENSE_QR;
  solver.max_num_iterations = 200;
  solver.function_tolerance = 1e-15;
  solver.gradient_tolerance = 0.0;
  solver.parameter_tolerance = 0.0;
  solver.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  EXPECT_NEAR(summary.final_cost, expected.final_cost, 1e-9 * expected.final_cost);
  EXPECT_LT(se3_log(T * expected.T_cam_world.inverse()).norm(), 1e-5);
}

}  // namespace
}  // namespace dynslam::factors
