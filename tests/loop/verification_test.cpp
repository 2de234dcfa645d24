#include "dynslam/loop/verification.hpp"

#include <array>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/so3.hpp"

namespace dynslam::loop {
namespace {

using Eigen::Matrix2Xd;
using Eigen::Matrix3Xd;

PinholeCamera camera() {
  PinholeCamera result;
  result.fx = result.fy = 500.0;
  result.cx = 320.0;
  result.cy = 240.0;
  result.width = 640;
  result.height = 480;
  return result;
}

// Points seen by two cameras, with pixel noise; the last `outliers` columns belong to nothing.
struct Scene {
  Scene(int inliers, int outliers, double noise = 0.5, double scale_ = 1.0, unsigned seed = 1)
      : scale(scale_) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> u(0.0, 1.0);
    std::normal_distribution<double> gauss(0.0, 1.0);
    T_candidate_query = {so3_exp({0.05, -0.2, 0.1}), {0.4, -0.1, 0.3}};
    const int n = inliers + outliers;
    query_pixels.resize(2, n);
    candidate_pixels.resize(2, n);
    query_points.resize(3, n);
    candidate_points.resize(3, n);
    const PinholeCamera c = camera();
    for (int i = 0; i < n;) {
      const Eigen::Vector2d p(640.0 * u(random), 480.0 * u(random));
      const Eigen::Vector3d x = c.unproject(p, 2.0 + 4.0 * u(random));
      Eigen::Vector3d y = scale * (T_candidate_query.R * x) + T_candidate_query.t;
      Eigen::Vector2d q = c.project(y);
      if (i >= inliers) {
        q = {640.0 * u(random), 480.0 * u(random)};
        y = c.unproject(q, 2.0 + 4.0 * u(random));
      }
      if (!c.contains(q)) continue;
      const auto jitter = [&]() -> Eigen::Vector2d {
        return Eigen::Vector2d(gauss(random), gauss(random)) * noise;
      };
      query_pixels.col(i) = p + jitter();
      candidate_pixels.col(i) = q + jitter();
      query_points.col(i) = x;
      candidate_points.col(i) = y;
      ++i;
    }
  }
  PointMatches matches() const {
    return {query_points, query_pixels, candidate_points, candidate_pixels};
  }

  double scale;
  RigidTransform T_candidate_query;
  Matrix2Xd query_pixels, candidate_pixels;
  Matrix3Xd query_points, candidate_points;
};

void expect_motion(const RigidTransform& T, const RigidTransform& expected, double metres,
                   double radians) {
  EXPECT_LT((T.t - expected.t).norm(), metres);
  EXPECT_LT(rotation_angle(T.R, expected.R), radians);
}

TEST(VerifyEpipolar, FindsTheGeometryAmongOutliers) {
  const Scene scene(60, 60);
  EpipolarModel model;
  const Verification result =
      verify_epipolar(scene.query_pixels, scene.candidate_pixels, 640, 480, {}, &model);
  EXPECT_EQ(result.verdict, Verdict::kVerified);
  EXPECT_GE(result.matches, 118u);
  EXPECT_GE(result.inliers, 55u);
  EXPECT_LE(result.inliers, 70u);
  EXPECT_GT(result.confidence, 2.0);
  ASSERT_EQ(model.inliers.size(), 120u);
  for (std::size_t i = 0; i < 55; ++i) {
    const auto c = static_cast<Eigen::Index>(i);
    const Eigen::Vector3d line = model.F * scene.query_pixels.col(c).homogeneous();
    const double e = scene.candidate_pixels.col(c).homogeneous().dot(line) / line.head<2>().norm();
    if (model.inliers[i] != 0) {
      EXPECT_LT(std::abs(e), 3.0);
    }
  }
  EXPECT_NEAR(model.F.determinant(), 0.0, 1e-9);
}

TEST(VerifyEpipolar, FindsNothingInRandomMatches) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    const Scene scene(0, 100, 0.5, 1.0, seed);
    const Verification result =
        verify_epipolar(scene.query_pixels, scene.candidate_pixels, 640, 480);
    EXPECT_EQ(result.verdict, Verdict::kNoGeometry) << seed;
    EXPECT_LT(result.confidence, 1.0);
  }
}

