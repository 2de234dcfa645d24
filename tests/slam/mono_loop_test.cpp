// Loops of maps without depth, which drift in scale.
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/dataset/scene.hpp"
#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/slam/system.hpp"

#include "sanitized.hpp"
#include "slam/loop_closer.hpp"
#include "slam/loop_scale.hpp"
#include "synthetic_map.hpp"

namespace dynslam::slam {
namespace {

constexpr double kStep = 20.0;  // degrees between keyframes: 18 make a turn
constexpr std::size_t kTurn = 18;
constexpr double kRadius = 0.5;  // metres, of the circle that the camera walks
constexpr double kGrowth = 1.2;  // of the unit of length over a turn

RigidTransform true_pose(std::size_t keyframe) {
  return SyntheticMap::true_pose(kStep * static_cast<double>(keyframe), kRadius);
}

SystemOptions mono_options(bool bundle_adjustment) {
  SystemOptions options;
  options.sensor = Sensor::kMono;
  options.bundle_adjustment = bundle_adjustment;
  return options;
}

class MonoLoopTest : public ::testing::TestWithParam<bool> {
 protected:
  MonoLoopTest() {
    world.radius = kRadius;
    world.has_depth = false;
  }

  // Keyframes whose motions are right but for a unit that grows all the time.
  void walk(std::size_t first, std::size_t end) {
    for (std::size_t k = first; k < end; ++k) {
      RigidTransform T_cam_world = true_pose(k);
      if (k > 0) {
        const RigidTransform step = true_pose(k) * true_pose(k - 1).inverse();
        T_cam_world = RigidTransform(step.R, unit * step.t) *
                      world.shared.map.keyframe(ids.back()).T_cam_world;
      }
      const factors::Similarity S_cam_world(1.0 / unit, T_cam_world.R, T_cam_world.t / unit);
      ids.push_back(world.look(kStep * static_cast<double>(k), S_cam_world));
      world.shared.log.reference = ids.back();
      world.shared.log.add(
          world.shared.map, static_cast<double>(k),
          RigidTransform(Eigen::Matrix3d::Identity(), {unit, 0.0, 0.0}) * T_cam_world);
      closer.process(ids.back(), stop);
      unit *= std::pow(kGrowth, 1.0 / kTurn) * world.shared.log.take_scale();
    }
  }

  // By how much the steps of the last five keyframes are longer than those of the first, where all
  // are equally long in truth.
  double drift() const {
    const std::size_t n = ids.size();
    double first = 0.0, last = 0.0;
    for (std::size_t k = 0; k < 5; ++k) {
      first += (centre(k + 1) - centre(k)).norm();
      last += (centre(n - 1 - k) - centre(n - 2 - k)).norm();
    }
    return last / first;
  }
  static double true_step() { return (true_pose(1) * true_pose(0).inverse()).t.norm(); }
  Eigen::Vector3d centre(std::size_t k) const {
    return world.shared.map.keyframe(ids[k]).T_cam_world.inverse().t;
  }

