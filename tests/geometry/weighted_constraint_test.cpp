#include "dynslam/geometry/weighted_constraint.hpp"

#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "geometry/synthetic.hpp"

namespace dynslam::geometry {
namespace {

using synthetic::kCamera;
using synthetic::kNaN;

struct Pixel {
  float x, y;
};

/// Exact sightings of points in a reference and now.
struct Scene {
  RigidTransform T_cur_ref;
  std::vector<Pixel> then, now;
  std::vector<float> z_then, z_now;
  std::vector<Match> matches;

  explicit Scene(const Eigen::Vector3d& t, const Eigen::Vector3d& omega = Eigen::Vector3d::Zero())
      : T_cur_ref(so3_exp(omega), t) {}

  /// A point at X in the reference that has moved by `motion` (reference camera) since.
  void add(const Eigen::Vector3d& X, const Eigen::Vector3d& motion = Eigen::Vector3d::Zero()) {
    const Eigen::Vector3d Y = T_cur_ref * Eigen::Vector3d(X + motion);
    const Eigen::Vector2f p = kCamera.project(X).cast<float>(),
                          q = kCamera.project(Y).cast<float>();
    const int i = static_cast<int>(now.size());
    then.push_back({p.x(), p.y()});
    now.push_back({q.x(), q.y()});
    z_then.push_back(static_cast<float>(X.z()));
    z_now.push_back(static_cast<float>(Y.z()));
    matches.push_back({i, i, 0.0F});
  }
  void add_grid() {
    for (int y = -2; y <= 2; ++y) {
      for (int x = -3; x <= 3; ++x) add({0.3 * x, 0.25 * y, 2.0 + 0.2 * ((x + y) & 3)});
    }
  }
  FeaturesView current(bool depth = true) const { return features(now, z_now, depth); }
  ReferenceView reference(bool depth = true) const {
    ReferenceView view;
    view.T_cur_ref = T_cur_ref;
    view.features = features(then, z_then, depth);
    view.matches = matches;
    return view;
  }
  std::vector<FeatureVerdict> judge(const WeightedConstraintOptions& options = {},
                                    bool depth = true) const {
    const ReferenceView view = reference(depth);
    return judge_with(Span<const ReferenceView>(&view, 1), options, depth);
  }
  std::vector<FeatureVerdict> judge_with(Span<const ReferenceView> references,
                                         const WeightedConstraintOptions& options = {},
                                         bool depth = true) const {
    std::vector<FeatureVerdict> out(now.size());
    WeightedConstraintWorkspace workspace;
    judge_features(kCamera, current(depth), references, options, workspace, out);
    return out;
  }