TEST(VerifyEpipolar, VerifiesPureRotationsAndPlanesAsWell) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const PinholeCamera c = camera();
  Matrix2Xd a(2, 50), b(2, 50);
  for (Eigen::Index i = 0; i < 50; ++i) {
    a.col(i) << 100.0 + 440.0 * u(random), 100.0 + 280.0 * u(random);
    b.col(i) = c.project(so3_exp({0.02, 0.1, -0.05}) * c.bearing(a.col(i)));
  }
  EXPECT_EQ(verify_epipolar(a, b, 640, 480).verdict, Verdict::kVerified);
}

TEST(VerifyEpipolar, CountsMatchesAtOnePlaceOnce) {
  const Scene scene(9, 0, 0.0);
  const Matrix2Xd a = scene.query_pixels.replicate(1, 5),
                  b = scene.candidate_pixels.replicate(1, 5);
  const Verification result = verify_epipolar(a, b, 640, 480);
  EXPECT_EQ(result.verdict, Verdict::kFewMatches);
  EXPECT_EQ(result.matches, 9u);
}

TEST(VerifyEpipolar, TakesMatchesWithoutCoordinatesForOutliers) {
  Scene scene(60, 3);
  scene.query_pixels(0, 60) = std::nan("");
  scene.candidate_pixels(1, 61) = std::numeric_limits<double>::infinity();
  EpipolarModel model;
  const Verification result =
      verify_epipolar(scene.query_pixels, scene.candidate_pixels, 640, 480, {}, &model);
  EXPECT_EQ(result.verdict, Verdict::kVerified);
  EXPECT_EQ(model.inliers[60], 0);
  EXPECT_EQ(model.inliers[61], 0);
  EXPECT_EQ(verify_epipolar(Matrix2Xd(2, 0), Matrix2Xd(2, 0), 640, 480).verdict,
            Verdict::kFewMatches);
}

TEST(VerifyEpipolar, SurvivesDegenerateMatches) {
  Matrix2Xd line(2, 40), same = Matrix2Xd::Constant(2, 40, 100.0);
  for (Eigen::Index i = 0; i < 40; ++i) line.col(i) << 10.0 * double(i), 5.0 * double(i);
  EXPECT_NO_THROW(verify_epipolar(line, line, 640, 480));
  EXPECT_EQ(verify_epipolar(same, same, 640, 480).verdict, Verdict::kFewMatches);
}

TEST(VerifyPose, FindsTheQuerysPoseAmongOutliers) {
  const Scene scene(40, 60);
  MotionModel model;
  const Verification result =
      verify_pose(scene.candidate_points, scene.query_pixels, camera(), {}, &model);
  EXPECT_EQ(result.verdict, Verdict::kVerified);
  EXPECT_GE(result.inliers, 38u);
  EXPECT_LE(result.inliers, 43u);
  expect_motion(result.T_candidate_query, scene.T_candidate_query, 0.02, 0.005);
  expect_motion(model.T_candidate_query, scene.T_candidate_query, 0.02, 0.005);
  EXPECT_EQ(result.scale, 1.0);
}

TEST(VerifyPose, IsExactWithoutNoise) {
  const Scene scene(30, 0, 0.0);
  const Verification result = verify_pose(scene.candidate_points, scene.query_pixels, camera());
  expect_motion(result.T_candidate_query, scene.T_candidate_query, 1e-9, 1e-9);
}

TEST(VerifyPose, FindsNothingInRandomMatches) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    const Scene scene(0, 100, 0.5, 1.0, seed);
    EXPECT_EQ(verify_pose(scene.candidate_points, scene.query_pixels, camera()).verdict,
              Verdict::kNoGeometry);
  }
}

