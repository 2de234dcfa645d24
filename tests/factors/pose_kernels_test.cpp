// Every kernel on every instruction set against the plain factors.
#include "factors/pose_kernels.hpp"

#include <random>
#include <vector>

#include <gtest/gtest.h>
#include <hwy/aligned_allocator.h>
#include <hwy/targets.h>

#include "dynslam/factors/robust_loss.hpp"
#include "dynslam/factors/static_weight.hpp"
#include "dynslam/factors/weighted_reprojection.hpp"

#include "factors/synthetic.hpp"

namespace dynslam::factors {
namespace {

using kernels::kPointPadding;

// Runs a check on every instruction set this binary and machine have in common.
template <typename Check>
void on_all_targets(const Check& check) {
  int count = 0;
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    SCOPED_TRACE(hwy::TargetName(target));
    check();
    ++count;
  }
  hwy::SetSupportedTargetsForTest(0);
  EXPECT_GT(count, 0);
}

// Points before, beside and behind the camera, mono and with depth, in the kernels' layout.
struct Problem {
  std::size_t size, room;
  hwy::AlignedFreeUniquePtr<double[]> block;
  double *x, *y, *z, *u, *v, *right, *info, *info_right, *trust, *phi0, *phi, *s, *w, *c, *gw, *out;
  kernels::View view{};
  kernels::Points points;
  RigidTransform T;
  DepthCamera camera = synthetic::kinect();

  explicit Problem(std::size_t n)
      : size(n),
        room((n / kPointPadding + 2) * kPointPadding),
        block(hwy::AllocateAligned<double>(room * 16)) {
    std::fill(block.get(), block.get() + room * 16, 0.0);
    double** const all[] = {&x,     &y,    &z,   &u, &v, &right, &info, &info_right,
                            &trust, &phi0, &phi, &s, &w, &c,     &gw,   &out};
    for (std::size_t i = 0; i < 16; ++i) *all[i] = block.get() + i * room;
    std::mt19937 rng(static_cast<unsigned>(n));
    std::uniform_real_distribution<double> uniform(0.0, 1.0);
    T = se3_exp(synthetic::random_twist(rng, 1.0, 1.0));
    for (std::size_t i = 0; i < n; ++i) {
      const Eigen::Vector3d X = camera.unproject(synthetic::random_pixel(rng),
                                                 i % 7 == 3 ? -2.0 : 1.0 + 3.0 * uniform(rng));
      const Eigen::Vector3d world = T.inverse() * X;
      x[i] = world.x(), y[i] = world.y(), z[i] = world.z();
      const Eigen::Vector3d p = camera.project3(X);
      u[i] = p[0] + 6.0 * uniform(rng) - 3.0;
      v[i] = p[1] + 6.0 * uniform(rng) - 3.0;
      right[i] = p[2] + 4.0 * uniform(rng) - 2.0;
      info[i] = 0.5 + uniform(rng);
      info_right[i] = i % 3 == 1 ? 0.0 : 0.5 + uniform(rng);
      phi0[i] = i % 5 == 4 ? 0.0 : uniform(rng);
      trust[i] = phi0[i] * phi0[i];
      phi[i] = phi0[i] * uniform(rng);
    }
    view = {camera.fx, camera.fy, camera.cx, camera.cy, camera.bf, {}, {}};
    for (int i = 0; i < 9; ++i) view.R[i] = T.R(i / 3, i % 3);
    for (int i = 0; i < 3; ++i) view.t[i] = T.t[i];
    points = {n, x, y, z, u, v, right, info, info_right};
  }