 private:
  static FeaturesView features(const std::vector<Pixel>& pixels, const std::vector<float>& depths,
                               bool with_depth) {
    FeaturesView view;
    view.pixels = pixels;
    if (with_depth) view.depths = depths;
    return view;
  }
};

TEST(WeightedConstraint, CallsAStaticSceneStaticUnderAnyMotion) {
  const Eigen::Vector3d t[] = {{0.2, 0, 0}, {0, 0, 0.2}, {0.1, -0.1, 0.1}, {0, 0, 0}};
  const Eigen::Vector3d omega[] = {{0, 0, 0}, {0, 0.1, 0}, {0.05, -0.1, 0.2}};
  for (const auto& a : t) {
    for (const auto& b : omega) {
      Scene scene(a, b);
      scene.add_grid();
      for (const FeatureVerdict& v : scene.judge()) {
        EXPECT_EQ(v.verdict, Verdict::kStatic) << to_string(v.reason);
        EXPECT_LT(v.log_odds, 0.0F);
        EXPECT_GT(v.staticness(), 0.5F);
        EXPECT_LT(v.delta, 1e-5F);
      }
    }
  }
}

TEST(WeightedConstraint, CatchesAPointThatLeavesItsEpipolarPlane) {
  Scene scene({0.2, 0, 0});
  scene.add({0.1, 0.1, 2.0}, {0, 0.1, 0});
  const FeatureVerdict v = scene.judge()[0];
  EXPECT_EQ(v.verdict, Verdict::kDynamic);
  EXPECT_EQ(v.reason, Reason::kEpipolarViolated);
  // |c| by hand: the angle out of the plane spanned by the x axis and the ray (0.05, 0.05, 1).
  const Eigen::Vector3d n =
      Eigen::Vector3d::UnitX().cross(Eigen::Vector3d(0.05, 0.05, 1)).normalized();
  const double c = std::abs(n.dot(Eigen::Vector3d(0.15, 0.1, 1).normalized()));
  EXPECT_NEAR(v.delta, c, 1e-6);
}

TEST(WeightedConstraint, CatchesMotionAlongTheEpipolarLineByDepthAlone) {
  // The camera moves along its axis, so the point can come nearer on its own ray and stay in plane.
  Scene scene({0, 0, -0.2});
  const Eigen::Vector3d X(0.4, 0.2, 2.0);
  scene.add(X, -0.2 * X);
  const FeatureVerdict v = scene.judge()[0];
  EXPECT_EQ(v.verdict, Verdict::kDynamic);
  EXPECT_EQ(v.reason, Reason::kDepthViolated);
  EXPECT_NEAR(v.delta, 0.4, 1e-5);
  WeightedConstraintOptions without;
  without.use_depth = without.use_transfer = false;
  EXPECT_EQ(scene.judge(without)[0].verdict, Verdict::kStatic);
}

TEST(WeightedConstraint, CatchesMotionParallelToTheBaselineByTransferAlone) {
  Scene scene({0.2, 0, 0});
  scene.add({0.1, 0.1, 2.0}, {0.15, 0, 0});
  EXPECT_EQ(scene.judge()[0].reason, Reason::kTransferViolated);
  EXPECT_EQ(scene.judge()[0].verdict, Verdict::kDynamic);
  WeightedConstraintOptions paper;
  paper.use_transfer = false;
  EXPECT_EQ(scene.judge(paper)[0].verdict, Verdict::kStatic);
}

TEST(WeightedConstraint, GivesNoEpipolarVoteInPureRotation) {
  Scene scene({0, 0, 0}, {0.02, 0.1, 0});
  scene.add({0.1, 0.1, 2.0});
  scene.add({0.1, 0.1, 2.0}, {0, 0.2, 0});
  WeightedConstraintOptions epipolar;
  epipolar.use_depth = epipolar.use_transfer = false;
  for (const FeatureVerdict& v : scene.judge(epipolar)) {
    EXPECT_EQ(v.verdict, Verdict::kUnknown);
    EXPECT_EQ(v.reason, Reason::kNoBaseline);
  }
  // Depth tells where the point should be even then.
  const auto all = scene.judge();
  EXPECT_EQ(all[0].verdict, Verdict::kStatic);
  EXPECT_EQ(all[1].reason, Reason::kTransferViolated);
}

TEST(WeightedConstraint, WorksWithoutDepth) {
  Scene scene({0.2, 0, 0});
  scene.add({0.1, 0.1, 2.0});
  scene.add({0.1, 0.1, 2.0}, {0, 0.1, 0});
  const auto v = scene.judge({}, false);
  EXPECT_EQ(v[0].verdict, Verdict::kStatic);
  EXPECT_EQ(v[1].verdict, Verdict::kDynamic);
}

TEST(WeightedConstraint, CatchesFastMotionOfARotatingCameraWithoutDepth) {
  Scene scene({0, 0, 0}, {0, 0.1, 0});
  scene.add({0.1, 0.1, 2.0});
  scene.add({0.1, 0.1, 2.0}, {0.4, 0.2, 0});
  const auto v = scene.judge({}, false);
  EXPECT_EQ(v[0].verdict, Verdict::kUnknown);
  EXPECT_EQ(v[0].reason, Reason::kNoBaseline);
  EXPECT_EQ(v[1].reason, Reason::kTransferViolated);
}

TEST(WeightedConstraint, AllowsForTheNoiseOfCoarsePyramidLevels) {
  Scene scene({0.2, 0, 0});
  scene.add({0.1, 0.1, 2.0});
  scene.now[0].y += 12.0F;
  EXPECT_EQ(scene.judge()[0].verdict, Verdict::kDynamic);
  const std::vector<float> scales{3.0F};
  FeaturesView current = scene.current();
  current.scales = scales;
  const ReferenceView reference = scene.reference();
  std::vector<FeatureVerdict> out(1);
  WeightedConstraintWorkspace workspace;
  judge_features(kCamera, current, Span<const ReferenceView>(&reference, 1), {}, workspace, out);
  EXPECT_NE(out[0].verdict, Verdict::kDynamic);
}

TEST(WeightedConstraint, AllowsMoreDepthErrorFarAway) {
  Scene scene({0.2, 0, 0});
  scene.add({0.1, 0.1, 1.0});
  scene.add({0.1, 0.1, 5.0});
  for (float& z : scene.z_now) z += 0.12F;
  const auto v = scene.judge();
  EXPECT_EQ(v[0].reason, Reason::kDepthViolated);
  EXPECT_EQ(v[1].verdict, Verdict::kStatic);
}

TEST(WeightedConstraint, DoesNotJudgeDepthAtAnEdge) {
  Scene scene({0.0, 0, 0});
  scene.add({0.1, 0.1, 2.0});
  scene.z_now[0] = 3.0F;
  ASSERT_EQ(scene.judge()[0].verdict, Verdict::kDynamic);
  const std::vector<float> spread{std::numeric_limits<float>::infinity()};
  FeaturesView current = scene.current();
  current.spreads = spread;
  const ReferenceView reference = scene.reference();
  std::vector<FeatureVerdict> out(1);
  WeightedConstraintWorkspace workspace;
  judge_features(kCamera, current, Span<const ReferenceView>(&reference, 1), {}, workspace, out);
  EXPECT_EQ(out[0].verdict, Verdict::kUnknown);
  EXPECT_EQ(out[0].reason, Reason::kDepthEdge);
}

/// Depth cells of a wall at `depth`.
DepthCells wall(float depth) {
  std::vector<float> image(640 * 480, depth);
  DepthCells cells;
  build_depth_cells({image.data(), 640, 480}, kCamera, {}, cells);
  return cells;
}

TEST(WeightedConstraint, AsksTheReferenceWhetherSomethingStoodThereBefore) {
  // The match says 3 m, now 2 m is measured.
  Scene scene({0.0, 0, 0});
  scene.add({0.1, 0.1, 3.0});
  scene.z_now[0] = 2.0F;
  ReferenceView reference = scene.reference();
  const Span<const ReferenceView> references(&reference, 1);
  const DepthCells free = wall(3.0F), same = wall(2.0F), hidden = wall(1.0F);
  reference.cells = &free;
  EXPECT_EQ(scene.judge_with(references)[0].reason, Reason::kFreeSpaceViolated);
  reference.cells = &same;  // what is in front now was there before: an occluder
  EXPECT_EQ(scene.judge_with(references)[0].reason, Reason::kOccluded);
  EXPECT_EQ(scene.judge_with(references)[0].verdict, Verdict::kUnknown);
  reference.cells = &hidden;
  EXPECT_EQ(scene.judge_with(references)[0].reason, Reason::kOccluded);
}

TEST(WeightedConstraint, CombinesReferencesAsAsked) {
  Scene scene({0.2, 0, 0});
  scene.add({0.1, 0.1, 2.0});
  Scene moved({0.2, 0, 0});
  moved.add({0.1, 0.02, 2.0});  // seen elsewhere then: says dynamic now
  const std::vector<ReferenceView> one_of_three{scene.reference(), scene.reference(),
                                                moved.reference()};
  const auto verdict = [&](Combination combination) {
    WeightedConstraintOptions options;
    options.combination = combination;
    return scene.judge_with(one_of_three, options)[0];
  };
  EXPECT_EQ(verdict(Combination::kAny).verdict, Verdict::kDynamic);
  EXPECT_EQ(verdict(Combination::kMajority).verdict, Verdict::kStatic);
  EXPECT_EQ(verdict(Combination::kNull).verdict, Verdict::kUnknown);
  EXPECT_EQ(verdict(Combination::kAny).dynamic_votes, 1);
  EXPECT_EQ(verdict(Combination::kAny).static_votes, 2);
  const std::vector<ReferenceView> tie{scene.reference(), moved.reference()};
  WeightedConstraintOptions majority;
  majority.combination = Combination::kMajority;
  EXPECT_EQ(scene.judge_with(tie, majority)[0].verdict, Verdict::kUnknown);
  EXPECT_EQ(scene.judge_with(tie, majority)[0].reason, Reason::kUndecided);
  WeightedConstraintOptions mean;
  mean.combination = Combination::kMean;
  EXPECT_EQ(scene.judge_with(tie, mean)[0].verdict, Verdict::kDynamic);
  const std::vector<ReferenceView> agree{scene.reference(), scene.reference()};
  EXPECT_LT(scene.judge_with(agree)[0].log_odds, scene.judge()[0].log_odds);
}

TEST(WeightedConstraint, KnowsNothingWithoutReferencesMatchesOrFeatures) {
  Scene scene({0.2, 0, 0});
  EXPECT_TRUE(scene.judge().empty());
  scene.add({0.1, 0.1, 2.0});
  EXPECT_EQ(scene.judge_with({})[0].reason, Reason::kNoReference);
  scene.matches.clear();
  EXPECT_EQ(scene.judge()[0].verdict, Verdict::kUnknown);
  EXPECT_EQ(scene.judge()[0].reason, Reason::kNoReference);
}

TEST(WeightedConstraint, CallsNaNUnknown) {
  Scene scene({0.2, 0, 0});
  scene.add({0.1, 0.1, 2.0});
  scene.add({0.1, 0.1, 2.0});
  scene.add({0.1, 0.1, 2.0});
  scene.now[0].x = kNaN;
  scene.then[1].y = kNaN;
  scene.z_now[2] = kNaN;  // as without depth
  const auto v = scene.judge();
  EXPECT_EQ(v[0].reason, Reason::kNotFinite);
  EXPECT_EQ(v[1].reason, Reason::kNotFinite);
  EXPECT_EQ(v[2].verdict, Verdict::kStatic);
  scene.T_cur_ref.t.x() = kNaN;
  EXPECT_EQ(scene.judge()[2].reason, Reason::kNotFinite);
}

TEST(WeightedConstraint, RefusesArraysThatDoNotFit) {
  Scene scene({0.2, 0, 0});
  scene.add_grid();
  const ReferenceView good = scene.reference();
  WeightedConstraintWorkspace workspace;
  std::vector<FeatureVerdict> out(scene.now.size());
  const auto judge = [&](const FeaturesView& current, const ReferenceView& reference,
                         Span<FeatureVerdict> into) {
    judge_features(kCamera, current, Span<const ReferenceView>(&reference, 1), {}, workspace, into);
  };
  EXPECT_THROW(judge(scene.current(), good, Span(out).subspan(0, 3)), InvalidArgument);
  const std::vector<float> two{1.0F, 1.0F};
  for (const auto member : {&FeaturesView::depths, &FeaturesView::scales, &FeaturesView::spreads}) {
    FeaturesView current = scene.current();
    current.*member = two;
    EXPECT_THROW(judge(current, good, out), InvalidArgument);
    ReferenceView reference = good;
    reference.features.*member = two;
    EXPECT_THROW(judge(scene.current(), reference, out), InvalidArgument);
  }
  for (const Match bad : {Match{-1, 0, 0}, Match{1000, 0, 0}, Match{0, -1, 0}, Match{0, 1000, 0}}) {
    ReferenceView reference = good;
    reference.matches = Span<const Match>(&bad, 1);
    EXPECT_THROW(judge(scene.current(), reference, out), InvalidArgument);
  }
}

TEST(WeightedConstraint, RefusesEachInvalidOption) {
  using O = WeightedConstraintOptions;
  EXPECT_NO_THROW(O().validate());
  for (double O::*member : {&O::threshold, &O::pixel_sigma, &O::min_scene_depth,
                            &O::dynamic_evidence, &O::static_evidence}) {
    O options;
    options.*member = 0.0;
    EXPECT_THROW(options.validate(), InvalidArgument);
  }
  for (double O::*member : {&O::min_baseline, &O::min_parallax, &O::depth_floor, &O::decision}) {
    O options;
    options.*member = -1.0;
    EXPECT_THROW(options.validate(), InvalidArgument);
    options.*member = kNaN;
    EXPECT_THROW(options.validate(), InvalidArgument);
  }
  O options;
  options.combination = static_cast<Combination>(17);
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = O();
  options.depth_noise.a = -1.0;
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = O();
  options.pose_noise.rotation = -1.0;
  EXPECT_THROW(options.validate(), InvalidArgument);
}

TEST(Noise, RefusesEachInvalidMember) {
  EXPECT_THROW((DepthNoise{-1.0, 0.1, 0.0}.validate()), InvalidArgument);
  EXPECT_THROW((DepthNoise{0.1, -1.0, 0.0}.validate()), InvalidArgument);
  EXPECT_THROW((DepthNoise{0.1, 0.1, kNaN}.validate()), InvalidArgument);
  EXPECT_THROW((DepthNoise{0.0, 0.0, 0.0}.validate()), InvalidArgument);
  EXPECT_THROW((PoseNoise{-1.0, 0.0}.validate()), InvalidArgument);
  EXPECT_THROW((PoseNoise{0.0, kNaN}.validate()), InvalidArgument);
}

TEST(MeasureDepths, GivesDepthAndSpreadAndFindsEdges) {
  std::vector<float> image(20 * 10, 2.0F);
  const ImageView<float> view(image.data(), 20, 10);
  for (int y = 0; y < 10; ++y) view(10, y) = 2.5F;
  view(15, 5) = 0.0F;
  const std::vector<Pixel> pixels{{4, 5}, {9, 5}, {15.2F, 4.9F}, {-3, 2}, {kNaN, 1}, {19, 9}};
  std::vector<float> depths(6), spreads(6);
  measure_depths(view, pixels, 1, depths, spreads);
  EXPECT_EQ(depths, (std::vector<float>{2, 2, 0, 0, 0, 2}));
  EXPECT_EQ(spreads[0], 0.0F);
  EXPECT_EQ(spreads[1], 0.5F);
  EXPECT_EQ(spreads[2], 0.0F);  // one hole of nine pixels is no edge
  EXPECT_TRUE(std::isinf(spreads[3]) && std::isinf(spreads[4]));
  for (int y = 4; y < 7; ++y) view(4, y) = 0.0F;
  measure_depths(view, pixels, 1, depths, spreads);
  EXPECT_TRUE(std::isinf(spreads[0]));
  measure_depths(view, pixels, 1, depths, {});
  EXPECT_THROW(measure_depths({}, pixels, 1, depths, spreads), InvalidArgument);
  EXPECT_THROW(measure_depths(view, pixels, -1, depths, spreads), InvalidArgument);
  EXPECT_THROW(measure_depths(view, pixels, 1, Span(depths).subspan(0, 2), spreads),
               InvalidArgument);
  EXPECT_THROW(measure_depths(view, pixels, 1, depths, Span(spreads).subspan(0, 2)),
               InvalidArgument);
}

TEST(CoordinateSpan, BindsForeignPointsWithoutACopy) {
  struct Keypoint {
    float response;
    Pixel pt;
  };
  std::vector<Keypoint> keypoints{{1, {2, 3}}, {4, {5, 6}}};
  const Pixels pixels = field(keypoints, &Keypoint::pt);
  EXPECT_EQ(pixels.data(), &keypoints[0].pt.x);
  EXPECT_EQ(pixels[1], Eigen::Vector2f(5, 6));
  const std::vector<Eigen::Vector3d> world{{1, 2, 3}};
  EXPECT_EQ(Points(world).data(), world[0].data());
}

TEST(Reason, HasAName) {
  EXPECT_STREQ(to_string(Reason::kFreeSpaceViolated), "free space violated");
  EXPECT_STREQ(to_string(Reason::kNoReference), "no reference");
  EXPECT_STREQ(to_string(Verdict::kDynamic), "dynamic");
}

}  // namespace
}  // namespace dynslam::geometry