TEST(VerifyPose, LeavesOutMatchesWithoutDepth) {
  Scene scene(40, 0);
  for (Eigen::Index i = 0; i < 35; ++i) scene.candidate_points.col(i).setConstant(std::nan(""));
  const Verification result = verify_pose(scene.candidate_points, scene.query_pixels, camera());
  EXPECT_EQ(result.verdict, Verdict::kFewMatches);
  EXPECT_EQ(result.matches, 5u);
}

TEST(VerifySimilarity, FindsRigidMotionsAndSimilarities) {
  for (const double scale : {1.0, 1.7, 0.6}) {
    const Scene scene(50, 50, 0.5, scale);
    const Verification result =
        verify_similarity(scene.matches(), camera(), camera(), scale != 1.0);
    EXPECT_EQ(result.verdict, Verdict::kVerified) << scale;
    EXPECT_GE(result.inliers, 45u);
    EXPECT_NEAR(result.scale, scale, 0.01);
    expect_motion(result.T_candidate_query, scene.T_candidate_query, 0.03, 0.005);
  }
}

TEST(VerifySimilarity, IsExactWithoutNoise) {
  const Scene scene(30, 0, 0.0, 1.3);
  const Verification result = verify_similarity(scene.matches(), camera(), camera(), true);
  EXPECT_NEAR(result.scale, 1.3, 1e-9);
  expect_motion(result.T_candidate_query, scene.T_candidate_query, 1e-9, 1e-9);
}

TEST(VerifySimilarity, FindsNothingInRandomMatches) {
  const Scene scene(0, 100);
  EXPECT_EQ(verify_similarity(scene.matches(), camera(), camera(), true).verdict,
            Verdict::kNoGeometry);
}

TEST(Verification, IsTheSameForTheSameSeed) {
  const Scene scene(30, 70);
  const Verification a = verify_pose(scene.candidate_points, scene.query_pixels, camera());
  const Verification b = verify_pose(scene.candidate_points, scene.query_pixels, camera());
  EXPECT_EQ(a.inliers, b.inliers);
  EXPECT_EQ(a.T_candidate_query.R, b.T_candidate_query.R);
  EXPECT_EQ(a.T_candidate_query.t, b.T_candidate_query.t);
}

TEST(Verification, RefusesWhatDoesNotFitTogether) {
  const Scene scene(20, 0);
  const Matrix2Xd less = scene.query_pixels.leftCols(19);
  PinholeCamera blind = camera();
  blind.fx = 0.0;
  RansacOptions seven;
  seven.min_inliers = 7;
  const auto& q = scene.query_pixels;
  EXPECT_THROW(verify_epipolar(less, q, 640, 480), InvalidArgument);
  EXPECT_THROW(verify_epipolar(q, q, 0, 480), InvalidArgument);
  EXPECT_THROW(verify_epipolar(q, q, 640, 0), InvalidArgument);
  EXPECT_THROW(verify_epipolar(q, q, 640, 480, seven), InvalidArgument);
  EXPECT_THROW(verify_pose(scene.candidate_points, less, camera()), InvalidArgument);
  EXPECT_THROW(verify_pose(scene.candidate_points, q, blind), InvalidArgument);
  const PointMatches m = scene.matches();
  EXPECT_THROW(verify_similarity(m, blind, camera(), false), InvalidArgument);
  EXPECT_THROW(verify_similarity(m, camera(), blind, false), InvalidArgument);
  const auto refuses = [&](const PointMatches& matches) {
    EXPECT_THROW(verify_similarity(matches, camera(), camera(), false), InvalidArgument);
  };
  const Matrix3Xd few = scene.query_points.leftCols(19);
  refuses({scene.query_points, less, scene.candidate_points, q});
  refuses({scene.query_points, q, few, q});
  refuses({scene.query_points, q, scene.candidate_points, less});
}

