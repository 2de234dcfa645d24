// Monocular and stereo cameras, from matching to whole trajectories.
#include <algorithm>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/dataset/scene.hpp"
#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/slam/stereo_matcher.hpp"
#include "dynslam/slam/system.hpp"

namespace dynslam::slam {
namespace {

dataset::SceneOptions scene_options(dataset::CameraMotion motion, double stereo_baseline) {
  dataset::SceneOptions options;
  options.camera = dataset::scene_camera(320, 240);
  options.movers = false;
  options.motion = motion;
  options.stereo_baseline = stereo_baseline;
  return options;
}

const dataset::RenderedScene& stereo_scene() {
  static const dataset::RenderedScene scene(scene_options(dataset::CameraMotion::kHandHeld, 0.12));
  return scene;
}

SystemOptions system_options(Sensor sensor) {
  SystemOptions options;
  options.sensor = sensor;
  options.tracking.orb.max_features = 700;
  options.tracking.orb.levels = 4;
  return options;
}

FrameInput input_of(const dataset::Frame& frame) {
  return {frame.timestamp, frame.color, frame.depth, {}, frame.right};
}

struct Journey {
  Trajectory truth, estimate;
  std::vector<FrameResult> results;
  std::size_t first_tracked = 0;

  Journey(const dataset::RenderedScene& scene, Sensor sensor, int frames, int step) {
    System system(scene.camera(), system_options(sensor));
    for (int i = 0; i < frames; ++i) {
      const dataset::Frame frame = scene.render(static_cast<std::size_t>(i * step));
      truth.push_back({frame.timestamp, *frame.T_world_cam});
      results.push_back(system.track(input_of(frame)));
    }
    estimate = system.trajectory();
    const auto tracked = std::find_if(results.begin(), results.end(), [](const FrameResult& r) {
      return r.state == TrackingState::kTracked;
    });
    first_tracked = static_cast<std::size_t>(tracked - results.begin());
  }