  SyntheticMap world;
  std::atomic<bool> stop{false};
  LoopCloser closer{world.camera, mono_options(GetParam()), unit_scales(), {}, world.shared};
  std::vector<KeyframeId> ids;
  double unit = 1.0;  // length in the map of a metre here
};

TEST_P(MonoLoopTest, MendsADriftOfScale) {
  walk(0, 12);
  EXPECT_GT(drift(), 1.05);
  for (std::size_t k = 12; closer.closures().empty() && k < kTurn + 6; ++k) walk(k, k + 1);
  ASSERT_EQ(closer.closures().size(), 1U);
  const LoopClosure& loop = closer.closures().front();
  const std::size_t query = loop.query_frame / 10, match = loop.match_frame / 10;
  EXPECT_GE(query, match + kTurn - 2);
  EXPECT_NEAR(loop.scale, std::pow(kGrowth, static_cast<double>(query - match) / kTurn), 0.01);
  EXPECT_EQ(loop.shared, 0);
  const RigidTransform off = loop.T_query_match * true_pose(match) * true_pose(query).inverse();
  EXPECT_LT(se3_log(off).norm(), 0.02);
  EXPECT_NEAR(drift(), 1.0, 0.01);
}

TEST_P(MonoLoopTest, TakesFramesAndPointsAlongInTheNewUnit) {
  for (std::size_t k = 0; closer.closures().empty() && k < kTurn + 6; ++k) walk(k, k + 1);
  ASSERT_EQ(closer.closures().size(), 1U);
  const Map& map = world.shared.map;
  const Trajectory frames = world.shared.log.trajectory(map);
  for (std::size_t k = 1; k < ids.size(); ++k) {
    const double unit_here = (centre(k) - centre(k - 1)).norm() / true_step();
    EXPECT_NEAR((frames[k].T_world_cam.t - centre(k)).norm(), unit_here, 0.05) << k;
    const Keyframe& keyframe = map.keyframe(ids[k]);
    std::size_t points = 0, off = 0;
    for (std::size_t i = 0; i < keyframe.points.size(); ++i) {
      if (keyframe.points[i] == kNoId) continue;
      const MapPoint& point = map.point(keyframe.points[i]);
      const cv::Point2f at = keyframe.features->keypoints[i].pt;
      const Eigen::Vector2d pixel = world.camera.project(keyframe.T_cam_world * point.position);
      ++points;
      if ((pixel - Eigen::Vector2d(at.x, at.y)).norm() > 3.0) ++off;
    }
    EXPECT_GT(points, 100U);
    EXPECT_LT(off, points / 20) << k;
  }
}

TEST_P(MonoLoopTest, KnowsTheKeyframesThatNobodyLookedFrom) {
  walk(0, 1);
  const KeyframeId unseen = world.look(kStep, true_pose(1));  // as one of the pair of a start
  ids.push_back(unseen);
  walk(2, 14);
  const auto alike = closer.database().similar(*world.shared.map.keyframe(unseen).features, 3);
  EXPECT_EQ(std::count(alike.begin(), alike.end(), unseen), 1);
}

TEST_P(MonoLoopTest, FindsNoLoopWhereOtherThingsAre) {
  walk(0, 14);
  world.add_wall(1800);
  world.forget_points();
  walk(14, 28);
  EXPECT_TRUE(closer.closures().empty());
}

TEST_P(MonoLoopTest, RefusesAPictureOfThePlace) {
  walk(0, 14);
  // From where the camera passes again everything is in its direction, at another distance.
  const Eigen::Vector3d middle = true_pose(kTurn).inverse().t;
  double factor = 0.6;
  for (WallPoint& point : world.wall) {
    point.position = middle + factor * (point.position - middle);
    factor = factor > 2.0 ? 0.6 : 1.4 * factor;
  }
  world.forget_points();
  walk(14, kTurn + 3);
  EXPECT_TRUE(closer.closures().empty());
}

INSTANTIATE_TEST_SUITE_P(WithAndWithout, MonoLoopTest, ::testing::Bool());

TEST(AgreedScale, IsTheFactorOfTheMost) {
  std::vector<double> ratios(30, std::log(0.8));
  for (std::size_t i = 0; i < ratios.size(); ++i) {
    ratios[i] += 0.01 * (static_cast<double>(i % 5) - 2.0);
  }
  ratios.insert(ratios.end(), 10, 1.0);  // wrong ones
  const std::optional<double> scale = agreed_scale(ratios);
  ASSERT_TRUE(scale.has_value());
  EXPECT_NEAR(*scale, 0.8, 0.01);
}

TEST(AgreedScale, IsNotKnownFromFewPointsOrFromPointsThatScatter) {
  EXPECT_FALSE(agreed_scale({}).has_value());
  EXPECT_FALSE(agreed_scale(std::vector<double>(19, 0.0)).has_value());
  EXPECT_TRUE(agreed_scale(std::vector<double>(20, 0.0)).has_value());
  std::vector<double> scattered;
  for (int i = 0; i < 60; ++i) scattered.push_back(0.02 * (i - 30));
  EXPECT_FALSE(agreed_scale(scattered).has_value());
}

// Frames of a rendered room without movers, and what one camera makes of them.
class MonoTour {
 public:
  MonoTour(const dataset::SceneOptions& options, std::size_t first, std::size_t end)
      : camera_(options.camera) {
    const dataset::RenderedScene scene(options);
    for (std::size_t i = first; i < end; ++i) {
      frames_.push_back(scene.render(i));
      truth_.push_back({frames_.back().timestamp, *frames_.back().T_world_cam});
    }
  }
  System track(Threading threading, int features, bool loops = true) const {
    SystemOptions options;
    options.sensor = Sensor::kMono;
    options.tracking.orb.max_features = features;
    options.threading = threading;
    options.loops.enabled = loops;
    System system(camera_, options);
    for (const dataset::Frame& frame : frames_) {
      system.track({frame.timestamp, frame.color, {}, {}});
    }
    system.finish();
    return system;
  }
  RigidTransform T_query_match(const LoopClosure& loop) const {
    return truth_[loop.query_frame].T_world_cam.inverse() * truth_[loop.match_frame].T_world_cam;
  }
  double ate(const System& system) const {
    evaluation::AteOptions options;
    options.alignment = evaluation::Alignment::kSim3;
    return evaluation::ate(truth_, system.trajectory(), options).error.rmse;
  }