TEST(RansacOptions, RefusesEachMemberThatBreaksItsRule) {
  const auto refuses = [](auto&& change) {
    RansacOptions options;
    EXPECT_NO_THROW(options.validate());
    change(options);
    EXPECT_THROW(options.validate(), InvalidArgument);
  };
  refuses([](auto& o) { o.max_error = 0.0; });
  refuses([](auto& o) { o.max_error = std::nan(""); });
  refuses([](auto& o) { o.min_inliers = 3; });
  refuses([](auto& o) { o.min_significance = -1.0; });
  refuses([](auto& o) { o.max_iterations = 0; });
  refuses([](auto& o) { o.confidence = 1.0; });
}

// Descriptors of 32 bytes: row i of the query is row i of the train set with `i` bits turned.
struct Described {
  Described() {
    std::mt19937 random(5);
    for (std::size_t i = 0; i < 20; ++i) {
      for (std::size_t b = 0; b < 32; ++b) train[i][b] = static_cast<std::uint8_t>(random());
      query[i] = train[i];
      for (std::size_t bit = 0; bit < i; ++bit)
        query[i][bit] = static_cast<std::uint8_t>(query[i][bit] ^ 1U);
      nodes.push_back(static_cast<NodeId>(i % 3));
    }
    index.assign(nodes);
  }
  DescriptorsView query_view() const { return {query[0].data(), 32, 20}; }
  DescriptorsView train_view() const { return {train[0].data(), 32, 20}; }
  std::array<std::array<std::uint8_t, 32>, 20> query, train;
  std::vector<NodeId> nodes;
  FeatureVector index;
};

TEST(MatchByNodes, FindsTheNearestBelowTheSameNode) {
  const Described d;
  std::vector<Match> matches;
  match_by_nodes(d.index, d.query_view(), d.index, d.train_view(), {}, matches);
  ASSERT_EQ(matches.size(), 20u);
  for (std::size_t i = 0; i < 20; ++i) {
    EXPECT_EQ(matches[i].query, static_cast<int>(i));
    EXPECT_EQ(matches[i].train, static_cast<int>(i));
    EXPECT_EQ(matches[i].distance, static_cast<float>(i));
  }
}

TEST(MatchByNodes, KeepsToDistanceNodeRatioAndMutuality) {
  Described d;
  std::vector<Match> matches;
  NodeMatchOptions options;
  options.max_distance = 4.5 / 256.0;
  match_by_nodes(d.index, d.query_view(), d.index, d.train_view(), options, matches);
  EXPECT_EQ(matches.size(), 5u);
  std::vector<NodeId> other(20, 7);
  FeatureVector elsewhere;
  elsewhere.assign(other);
  match_by_nodes(d.index, d.query_view(), elsewhere, d.train_view(), {}, matches);
  EXPECT_TRUE(matches.empty());
  // Rows 0 and 3 of the train set lie below one node and are now alike.
  d.train[3] = d.train[0];
  match_by_nodes(d.index, d.query_view(), d.index, d.train_view(), {}, matches);
  EXPECT_EQ(matches.size(), 18u);  // neither 0, which has two equals, nor 3, whose own is gone
  options = {};
  options.ratio = 1.0;
  options.max_distance = 1.0;
  match_by_nodes(d.index, d.query_view(), d.index, d.train_view(), options, matches);
  for (const Match& match : matches) EXPECT_NE(match.train, 3);  // nobody's nearest is row 3
  options.mutual = false;
  match_by_nodes(d.index, d.query_view(), d.index, d.train_view(), options, matches);
  EXPECT_EQ(matches.size(), 20u);
}

