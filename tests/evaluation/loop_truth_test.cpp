#include "dynslam/evaluation/loop_truth.hpp"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/so3.hpp"

namespace dynslam::evaluation {
namespace {

PinholeCamera camera() {
  PinholeCamera result;
  result.fx = result.fy = 100.0;
  result.cx = 79.5;
  result.cy = 59.5;
  result.width = 160;
  result.height = 120;
  return result;
}

// A camera that looks at a wall 2 m away and walks along it; 1.6 m are one width of the view.
struct WalkAlongAWall {
  explicit WalkAlongAWall(const std::vector<double>& positions) : depth(160 * 120, 2.0F) {
    for (const double x : positions) {
      views.push_back({RigidTransform(Eigen::Matrix3d::Identity(), {1.6 * x * 2.0, 0.0, 0.0}),
                       {depth.data(), 160, 120}});
    }
  }
  std::vector<float> depth;
  std::vector<PlaceView> views;
};

LoopTruthOptions fine() {
  LoopTruthOptions options;
  options.grid = 4;
  return options;
}

TEST(LoopTruth, OverlapIsTheShareOfTheViewThatIsShared) {
  const WalkAlongAWall walk({0.0, 0.25, 0.5, 2.0});
  const LoopTruth truth(walk.views, camera(), fine());
  EXPECT_EQ(truth.size(), 4u);
  EXPECT_DOUBLE_EQ(truth.overlap(1, 1), 1.0);
  EXPECT_NEAR(truth.overlap(1, 0), 0.75, 0.03);
  EXPECT_NEAR(truth.overlap(0, 2), 0.5, 0.03);
  EXPECT_DOUBLE_EQ(truth.overlap(3, 0), 0.0);
}

TEST(LoopTruth, PlacesBehindSomethingAreNotSeen) {
  WalkAlongAWall walk({0.0, 0.0});
  const std::vector<float> near(160 * 120, 1.0F), holes(160 * 120, 0.0F);
  walk.views[1].depth = {near.data(), 160, 120};
  EXPECT_DOUBLE_EQ(LoopTruth(walk.views, camera(), fine()).overlap(1, 0), 0.0);
  walk.views[1].depth = {holes.data(), 160, 120};
  EXPECT_DOUBLE_EQ(LoopTruth(walk.views, camera(), fine()).overlap(1, 0), 0.0);
  walk.views[1].depth = {};
  EXPECT_DOUBLE_EQ(LoopTruth(walk.views, camera(), fine()).overlap(1, 0), 0.0);
}

TEST(LoopTruth, ALoopWantsThatTheCameraHasLookedElsewhere) {
  const WalkAlongAWall walk({0.0, 0.2, 0.4, 0.2, 2.5, 0.1, 0.7});
  const LoopTruth truth(walk.views, camera(), fine());
  EXPECT_EQ(truth.first_connected(3), 0u);  // it never lost sight
  EXPECT_EQ(truth.first_connected(4), 4u);
  EXPECT_EQ(truth.first_connected(5), 5u);
  EXPECT_EQ(truth.first_connected(6), 5u);
  const LoopScores scores = truth.score({});
  EXPECT_EQ(scores.queries, 7u);
  EXPECT_EQ(scores.loops_true, 2u);  // 5 and 6, which shares 0.7 of its view with 2
  EXPECT_EQ(scores.recall, 0.0);
}

TEST(LoopTruth, JudgesDetectionsByThreeKindsOfPairs) {
  const WalkAlongAWall walk({0.0, 0.2, 0.4, 0.2, 2.5, 0.1, 1.2});
  const LoopTruth truth(walk.views, camera(), fine());
  EXPECT_EQ(truth.score({}).loops_true, 1u);               // 5; 6 shares only 0.2 with 2
  const std::vector<LoopDetection> found = {{5, 2, 0.9},   // shares 0.7
                                            {6, 2, 0.8},   // nobody can say
                                            {3, 1, 0.7},   // the same place, but still in view
                                            {4, 0, 0.6}};  // another place
  const LoopScores scores = truth.score(found);
  EXPECT_EQ(scores.detected, 2u);
  EXPECT_EQ(scores.correct, 1u);
  EXPECT_DOUBLE_EQ(scores.recall, 1.0);
  EXPECT_DOUBLE_EQ(scores.precision, 0.5);
  EXPECT_DOUBLE_EQ(scores.recall_at_full_precision, 1.0);
}

TEST(LoopTruth, RefusesWhatItCannotJudge) {
  const WalkAlongAWall walk({0.0, 2.0});
  const LoopTruth truth(walk.views, camera());
  EXPECT_THROW(truth.overlap(2, 0), InvalidArgument);
  EXPECT_THROW(truth.overlap(0, 2), InvalidArgument);
  EXPECT_THROW(truth.first_connected(2), InvalidArgument);
  EXPECT_THROW(truth.score(std::vector<LoopDetection>{{5, 0, 1.0}}), InvalidArgument);
  EXPECT_THROW(truth.score(std::vector<LoopDetection>{{1, -1, 1.0}}), InvalidArgument);
  PinholeCamera small = camera();
  small.width = 100;
  EXPECT_THROW(LoopTruth(walk.views, small), InvalidArgument);
  small.fx = 0.0;
  EXPECT_THROW(LoopTruth(walk.views, small), InvalidArgument);
}

TEST(LoopTruthOptions, RefusesEachMemberThatBreaksItsRule) {
  const auto refuses = [](auto&& change) {
    LoopTruthOptions options;
    EXPECT_NO_THROW(options.validate());
    change(options);
    EXPECT_THROW(options.validate(), InvalidArgument);
  };
  refuses([](auto& o) { o.same = 0.0; });
  refuses([](auto& o) { o.same = 1.1; });
  refuses([](auto& o) { o.different = 0.0; });
  refuses([](auto& o) { o.different = 0.6; });
  refuses([](auto& o) { o.grid = 0; });
  refuses([](auto& o) { o.occlusion = 0.0; });
}

}  // namespace
}  // namespace dynslam::evaluation
