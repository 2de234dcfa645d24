#include "slam/wide_alignment.hpp"

#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/so3.hpp"
#include "dynslam/dataset/scene.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kWide = 45;  // frames at 30 Hz: a second and a half

DepthCamera camera() { return dataset::scene_camera(320, 240); }

dataset::Frame room(std::size_t index) {
  dataset::SceneOptions options;
  options.camera = camera();
  options.frames = index + 1;
  return dataset::make_scene("room_still", options)->read(index);
}

SurfaceGrid grid_of(const cv::Mat& depth, const cv::Mat& color = {}) {
  cv::Mat gray, cells;
  if (!color.empty()) {
    cv::cvtColor(color, gray, cv::COLOR_BGR2GRAY);
    cv::resize(gray, cells, gray.size() / kSurfaceCell, 0, 0, cv::INTER_AREA);
  }
  SurfaceGrid grid;
  build_surface_grid(depth, cells, camera(), grid);
  return grid;
}

SurfaceGrid grid_of(const dataset::Frame& frame) { return grid_of(frame.depth, frame.color); }

// A wall that fills the image, slanted so that it has a distance at every pixel.
cv::Mat wall() {
  cv::Mat depth(240, 320, CV_32FC1);
  for (int y = 0; y < depth.rows; ++y) {
    for (int x = 0; x < depth.cols; ++x) {
      const Eigen::Vector3d ray = camera().unproject({x, y}, 1.0);
      depth.at<float>(y, x) = static_cast<float>(2.0 / (1.0 + 0.2 * ray.x() + 0.1 * ray.y()));
    }
  }
  return depth;
}

TEST(WideAlignment, FindsStepsOfMoreThanASecond) {
  std::vector<dataset::Frame> frames;
  for (std::size_t i = 0; i < 4; ++i) frames.push_back(room(i * kWide));
  for (std::size_t i = 1; i < frames.size(); ++i) {
    const RigidTransform truth = frames[i - 1].T_world_cam->inverse() * *frames[i].T_world_cam;
    const auto found = align_wide(grid_of(frames[i - 1]), grid_of(frames[i]), camera(), {});
    ASSERT_TRUE(found.has_value()) << "step " << i;
    const RigidTransform error = truth.inverse() * found->alignment.T_from_to;
    EXPECT_LT(error.t.norm(), 0.04) << "of " << truth.t.norm() << " m";
    EXPECT_LT(so3_log(error.R).norm(), 0.03) << "of " << so3_log(truth.R).norm();
  }
}

TEST(WideAlignment, GivesTheSameBitsTwice) {
  const SurfaceGrid from = grid_of(room(0)), to = grid_of(room(kWide));
  const auto a = align_wide(from, to, camera(), {});
  const auto b = align_wide(from, to, camera(), {});
  ASSERT_TRUE(a.has_value() && b.has_value());
  EXPECT_EQ(a->alignment.T_from_to.t, b->alignment.T_from_to.t);
  EXPECT_EQ(a->alignment.T_from_to.R, b->alignment.T_from_to.R);
}

TEST(WideAlignment, BelievesNoMotionAlongAWall) {
  const SurfaceGrid grid = grid_of(wall());
  EXPECT_FALSE(align_wide(grid, grid, camera(), {}).has_value());
}

TEST(WideAlignment, BelievesNoMotionBetweenDifferentPlaces) {
  EXPECT_FALSE(align_wide(grid_of(room(0)), grid_of(wall()), camera(), {}).has_value());
}

TEST(WideAlignment, FindsNothingWithoutDepth) {
  const SurfaceGrid seen = grid_of(room(0)), nothing = grid_of(cv::Mat::zeros(240, 320, CV_32FC1));
  EXPECT_FALSE(align_wide(seen, nothing, camera(), {}).has_value());
  EXPECT_FALSE(align_wide(nothing, seen, camera(), {}).has_value());
  EXPECT_FALSE(align_wide(SurfaceGrid(), seen, camera(), {}).has_value());
}