TEST(MatchByNodes, RefusesRowsAndWidthsThatDoNotFit) {
  const Described d;
  std::vector<Match> matches(3);
  const DescriptorsView few(d.train[0].data(), 32, 19), narrow(d.train[0].data(), 16, 20, 32);
  EXPECT_THROW(match_by_nodes(d.index, few, d.index, d.train_view(), {}, matches), InvalidArgument);
  EXPECT_THROW(match_by_nodes(d.index, d.query_view(), d.index, few, {}, matches), InvalidArgument);
  EXPECT_THROW(match_by_nodes(d.index, d.query_view(), d.index, narrow, {}, matches),
               InvalidArgument);
  NodeMatchOptions options;
  options.ratio = 0.0;
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = {};
  options.max_distance = 1.5;
  EXPECT_THROW(match_by_nodes(d.index, d.query_view(), d.index, d.train_view(), options, matches),
               InvalidArgument);
  EXPECT_EQ(matches.size(), 3u);
}

// A wall at 3 m with, in the left half, something at 1 m.
struct Depth {
  explicit Depth(float wall, float thing = 0.0F) : pixels(640 * 480, wall) {
    for (std::size_t i = 0; thing > 0.0F && i < pixels.size(); ++i) {
      if (i % 640 < 320) pixels[i] = thing;
    }
  }
  ImageView<const float> view() const { return {pixels.data(), 640, 480}; }
  std::vector<float> pixels;
};

TEST(DepthCheck, ConfirmsTheSameSceneAndRefusesAnotherOne) {
  const RigidTransform T(Eigen::Matrix3d::Identity(), {0.0, 0.0, -0.5});
  Verification verification;
  verification.verdict = Verdict::kVerified;
  verification.T_candidate_query = T;
  check_depth(Depth(3.0F).view(), Depth(2.5F).view(), camera(), camera(), verification);
  EXPECT_EQ(verification.verdict, Verdict::kVerified);
  // The thing is where the motion puts it, the wall is not.
  const Depth query(3.0F, 1.5F), candidate(4.0F, 1.0F);
  EXPECT_LT(depth_agreement(query.view(), candidate.view(), camera(), camera(), T), 0.75);
  check_depth(query.view(), candidate.view(), camera(), camera(), verification);
  EXPECT_EQ(verification.verdict, Verdict::kOtherScene);
}

TEST(DepthCheck, DecidesNothingWhereNothingCanBeCompared) {
  const RigidTransform away(so3_exp({0.0, 3.1, 0.0}), Eigen::Vector3d::Zero());
  Verification verification;
  verification.verdict = Verdict::kVerified;
  verification.T_candidate_query = away;
  EXPECT_TRUE(std::isnan(
      depth_agreement(Depth(3.0F).view(), Depth(3.0F).view(), camera(), camera(), away)));
  check_depth(Depth(3.0F).view(), Depth(3.0F).view(), camera(), camera(), verification);
  EXPECT_EQ(verification.verdict, Verdict::kVerified);
  const Depth none(std::nanf(""));
  EXPECT_TRUE(std::isnan(depth_agreement(none.view(), none.view(), camera(), camera(), {})));
}

TEST(DepthCheck, RefusesOptionsAndImagesThatMeanNothing) {
  const auto refuses = [](auto&& change) {
    DepthCheckOptions options;
    EXPECT_NO_THROW(options.validate());
    change(options);
    EXPECT_THROW(options.validate(), InvalidArgument);
  };
  refuses([](auto& o) { o.min_agreement = 1.1; });
  refuses([](auto& o) { o.min_overlap = -0.1; });
  refuses([](auto& o) { o.grid = 0; });
  refuses([](auto& o) { o.absolute = -1.0; });
  refuses([](auto& o) { o.absolute = o.relative = 0.0; });
  const Depth wall(3.0F);
  const ImageView<const float> small(wall.pixels.data(), 320, 480);
  EXPECT_THROW(depth_agreement(small, wall.view(), camera(), camera(), {}), InvalidArgument);
  EXPECT_THROW(depth_agreement(wall.view(), {}, camera(), camera(), {}), InvalidArgument);
}

}  // namespace
}  // namespace dynslam::loop