 private:
  DepthCamera camera_;
  std::vector<dataset::Frame> frames_;
  Trajectory truth_;
};

dataset::SceneOptions still_room(const DepthCamera& camera, double camera_speed) {
  dataset::SceneOptions options;
  options.camera = camera;
  options.movers = false;
  options.camera_speed = camera_speed;
  options.exposure_time = 0.004;
  return options;
}

// A narrow view that wanders leaves places and comes back to them.
const MonoTour& wanderer() {
  static const MonoTour tour = [] {
    DepthCamera camera = dataset::scene_camera(320, 240);
    camera.fx = camera.fy = 500.0;
    return MonoTour(still_room(camera, 4.0), 0, 190);
  }();
  return tour;
}

// One that goes round sees the first wall again at the end, and nothing of it on the way.
MonoTour full_turn() {
  dataset::SceneOptions options = still_room(dataset::scene_camera(480, 360), 2.0);
  options.motion = dataset::CameraMotion::kRound;
  return {options, 45, 345};
}

// Which places one camera finds again hangs on every feature: several numbers of them are tried.
TEST(MonoSystem, ClosesLoopsInARenderedRoom) {
  std::size_t closed = 0;
  double best = std::numeric_limits<double>::infinity();
  for (const int features : {800, 900}) {
    const System system = wanderer().track(Threading::kSequential, features);
    for (const LoopClosure& loop : system.loops()) {
      const Eigen::Matrix3d R_query_match = wanderer().T_query_match(loop).R;
      EXPECT_LT(so3_log(R_query_match * loop.T_query_match.R.transpose()).norm(), 0.03) << features;
    }
    closed += system.loops().size();
    best = std::min(best, wanderer().ate(system));
  }
  EXPECT_GE(closed, 1U);
  EXPECT_LT(best, 0.03);
}

// Of such a return tracking knows nothing: the loop alone takes out what has drifted.
TEST(MonoSystem, LosesItsDriftWhenItHasGoneRoundARenderedRoom) {
  if (testing::kSanitized) GTEST_SKIP() << "a minute for what the other tours run through as well";
  const MonoTour tour = full_turn();
  bool closed = false;
  for (const int features : {1100, 1200, 1000, 1150}) {
    if (closed) break;  // the other numbers are for where the first finds no loop
    const System with = tour.track(Threading::kSequential, features);
    closed = !with.loops().empty();
    if (!closed) continue;
    EXPECT_EQ(with.loops().front().shared, 0);
    EXPECT_GT(with.loops().front().query_frame, with.loops().front().match_frame + 250);
    const System without = tour.track(Threading::kSequential, features, false);
    EXPECT_LT(tour.ate(with), 0.9 * tour.ate(without)) << features;
  }
  EXPECT_TRUE(closed);
}

TEST(MonoSystem, StartsRightWhereTheViewIsNearlyFlat) {
  const MonoTour& tour = wanderer();
  bool started = false;
  // With 650 features a random sample leads the first step 61 degrees astray.
  for (const int features : {650, 750, 800}) {
    if (started) break;
    const System system = tour.track(Threading::kSequential, features);
    if (system.trajectory().empty()) continue;  // a start that is refused is not wrong
    started = true;
    EXPECT_LT(tour.ate(system), 0.05) << features;
  }
  EXPECT_TRUE(started);
}

TEST(MonoSystem, IsAsGoodWithLoopsClosedBeside) {
  const System system = wanderer().track(Threading::kBackground, 800);
  for (const LoopClosure& loop : system.loops()) {
    EXPECT_LT(std::abs(std::log(loop.scale)), 0.1);
    EXPECT_GE(loop.inliers, LoopOptions().min_inliers);
  }
  EXPECT_LT(wanderer().ate(system), 0.03);
}

}  // namespace
}  // namespace dynslam::slam