TEST(SurfaceFit, IsBestAtTheTrueMotion) {
  const dataset::Frame a = room(0), b = room(kWide);
  const SurfaceGrid from = grid_of(a), to = grid_of(b);
  const RigidTransform truth = a.T_world_cam->inverse() * *b.T_world_cam;
  const double best = measure_fit(from, to, camera(), truth, 2).score();
  for (int axis = 0; axis < 6; ++axis) {
    for (const double length : {-0.15, 0.15}) {
      const RigidTransform moved = se3_exp(length * Vector6d::Unit(axis)) * truth;
      EXPECT_LT(measure_fit(from, to, camera(), moved, 2).score(), best) << "axis " << axis;
    }
  }
}

TEST(SurfaceFit, CountsWhatHangsInSeenThroughSpaceAsConflict) {
  const cv::Mat far_wall(240, 320, CV_32FC1, cv::Scalar(3.0));
  cv::Mat with_box = far_wall.clone();
  with_box(cv::Rect(80, 60, 160, 120)).setTo(1.5);  // a quarter of the image
  const SurfaceFit fit =
      measure_fit(grid_of(far_wall), grid_of(with_box), camera(), RigidTransform(), 1);
  EXPECT_NEAR(fit.conflict, 0.125, 0.02);  // of the points of both
  EXPECT_NEAR(fit.behind, 0.125, 0.02);
  EXPECT_NEAR(fit.agree, 0.75, 0.03);
  EXPECT_GT(fit.seen, 0.98);
}

TEST(SurfaceFit, ForgivesAChangeOfExposure) {
  const dataset::Frame frame = room(0);
  cv::Mat brighter;
  frame.color.convertTo(brighter, -1, 1.0, 30.0);
  const SurfaceGrid dark = grid_of(frame), bright = grid_of(frame.depth, brighter);
  EXPECT_GT(measure_fit(dark, bright, camera(), RigidTransform(), 2).agree, 0.95);
}

// A panel 1 m away hides four tenths of a wall 3 m away: a fifteenth of what is seen, in metres.
TEST(AgreeingSurface, CountsSquareMetresAndNotCells) {
  cv::Mat depth(240, 320, CV_32FC1, cv::Scalar(3.0));
  const cv::Rect panel(80, 30, 160, 192);
  depth(panel).setTo(1.0);
  cv::Mat without_wall = depth.clone(), without_panel = depth.clone();
  without_panel(panel).setTo(0.0);
  without_wall.setTo(0.0);
  without_wall(panel).setTo(1.0);
  const SurfaceGrid all = grid_of(depth);
  const auto agreeing = [&](const cv::Mat& other) {
    return agreeing_surface(all, grid_of(other), camera(), RigidTransform(), 1);
  };
  EXPECT_NEAR(agreeing(depth), 1.0, 0.01);
  // Of both images' surfaces: of one the whole, of the other what is in both.
  EXPECT_NEAR(agreeing(without_panel), 2 * 0.93 / (1 + 0.93), 0.03);
  EXPECT_NEAR(agreeing(without_wall), 2 * 0.07 / (1 + 0.07), 0.03);
}

TEST(AgreeingSurface, DropsWithEachMotionButTheTrueOne) {
  const dataset::Frame a = room(0), b = room(kWide);
  const SurfaceGrid from = grid_of(a), to = grid_of(b);
  const RigidTransform truth = a.T_world_cam->inverse() * *b.T_world_cam;
  const double best = agreeing_surface(from, to, camera(), truth, 2);
  EXPECT_GT(best, 0.2);
  for (int axis = 0; axis < 6; ++axis) {
    for (const double length : {-0.1, 0.1}) {
      const RigidTransform moved = se3_exp(length * Vector6d::Unit(axis)) * truth;
      EXPECT_LT(agreeing_surface(from, to, camera(), moved, 2), 0.8 * best) << "axis " << axis;
    }
  }
}

TEST(AgreeingSurface, IsNothingBetweenEmptyGrids) {
  EXPECT_EQ(agreeing_surface({}, {}, camera(), RigidTransform(), 2), 0.0);
}

TEST(SurfaceFit, IsNothingBetweenEmptyGrids) {
  const SurfaceFit fit = measure_fit({}, {}, camera(), RigidTransform(), 2);
  EXPECT_EQ(fit.seen, 0.0);
  EXPECT_EQ(fit.score(), 0.0);
}

}  // namespace
}  // namespace dynslam::slam