  // Whitened residual and its pose Jacobian by the plain factor; 3 rows, the last 0 for mono.
  bool plain(std::size_t i, Eigen::Vector3d& e, Eigen::Matrix<double, 3, 6>& J) const {
    Eigen::Matrix3d L = Eigen::Matrix3d::Zero();
    L.diagonal() << std::sqrt(info[i]), std::sqrt(info[i]), std::sqrt(info_right[i]);
    return weighted_reprojection<3>(camera, T, {x[i], y[i], z[i]}, {u[i], v[i], right[i]}, L, 1.0,
                                    e, {&J});
  }
};

const std::size_t kSizes[] = {0, 1, 2, 3, 5, 7, 8, 15, 16, 17, 63, 64, 100};

TEST(PoseKernels, ResidualsEqualThePlainFactorsOnAllTargets) {
  on_all_targets([] {
    for (const std::size_t n : kSizes) {
      Problem p(n);
      kernels::residuals(p.view, p.points, p.s);
      for (std::size_t i = 0; i < n; ++i) {
        Eigen::Vector3d e;
        Eigen::Matrix<double, 3, 6> J;
        if (p.plain(i, e, J)) {
          EXPECT_NEAR(p.s[i], e.squaredNorm(), 1e-9 * (1.0 + e.squaredNorm()));
        } else {
          EXPECT_EQ(p.s[i], -1.0);
        }
      }
    }
  });
}

TEST(PoseKernels, LossesEqualThePlainOnesOnAllTargets) {
  on_all_targets([] {
    const std::pair<kernels::Loss, RobustLoss> losses[] = {
        {kernels::Loss::kLeastSquares, {}},
        {kernels::Loss::kHuber, {LossKind::kHuber, 1.5, 0.0}},
        {kernels::Loss::kGemanMcClure, {LossKind::kGemanMcClure, 1.5, 0.0}}};
    for (const std::size_t n : kSizes) {
      Problem p(n);
      kernels::residuals(p.view, p.points, p.s);
      for (const auto& [kernel, loss] : losses) {
        const double c2 = loss.scale * loss.scale;
        const double cost = kernels::weigh(kernel, c2, 1.0, n, p.s, p.trust, p.w, p.c);
        double expected = 0.0;
        for (std::size_t i = 0; i < n; ++i) {
          const bool front = p.s[i] >= 0.0;
          const LossValue value = loss(front ? p.s[i] : kernels::kBehindSquared);
          expected += 0.5 * p.trust[i] * value.rho;
          EXPECT_NEAR(p.w[i], front ? p.trust[i] * value.rho1 : 0.0, 1e-12);
          EXPECT_NEAR(p.c[i], front ? 2.0 * p.trust[i] * value.rho2 : 0.0, 1e-12);
        }
        EXPECT_NEAR(cost, expected, 1e-11 * (1.0 + expected));
      }
    }
  });
}

TEST(PoseKernels, NormalEquationsEqualThePlainFactorsOnAllTargets) {
  on_all_targets([] {
    for (const std::size_t n : kSizes) {
      Problem p(n);
      kernels::residuals(p.view, p.points, p.s);
      kernels::weigh(kernels::Loss::kGemanMcClure, 4.0, 1.0, n, p.s, p.trust, p.w, p.c);
      kernels::Normal normal;
      kernels::normal_equations(p.view, p.points, p.w, p.c, p.w, &normal);
      Matrix6d H = Matrix6d::Zero();
      Vector6d g = Vector6d::Zero();
      for (std::size_t i = 0; i < n; ++i) {
        Eigen::Vector3d e;
        Eigen::Matrix<double, 3, 6> J;
        if (!p.plain(i, e, J)) continue;
        const Vector6d q = -J.transpose() * e;
        H += p.w[i] * J.transpose() * J + p.c[i] * q * q.transpose();
        g += p.w[i] * q;
      }
      int k = 0;
      for (int i = 0; i < 6; ++i) {
        EXPECT_NEAR(normal.g[i], g[i], 1e-10 * (1.0 + g.norm()));
        for (int j = i; j < 6; ++j) EXPECT_NEAR(normal.H[k++], H(i, j), 1e-10 * (1.0 + H.norm()));
      }
    }
  });
}

// The joint kernels against the joint Newton system, written out with every phi as an unknown.
TEST(PoseKernels, JointStepSolvesTheWholeNewtonSystemOnAllTargets) {
  on_all_targets([] {
    constexpr double kLambda = 9.0;
    for (const std::size_t n : {std::size_t{9}, std::size_t{17}}) {
      Problem p(n);
      for (std::size_t i = 0; i < n; ++i) {  // all in front, weights inside (0, 1)
        if (i % 7 == 3) p.x[i] = p.x[0], p.y[i] = p.y[0], p.z[i] = p.z[0];
        if (i % 7 == 3) p.u[i] = p.u[0] + 1.0, p.v[i] = p.v[0], p.right[i] = p.right[0] - 1.0;
        p.phi0[i] = 0.8, p.phi[i] = 0.5, p.trust[i] = 1.0;
      }
      kernels::residuals(p.view, p.points, p.s);
      const double cost =
          kernels::weigh_joint(kLambda, 2.0, n, p.s, p.trust, p.phi0, p.phi, p.w, p.c, p.gw);
      kernels::Normal normal;
      kernels::normal_equations(p.view, p.points, p.w, p.c, p.gw, &normal);
      Matrix6d H;
      Vector6d g;
      int k = 0;
      for (int i = 0; i < 6; ++i) {
        g[i] = normal.g[i];
        for (int j = i; j < 6; ++j) H(i, j) = H(j, i) = normal.H[k++];
      }
      const Vector6d step = H.fullPivLu().solve(g);
      kernels::step_joint(p.view, p.points, kLambda, 2.0, step.data(), p.s, p.phi0, p.phi, p.out);

      const auto m = static_cast<Eigen::Index>(n);
      Eigen::MatrixXd whole = Eigen::MatrixXd::Zero(6 + m, 6 + m);
      Eigen::VectorXd gradient = Eigen::VectorXd::Zero(6 + m);
      double expected_cost = 0.0;
      for (std::size_t i = 0; i < n; ++i) {
        Eigen::Vector3d e;
        Eigen::Matrix<double, 3, 6> J;
        ASSERT_TRUE(p.plain(i, e, J));
        const double f = p.phi[i], s = e.squaredNorm();
        const auto row = 6 + static_cast<Eigen::Index>(i);
        expected_cost += weighted_cost(f, p.phi0[i], s, kLambda);
        whole.topLeftCorner<6, 6>() += f * f * J.transpose() * J;
        whole.block<6, 1>(0, row) = 2.0 * f * J.transpose() * e;
        whole.block<1, 6>(row, 0) = whole.block<6, 1>(0, row).transpose();
        whole(row, row) = s + kLambda;
        gradient.head<6>() += f * f * J.transpose() * e;
        gradient[row] = f * s + kLambda * (f - p.phi0[i]);
      }
      const Eigen::VectorXd solution = whole.fullPivLu().solve(-gradient);
      EXPECT_NEAR(cost, expected_cost, 1e-10 * expected_cost);
      EXPECT_LT((solution.head<6>() - step).norm(), 1e-8 * (1.0 + step.norm()));
      for (std::size_t i = 0; i < n; ++i) {
        const double moved = p.phi[i] + solution[6 + static_cast<Eigen::Index>(i)];
        EXPECT_NEAR(p.out[i], std::min(1.0, std::max(0.0, moved)), 1e-8);
      }
    }
  });
}

TEST(PoseKernels, MeanResidualCountsWhatIsInFront) {
  on_all_targets([] {
    Problem p(100);
    kernels::residuals(p.view, p.points, p.s);
    double sum = 0.0, total = 0.0, expected_sum = 0.0, expected_total = 0.0;
    kernels::mean_residual(100, p.s, p.trust, &sum, &total);
    for (std::size_t i = 0; i < 100; ++i) {
      if (p.s[i] < 0.0) continue;
      expected_sum += p.trust[i] * std::sqrt(p.s[i]);
      expected_total += p.trust[i];
    }
    EXPECT_NEAR(sum, expected_sum, 1e-10 * expected_sum);
    EXPECT_NEAR(total, expected_total, 1e-10 * expected_total);
  });
}

}  // namespace
}  // namespace dynslam::factors
