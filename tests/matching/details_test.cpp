// The parts of the default rule, each against a plain reference.
#include <cmath>
#include <cstdint>
#include <vector>

#include <Eigen/Core>
#include <gtest/gtest.h>

#include "dynslam/matching/detail/epipolar_fit.hpp"
#include "dynslam/matching/detail/local_support.hpp"
#include "dynslam/matching/reject.hpp"

#include "matching/synthetic_pairs.hpp"

namespace {

namespace dm = dynslam::matching;
namespace detail = dynslam::matching::detail;

synthetic::Setup sideways(std::size_t matches, double outliers, double noise) {
  synthetic::Setup setup;
  setup.matches = matches;
  setup.outliers = outliers;
  setup.noise = noise;
  setup.camera.translation << -0.3, 0.05, 0.1;
  setup.camera.rotation = synthetic::turn(2, 1, 3);
  setup.camera.roll_degrees = 3;
  return setup;
}

/// Normalized fit points of a scene, and its true F in their coordinates.
detail::Matrix3d scene_points(const synthetic::Setup& setup, detail::FitPoints& points) {
  const synthetic::Pairs pairs = synthetic::make_pairs(setup);
  constexpr double kScale = 1.0 / 160.0;
  for (std::size_t i = 0; i < pairs.matches.size(); ++i) {
    const auto to = [](float value, double centre) {
      return static_cast<float>((static_cast<double>(value) - centre) * kScale);
    };
    points.push(to(pairs.points1[i].x, 320), to(pairs.points1[i].y, 240),
                to(pairs.points2[i].x, 320), to(pairs.points2[i].y, 240), 1.0F);
  }
  points.pad();
  Eigen::Matrix3d k = Eigen::Matrix3d::Identity();
  k(0, 0) = k(1, 1) = 525.0 * kScale;
  const Eigen::Vector3d& t = setup.camera.translation;
  Eigen::Matrix3d cross;
  cross << 0, -t.z(), t.y(), t.z(), 0, -t.x(), -t.y(), t.x(), 0;
  const Eigen::Matrix3d k_inverse = k.inverse();
  detail::Matrix3d f = k_inverse.transpose() * cross * setup.camera.rotation * k_inverse;
  return f / f.norm();
}

double distance_of(const detail::Matrix3d& a, const detail::Matrix3d& b) {
  return std::min((a - b).norm(), (a + b).norm());
}

double sampson(const detail::Matrix3d& f, const detail::FitPoints& points, std::size_t i) {
  const Eigen::Vector3d p(points.x1[i], points.y1[i], 1.0);
  const Eigen::Vector3d q(points.x2[i], points.y2[i], 1.0);
  const Eigen::Vector3d l = f * p;
  const Eigen::Vector3d m = f.transpose() * q;
  const double e = q.dot(l);
  return e * e / (l.head<2>().squaredNorm() + m.head<2>().squaredNorm());
}

TEST(FitEight, IsExactOnExactMatches) {
  dm::Workspace workspace;
  const dm::Workspace::Frame frame(workspace);
  detail::FitPoints points(200, workspace);
  const detail::Matrix3d truth = scene_points(sideways(200, 0.0, 0.0), points);
  const std::size_t index[8] = {3, 40, 66, 91, 110, 133, 170, 199};
  detail::Matrix3d f;
  ASSERT_TRUE(detail::fit_eight(points, index, f));
  EXPECT_LT(distance_of(f, truth), 1e-3);
  for (const std::size_t i : index) EXPECT_LT(sampson(f, points, i), 1e-11);
}

TEST(FitEight, RefusesEightTimesTheSameMatch) {
  dm::Workspace workspace;
  const dm::Workspace::Frame frame(workspace);
  detail::FitPoints points(10, workspace);
  scene_points(sideways(10, 0.0, 0.0), points);
  const std::size_t index[8] = {1, 1, 1, 1, 1, 1, 1, 1};
  detail::Matrix3d f;
  EXPECT_FALSE(detail::fit_eight(points, index, f));
}

TEST(TruncatedCost, IsTheSumOfTruncatedSampsonDistances) {
  dm::Workspace workspace;
  const dm::Workspace::Frame frame(workspace);
  detail::FitPoints points(203, workspace);
  const detail::Matrix3d f = scene_points(sideways(203, 0.4, 1.0), points);
  for (const double limit : {0.005, 0.02, 0.5}) {
    double expected = 0.0;
    for (std::size_t i = 0; i < points.size; ++i) {
      expected += std::min(1.0, sampson(f, points, i) / (limit * limit));
    }
    EXPECT_NEAR(detail::truncated_cost(f, points, static_cast<float>(limit)), expected,
                1e-3 * expected);
  }
}

TEST(Cofactors, AreTheDerivativeOfTheDeterminant) {
  detail::Matrix3d f;
  f << 0.3, -0.2, 0.7, 0.1, 0.9, -0.4, 0.25, 0.6, -0.8;
  const detail::Vector9d analytic = detail::cofactors(f);
  for (int i = 0; i < 9; ++i) {
    detail::Matrix3d up = f, down = f;
    up.data()[i] += 1e-6;
    down.data()[i] -= 1e-6;
    EXPECT_NEAR(analytic[i], (up.determinant() - down.determinant()) / 2e-6, 1e-8) << i;
  }
}

TEST(SolveSpd, SolvesAgainstEigen) {
  const detail::Matrix9d half = detail::Matrix9d::Random();
  const detail::Matrix9d a = half * half.transpose() + detail::Matrix9d::Identity();
  const detail::Vector9d x = detail::Vector9d::LinSpaced(-2, 5);
  detail::Vector9d b = a * x;
  detail::Matrix9d copy = a;
  detail::solve_spd(copy, b);
  EXPECT_LT((b - x).norm(), 1e-9);
}

TEST(Refine, ConvergesToTheTruthFromADisturbedMatrix) {
  dm::Workspace workspace;
  const dm::Workspace::Frame frame(workspace);
  detail::FitPoints points(300, workspace);
  const detail::Matrix3d truth = scene_points(sideways(300, 0.0, 0.0), points);
  detail::Matrix3d f = truth;
  f(0, 0) += 0.01, f(1, 2) -= 0.02, f(2, 1) += 0.02, f(2, 2) += 0.01;
  f /= f.norm();
  const double before = distance_of(f, truth);
  for (int i = 0; i < 8; ++i) detail::refine(f, points, 0.1F);
  EXPECT_LT(distance_of(f, truth), 0.01 * before);
  EXPECT_LT(std::abs(f.determinant()), 1e-6);
  EXPECT_NEAR(f.norm(), 1.0, 1e-12);
}

TEST(Refine, EndsWhereTheRobustCostIsLeast) {
  dm::Workspace workspace;
  const dm::Workspace::Frame frame(workspace);
  detail::FitPoints points(400, workspace);
  detail::Matrix3d f = scene_points(sideways(400, 0.3, 1.0), points);
  constexpr double kLimit = 3.0 / 160.0;
  for (int i = 0; i < 30; ++i) detail::refine(f, points, static_cast<float>(kLimit));
  const auto cost = [&](const detail::Matrix3d& at) {
    double sum = 0.0;
    for (std::size_t i = 0; i < points.size; ++i) {
      const double x = sampson(at, points, i) / (kLimit * kLimit);
      sum += x / (1.0 + x);
    }
    return sum;
  };
  const double best = cost(f);
  const Eigen::Map<const detail::Vector9d> at(f.data());
  const detail::Vector9d normal = detail::cofactors(f).normalized();
  for (int i = 0; i < 9; ++i) {
    for (const double sign : {-1.0, 1.0}) {
      // Along the singular matrices of unit norm.
      detail::Vector9d step = detail::Vector9d::Unit(i);
      step -= normal * normal.dot(step);
      step -= at * at.dot(step);
      detail::Matrix3d other = f;
      Eigen::Map<detail::Vector9d>(other.data()) += sign * 3e-3 * step;
      EXPECT_GE(cost(other), best - 1e-3) << i;
    }
  }
}

TEST(Refine, LeavesTheMatrixAloneWithoutAnyWeight) {
  dm::Workspace workspace;
  const dm::Workspace::Frame frame(workspace);
  detail::FitPoints points(50, workspace);
  const detail::Matrix3d truth = scene_points(sideways(50, 0.0, 0.0), points);
  for (std::size_t i = 0; i < points.size; ++i) points.weight[i] = 0.0F;
  detail::Matrix3d f = truth;
  detail::refine(f, points, 0.01F);
  EXPECT_EQ(f, truth);
}

struct Gathered {
  explicit Gathered(const synthetic::Pairs& pairs, dm::Workspace& workspace)
      : buffer(pairs.matches.size(), workspace) {
    detail::gather(pairs.matches, pairs.points1, pairs.points2, buffer);
  }
  detail::PairsBuffer buffer;
};

TEST(LocalSupport, AgreesWithAPlainDoubleLoop) {
  for (const std::size_t n : {3U, 10U, 57U, 300U}) {
    synthetic::Setup setup = sideways(n, 0.3, 0.7);
    setup.seed = static_cast<unsigned>(n);
    dm::Workspace workspace;
    const dm::Workspace::Frame frame(workspace);
    const Gathered gathered(synthetic::make_pairs(setup), workspace);
    const dm::PairsView pairs = gathered.buffer.view();
    const detail::SupportTolerance tolerance{3.0F, 0.2F, 3.0F};
    const detail::LocalSupport local(pairs, tolerance, {}, workspace);
    const auto weight = [&](std::size_t i, std::size_t j) {
      const double ax = pairs.x1[j] - pairs.x1[i], ay = pairs.y1[j] - pairs.y1[i];
      const double bx = pairs.x2[j] - pairs.x2[i], by = pairs.y2[j] - pairs.y2[i];
      const double e2 = (bx - ax) * (bx - ax) + (by - ay) * (by - ay);
      const double near = std::min(ax * ax + ay * ay, bx * bx + by * by) / 9.0;
      return std::max(0.0, 1.0 - e2 / (9.0 + 0.04 * (ax * ax + ay * ay))) *
             std::min(1.0, near * near);
    };
    // The grid limits who is looked at: never more support than all matches give, and in small
    // sets, where the cells are few and not crowded, all of what the nearest give.
    double total = 0.0, everyone = 0.0;
    for (std::size_t k = 0; k < n; ++k) {
      double all = 0.0;
      for (std::size_t j = 0; j < n; ++j) {
        if (j != local.source()[k]) all += weight(local.source()[k], j);
      }
      EXPECT_LE(local.support()[k], all + 1e-3);
      total += static_cast<double>(local.support()[k]);
      everyone += all;
    }
    if (n <= 3) {
      EXPECT_NEAR(total, everyone, 1e-3);
    }
    EXPECT_EQ(local.count_above(-1.0F), n);
  }
}

TEST(LocalSupport, CountsEachPairForBoth) {
  // Four matches in a 2 x 2 block 10 px apart that move alike, far from others: support 3 each.
  dm::Workspace workspace;
  const dm::Workspace::Frame frame(workspace);
  synthetic::Pairs pairs;
  for (int i = 0; i < 4; ++i) {
    dm::Keypoint a, b;
    a.x = 100.0F + 10.0F * static_cast<float>(i % 2);
    a.y = 100.0F + 10.0F * static_cast<float>(i / 2);
    b.x = a.x + 5.0F, b.y = a.y;
    pairs.points1.push_back(a);
    pairs.points2.push_back(b);
    pairs.matches.push_back({i, i, 0.0F});
  }
  const Gathered gathered(pairs, workspace);
  const dm::PairsView view = gathered.buffer.view();
  const detail::LocalSupport local(view, {3.0F, 0.2F, 3.0F}, {}, workspace);
  for (std::size_t k = 0; k < 4; ++k) EXPECT_FLOAT_EQ(local.support()[k], 3.0F);
  const auto value = workspace.take_filled<float>(12, 0.0F);
  for (std::size_t k = 0; k < 4; ++k) value[k] = static_cast<float>(k);
  EXPECT_FLOAT_EQ(local.mean_over_supporters(0, value), 2.0F);  // of 1, 2, 3
}

TEST(DominantSimilarity, IsMeasuredFromKeyPoints) {
  dm::Workspace workspace;
  const dm::Workspace::Frame frame(workspace);
  synthetic::Setup setup;
  setup.camera.rotation = synthetic::turn(0, 0, 130);
  setup.camera.roll_degrees = 130;
  synthetic::Pairs scene = synthetic::make_pairs(setup);
  for (std::size_t i = 0; i < scene.points1.size(); ++i) {
    scene.points1[i].size = 31.0F;
    scene.points2[i].size = 31.0F * (i % 2 == 0 ? 1.2F : 1.44F);
  }
  const Gathered gathered(scene, workspace);
  const detail::Similarity similarity = detail::dominant_similarity(gathered.buffer.view());
  EXPECT_FALSE(similarity.doubtful);
  EXPECT_NEAR(std::atan2(similarity.sine, similarity.cosine) * 57.29578F, 130.0F, 2.0F);
  EXPECT_NEAR(std::hypot(similarity.sine, similarity.cosine), 1.314F, 0.03F);
}

TEST(DominantSimilarity, IsMeasuredFromLinesWithoutAngles) {
  dm::Workspace workspace;
  const dm::Workspace::Frame frame(workspace);
  synthetic::Setup setup;
  setup.camera.rotation = synthetic::turn(0, 0, -70);
  setup.angles = false;
  setup.scale2 = 1.5;
  const Gathered gathered(synthetic::make_pairs(setup), workspace);
  const detail::Similarity similarity = detail::dominant_similarity(gathered.buffer.view());
  EXPECT_TRUE(similarity.doubtful);
  EXPECT_NEAR(std::atan2(similarity.sine, similarity.cosine) * 57.29578F, -70.0F, 3.0F);
  EXPECT_NEAR(std::hypot(similarity.sine, similarity.cosine), 1.5F, 0.1F);
}

TEST(DominantSimilarity, IsTheIdentityWhereNoTurnStandsOut) {
  dm::Workspace workspace;
  const dm::Workspace::Frame frame(workspace);
  synthetic::Setup setup;
  setup.outliers = 1.0;
  const Gathered gathered(synthetic::make_pairs(setup), workspace);
  const detail::Similarity similarity = detail::dominant_similarity(gathered.buffer.view());
  EXPECT_EQ(similarity.cosine, 1.0F);
  EXPECT_EQ(similarity.sine, 0.0F);
}

}  // namespace
