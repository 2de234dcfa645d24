#include "dynslam/evaluation/alignment.hpp"

#include <limits>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

#include "evaluation/support.hpp"

namespace dynslam::evaluation {
namespace {

Eigen::Matrix3Xd random_points(std::mt19937& random, int count, double sigma = 5.0) {
  Eigen::Matrix3Xd points(3, count);
  for (int i = 0; i < count; ++i) points.col(i) = testing::random_vector(random, sigma);
  return points;
}

Eigen::Matrix3Xd apply(const Similarity& S, const Eigen::Matrix3Xd& points) {
  Eigen::Matrix3Xd moved(3, points.cols());
  for (Eigen::Index i = 0; i < points.cols(); ++i) moved.col(i) = S * points.col(i).eval();
  return moved;
}

double cost(const Similarity& S, const Eigen::Matrix3Xd& truth, const Eigen::Matrix3Xd& estimate) {
  return (truth - apply(S, estimate)).squaredNorm();
}

TEST(Alignment, RecoversARandomTransform) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> scale(0.1, 10.0);
  for (int round = 0; round < 200; ++round) {
    const Eigen::Matrix3Xd estimate = random_points(random, 3 + round % 40);
    Similarity S{1.0, testing::random_transform(random)};
    AlignmentResult found = align_points(apply(S, estimate), estimate, Alignment::kSE3);
    EXPECT_EQ(found.status, AlignmentStatus::kOk);
    EXPECT_LT((found.truth_from_estimate.T.matrix() - S.T.matrix()).norm(), 1e-10) << round;
    EXPECT_EQ(found.truth_from_estimate.scale, 1.0);

    S.scale = scale(random);
    found = align_points(apply(S, estimate), estimate, Alignment::kSim3);
    EXPECT_LT((found.truth_from_estimate.T.matrix() - S.T.matrix()).norm(), 1e-10) << round;
    EXPECT_NEAR(found.truth_from_estimate.scale, S.scale, 1e-10);
  }
}

TEST(Alignment, CannotBeImprovedByASmallMotion) {
  std::mt19937 random(2);
  for (int round = 0; round < 20; ++round) {
    const Eigen::Matrix3Xd estimate = random_points(random, 12);
    const Eigen::Matrix3Xd truth = random_points(random, 12);  // nothing in common: the worst case
    for (const Alignment kind : {Alignment::kSE3, Alignment::kSim3}) {
      const Similarity best = align_points(truth, estimate, kind).truth_from_estimate;
      EXPECT_NEAR(best.T.R.determinant(), 1.0, 1e-12);
      const double least = cost(best, truth, estimate);
      for (int axis = 0; axis < 6; ++axis) {
        for (const double step : {-1e-4, 1e-4}) {
          Similarity other = best;
          other.T = se3_exp(step * Vector6d::Unit(axis)) * best.T;
          EXPECT_GE(cost(other, truth, estimate), least);
        }
      }
      if (kind == Alignment::kSim3) {
        for (const double factor : {0.999, 1.001}) {
          Similarity other = best;
          other.scale *= factor;
          EXPECT_GE(cost(other, truth, estimate), least);
        }
      }
    }
  }
}

TEST(Alignment, GivesARotationForMirroredPoints) {
  std::mt19937 random(3);
  const Eigen::Matrix3Xd points = random_points(random, 30);
  Eigen::Matrix3Xd mirrored = points;
  mirrored.row(2) *= -1.0;
  const AlignmentResult found = align_points(mirrored, points);
  EXPECT_NEAR(found.truth_from_estimate.T.R.determinant(), 1.0, 1e-12);
}

TEST(Alignment, IsUniqueForPointsInAPlane) {
  std::mt19937 random(4);
  Eigen::Matrix3Xd estimate = random_points(random, 20);
  estimate.row(1).setZero();
  const Similarity S{1.0, testing::random_transform(random)};
  const AlignmentResult found = align_points(apply(S, estimate), estimate);
  EXPECT_EQ(found.status, AlignmentStatus::kOk);
  EXPECT_LT((found.truth_from_estimate.T.matrix() - S.T.matrix()).norm(), 1e-10);
}

TEST(Alignment, LaysALineOnALineByTheSmallestRotation) {
  Eigen::Matrix3Xd estimate(3, 4), truth(3, 4);
  for (int i = 0; i < 4; ++i) {
    estimate.col(i) = Eigen::Vector3d(i * 1.0, 0.0, 0.0);
    truth.col(i) = Eigen::Vector3d(7.0, 2.0 + i * 1.0, 0.0);
  }
  const AlignmentResult found = align_points(truth, estimate);
  EXPECT_EQ(found.status, AlignmentStatus::kCollinear);
  EXPECT_LT(cost(found.truth_from_estimate, truth, estimate), 1e-20);
  EXPECT_NEAR(so3_log(found.truth_from_estimate.T.R).norm(), M_PI / 2, 1e-9);
  // Two points are a line, also far from the origin.
  const AlignmentResult two =
      align_points(truth.leftCols(2).colwise() + Eigen::Vector3d(1e4, 0, 0), estimate.leftCols(2));
  EXPECT_EQ(two.status, AlignmentStatus::kCollinear);
  // Lines in opposite directions.
  const AlignmentResult back = align_points(-estimate, estimate, Alignment::kSim3);
  EXPECT_EQ(back.status, AlignmentStatus::kCollinear);
  EXPECT_LT(cost(back.truth_from_estimate, -estimate, estimate), 1e-20);
  EXPECT_NEAR(back.truth_from_estimate.scale, 1.0, 1e-12);
}

TEST(Alignment, OnlyTranslatesPointsWithoutExtent) {
  const Eigen::Vector3d p(1000.1, -2000.7, 3.3);
  const Eigen::Matrix3Xd same = p.replicate(1, 9);
  std::mt19937 random(5);
  const Eigen::Matrix3Xd spread = random_points(random, 9);
  for (const Alignment kind : {Alignment::kSE3, Alignment::kSim3}) {
    for (const bool truth_is_same : {false, true}) {
      const AlignmentResult found =
          truth_is_same ? align_points(same, spread, kind) : align_points(spread, same, kind);
      EXPECT_EQ(found.status, AlignmentStatus::kNoExtent);
      EXPECT_TRUE(found.truth_from_estimate.T.R.isIdentity(0.0));
      EXPECT_EQ(found.truth_from_estimate.scale, 1.0);
      const Eigen::Vector3d moved = spread.rowwise().mean() - p;
      EXPECT_LT((found.truth_from_estimate.T.t - (truth_is_same ? -moved : moved)).norm(), 1e-9);
    }
    const AlignmentResult one = align_points(same.leftCols(1), spread.leftCols(1), kind);
    EXPECT_EQ(one.status, AlignmentStatus::kNoExtent);
    EXPECT_LT((one.truth_from_estimate * spread.col(0).eval() - p).norm(), 1e-12);
  }
}

TEST(Alignment, OfNoPointsOrNotAskedForIsTheIdentity) {
  const Eigen::Matrix3Xd none(3, 0);
  AlignmentResult found = align_points(none, none);
  EXPECT_EQ(found.status, AlignmentStatus::kNoPoints);
  EXPECT_TRUE(found.truth_from_estimate.T.matrix().isIdentity(0.0));
  std::mt19937 random(6);
  found = align_points(random_points(random, 5), random_points(random, 5), Alignment::kNone);
  EXPECT_EQ(found.status, AlignmentStatus::kNotAsked);
  EXPECT_TRUE(found.truth_from_estimate.T.matrix().isIdentity(0.0));
}

TEST(Alignment, RefusesUnequalCountsAndNaN) {
  std::mt19937 random(7);
  Eigen::Matrix3Xd a = random_points(random, 4);
  const Eigen::Matrix3Xd b = random_points(random, 5);
  EXPECT_THROW(align_points(a, b), InvalidArgument);
  Eigen::Matrix3Xd c = a;
  c(1, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(align_points(a, c), InvalidArgument);
  EXPECT_THROW(align_points(c, a), InvalidArgument);
}

TEST(Alignment, MovesPosesLikePoints) {
  std::mt19937 random(8);
  const Similarity S{2.5, testing::random_transform(random)};
  const Trajectory walk = testing::random_walk(random, 5);
  const Trajectory moved = transform(walk, S);
  for (std::size_t i = 0; i < walk.size(); ++i) {
    EXPECT_EQ(moved[i].timestamp, walk[i].timestamp);
    const Eigen::Vector3d ahead = walk[i].T_world_cam * Eigen::Vector3d(0, 0, 1);
    const Eigen::Vector3d expected = S * ahead;
    EXPECT_LT((moved[i].T_world_cam * Eigen::Vector3d(0, 0, 2.5) - expected).norm(), 1e-12)
        << "a point one unit ahead is 2.5 units ahead after scaling";
  }
}

TEST(Alignment, HasNames) {
  EXPECT_EQ(to_string(Alignment::kNone), "none");
  EXPECT_EQ(to_string(Alignment::kSE3), "se3");
  EXPECT_EQ(to_string(Alignment::kSim3), "sim3");
  EXPECT_EQ(to_string(AlignmentStatus::kOk), "ok");
  EXPECT_NE(to_string(AlignmentStatus::kCollinear), to_string(AlignmentStatus::kNoExtent));
}

}  // namespace
}  // namespace dynslam::evaluation