  double ate(evaluation::Alignment alignment) const {
    evaluation::AteOptions options;
    options.alignment = alignment;
    return evaluation::ate(truth, estimate, options).error.rmse;
  }
};

TEST(StereoMatcher, GivesTheTrueDepthOfARenderedPair) {
  const dataset::RenderedScene& scene = stereo_scene();
  const dataset::Frame frame = scene.render(3);
  const cv::Mat truth = scene.exact_depth(3);
  cv::Mat left, right;
  cv::extractChannel(frame.color, left, 1);
  cv::extractChannel(frame.right, right, 1);
  features::OrbOptions orb;
  orb.max_features = 700;
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  features::OrbExtractor(orb).extract(as_view<const std::uint8_t>(left), {}, keypoints,
                                      descriptors);
  const DescriptorsView rows(descriptors.data, descriptors.cols, descriptors.rows);
  StereoMatcher matcher(scene.camera(), orb);
  std::vector<float> columns;
  matcher.match(as_view<const std::uint8_t>(left), as_view<const std::uint8_t>(right), keypoints,
                rows, columns);
  ASSERT_EQ(columns.size(), keypoints.size());
  std::vector<double> errors;  // of the column, pixels
  for (std::size_t i = 0; i < columns.size(); ++i) {
    if (std::isnan(columns[i])) continue;
    const cv::Point2f pixel = keypoints[i].pt;
    const float z = truth.at<float>(cvRound(pixel.y), cvRound(pixel.x));
    errors.push_back(std::abs(columns[i] - scene.camera().right_column(pixel.x, z)));
  }
  EXPECT_GT(errors.size(), keypoints.size() / 3);
  EXPECT_LT(evaluation::quantile(errors, 0.5), 0.25);
  EXPECT_LT(evaluation::quantile(errors, 0.9), 1.5);
}

TEST(StereoMatcher, FindsNothingInAnImageWithoutFeatures) {
  const DepthCamera camera = stereo_scene().camera();
  const cv::Mat flat(camera.height, camera.width, CV_8UC1, cv::Scalar(90));
  const GrayView view = as_view<const std::uint8_t>(flat);
  StereoMatcher matcher(camera, {});
  std::vector<float> columns;
  const std::vector<cv::KeyPoint> one = {cv::KeyPoint(100.0F, 100.0F, 31.0F, 0.0F)};
  const cv::Mat descriptor(1, 32, CV_8UC1, cv::Scalar(0));
  matcher.match(view, view, one, {descriptor.data, 32, 1}, columns);
  ASSERT_EQ(columns.size(), 1U);
  EXPECT_TRUE(std::isnan(columns[0]));
  matcher.match(view, view, {}, {}, columns);
  EXPECT_TRUE(columns.empty());
}

TEST(StereoMatcher, RefusesImagesOfAnotherSizeAndMissingDescriptors) {
  const DepthCamera camera = stereo_scene().camera();
  const cv::Mat fits(camera.height, camera.width, CV_8UC1, cv::Scalar(0));
  const cv::Mat small(10, 10, CV_8UC1, cv::Scalar(0));
  const GrayView good = as_view<const std::uint8_t>(fits), bad = as_view<const std::uint8_t>(small);
  StereoMatcher matcher(camera, {});
  std::vector<float> columns;
  EXPECT_THROW(matcher.match(bad, good, {}, {}, columns), InvalidArgument);
  EXPECT_THROW(matcher.match(good, bad, {}, {}, columns), InvalidArgument);
  const std::vector<cv::KeyPoint> one(1);
  EXPECT_THROW(matcher.match(good, good, one, {}, columns), InvalidArgument);
}

TEST(StereoOptions, NameTheMemberThatBreaksItsRule) {
  const auto refuses = [](auto change) {
    StereoOptions options;
    change(options);
    EXPECT_THROW(options.validate(), InvalidArgument);
  };
  refuses([](StereoOptions& o) { o.min_depth_baselines = 0.0; });
  refuses([](StereoOptions& o) { o.max_distance = -1; });
  refuses([](StereoOptions& o) { o.patch_radius = 0; });
  refuses([](StereoOptions& o) { o.search_radius = 21; });
  refuses([](StereoOptions& o) { o.max_difference_ratio = 0.0; });
}

TEST(StereoSystem, TracksARenderedPairToACentimetre) {
  const Journey run(stereo_scene(), Sensor::kStereo, 25, 2);
  for (const FrameResult& result : run.results) EXPECT_EQ(result.state, TrackingState::kTracked);
  EXPECT_EQ(run.estimate.size(), 25U);
  EXPECT_LT(run.ate(evaluation::Alignment::kSE3), 0.01);
}

TEST(StereoSystem, RefusesAFrameWithoutItsRightImage) {
  System system(stereo_scene().camera(), system_options(Sensor::kStereo));
  FrameInput input = input_of(stereo_scene().render(0));
  const cv::Mat right = input.right;
  input.right = cv::Mat();
  EXPECT_THROW(system.track(input), InvalidArgument);
  input.right = right(cv::Rect(0, 0, 100, 100)).clone();
  EXPECT_THROW(system.track(input), InvalidArgument);
  cv::extractChannel(right, input.right, 0);  // grey beside a colour image
  EXPECT_THROW(system.track(input), InvalidArgument);
  input.right = right;
  EXPECT_EQ(system.track(input).state, TrackingState::kTracked);
}

TEST(MonoSystem, FindsItsWayWithoutDepth) {
  const dataset::RenderedScene scene(scene_options(dataset::CameraMotion::kSideways, 0.0));
  const Journey run(scene, Sensor::kMono, 24, 6);
  ASSERT_LT(run.first_tracked, 15U);
  for (std::size_t i = 0; i < run.results.size(); ++i) {
    const FrameResult& result = run.results[i];
    EXPECT_EQ(result.T_world_cam.has_value(), i >= run.first_tracked) << i;
    EXPECT_EQ(result.state,
              i < run.first_tracked ? TrackingState::kNotInitialized : TrackingState::kTracked);
  }
  EXPECT_EQ(run.estimate.size(), run.results.size() - run.first_tracked);
  EXPECT_LT(run.ate(evaluation::Alignment::kSim3), 0.02);
}

TEST(MonoSystem, LeavesDepthAlone) {
  const dataset::RenderedScene scene(scene_options(dataset::CameraMotion::kSideways, 0.0));
  System with(scene.camera(), system_options(Sensor::kMono));
  System without(scene.camera(), system_options(Sensor::kMono));
  for (std::size_t i = 0; i < 30; i += 3) {
    FrameInput input = input_of(scene.render(i));
    const FrameResult a = with.track(input);
    input.depth = cv::Mat();
    const FrameResult b = without.track(input);
    EXPECT_EQ(a.inliers, b.inliers);
    EXPECT_EQ(a.state, b.state);
  }
}

TEST(MonoSystem, DoesNotStartWhileTheCameraOnlyTurns) {
  const dataset::RenderedScene scene(scene_options(dataset::CameraMotion::kPureRotation, 0.0));
  const Journey run(scene, Sensor::kMono, 25, 3);
  EXPECT_EQ(run.first_tracked, run.results.size());
  EXPECT_TRUE(run.estimate.empty());
}

TEST(MonoSystem, NeedsNoBaselineOfItsCamera) {
  DepthCamera camera = dataset::scene_camera(320, 240);
  camera.bf = 0.0;
  EXPECT_NO_THROW(System(camera, system_options(Sensor::kMono)));
  EXPECT_THROW(System(camera, system_options(Sensor::kStereo)), InvalidArgument);
  EXPECT_THROW(System(camera, system_options(Sensor::kRgbd)), InvalidArgument);
}

TEST(Sensor, HasTheNamesOfTheCommandLine) {
  EXPECT_STREQ(to_string(Sensor::kRgbd), "rgbd");
  EXPECT_STREQ(to_string(Sensor::kStereo), "stereo");
  EXPECT_STREQ(to_string(Sensor::kMono), "mono");
}

}  // namespace
}  // namespace dynslam::slam
