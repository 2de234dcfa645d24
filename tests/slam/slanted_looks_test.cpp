// Looks of points on a plane that is seen aslant, from two sides.
#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/so3.hpp"

#include "slam/frame_builder.hpp"
#include "slam/median.hpp"
#include "slam/point_looks.hpp"
#include "slam/vga_camera.hpp"

namespace dynslam::slam {
namespace {

constexpr double kDistance = 2.0;  // metres, of the plane before the first camera
constexpr double kSlant = 0.9;     // radians
constexpr double kTexelsAMetre = 400.0;

class SlantedLooks : public ::testing::Test {
 protected:
  SlantedLooks() : camera_(with_depth()), builder_(camera_, SystemOptions()) {
    cv::Mat noise(1600, 1600, CV_32FC1);
    cv::RNG random(5);
    random.fill(noise, cv::RNG::UNIFORM, 0.0, 255.0);
    cv::GaussianBlur(noise, texture_, {}, 4.0);
    cv::normalize(texture_, texture_, 0.0, 255.0, cv::NORM_MINMAX);
    normal_ = {std::sin(kSlant), 0.0, std::cos(kSlant)};
    // Across the plane: along it in the picture's row, and its column.
    across_ << std::cos(kSlant), 0.0, 0.0, 1.0, -std::sin(kSlant), 0.0;
    see(RigidTransform(), first_);
    // From aside, at the same middle: 10 degrees.
    const Eigen::Vector3d middle(0.0, 0.0, kDistance);
    const Eigen::Matrix3d R = so3_exp({0.0, 0.17, 0.0});
    see({R, middle - R * middle}, second_);
  }

  static DepthCamera with_depth() {
    DepthCamera result;
    static_cast<PinholeCamera&>(result) = camera();
    result.bf = 0.23 * result.fx;
    return result;
  }

  // Where the line of sight of a pixel meets the plane, world.
  Eigen::Vector3d seen_at(const RigidTransform& T_cam_world, double x, double y) const {
    const RigidTransform T_world_cam = T_cam_world.inverse();
    const Eigen::Vector3d ray = T_world_cam.R * camera_.bearing({x, y});
    const double reach = normal_.z() * kDistance - normal_.dot(T_world_cam.t);
    return T_world_cam.t + reach / normal_.dot(ray) * ray;
  }

  void see(const RigidTransform& T_cam_world, TrackedFrame& frame) {
    cv::Mat map_x(camera_.height, camera_.width, CV_32FC1), map_y = map_x.clone();
    FrameInput input;
    input.depth = map_x.clone();
    for (int y = 0; y < camera_.height; ++y) {
      for (int x = 0; x < camera_.width; ++x) {
        const Eigen::Vector3d X = seen_at(T_cam_world, x, y);
        const Eigen::Vector2d texel =
            across_.transpose() * (X - Eigen::Vector3d(0.0, 0.0, kDistance)) * kTexelsAMetre;
        map_x.at<float>(y, x) = static_cast<float>(texel.x() + 800.0);
        map_y.at<float>(y, x) = static_cast<float>(texel.y() + 800.0);
        input.depth.at<float>(y, x) = static_cast<float>((T_cam_world * X).z());
      }
    }
    cv::Mat gray;
    cv::remap(texture_, gray, map_x, map_y, cv::INTER_CUBIC, cv::BORDER_REFLECT);
    gray.convertTo(input.image, CV_8U);
    frame.reset(builder_.build(input, {}), 0.0);
    frame.depth = input.depth;
    frame.T_cam_world = T_cam_world;
    builder_.view_levels(frame.levels);
    if (map_.point_count() == 0) make_points(frame);
  }

  // From the first frame, whose pyramid is gone when the second is built.
  void make_points(const TrackedFrame& frame) {
    for (std::size_t i = 0; i < frame.features->size(); ++i) {
      const cv::KeyPoint& keypoint = frame.features->keypoints[i];
      MapPoint point;
      point.position = seen_at(frame.T_cam_world, static_cast<double>(keypoint.pt.x),
                               static_cast<double>(keypoint.pt.y));
      point.look = point_look(camera_, frame, i, point.position, builder_.scale_factors());
      if (point.look == nullptr) continue;
      sought_.push_back({static_cast<std::uint32_t>(sought_.size()), kNoId, keypoint.octave, 1});
      sought_.back().id = map_.add_point(std::move(point));
    }
  }

  struct Found {
    std::size_t count;
    double median_error;  // pixels of the level
  };
  Found seek() {
    const LookFinder finder(camera_, builder_.scale_factors());
    const std::vector<PointMatch> matches = finder.seek(map_, sought_, sought_.size(), second_);
    std::vector<double> errors;
    for (const PointMatch& match : matches) {
      const cv::KeyPoint& keypoint = second_.features->keypoints[match.feature];
      const Eigen::Vector2d at = camera_.project(second_.T_cam_world * match.position);
      const Eigen::Vector2d off(static_cast<double>(keypoint.pt.x) - at.x(),
                                static_cast<double>(keypoint.pt.y) - at.y());
      const auto octave = static_cast<std::size_t>(keypoint.octave);
      errors.push_back(off.norm() / static_cast<double>(builder_.scale_factors()[octave]));
    }
    second_.drop_sought();
    return {matches.size(), errors.empty() ? 9.0 : median(errors)};
  }

  DepthCamera camera_;
  FrameBuilder builder_;
  cv::Mat texture_;
  Eigen::Vector3d normal_;
  Eigen::Matrix<double, 3, 2> across_;
  TrackedFrame first_, second_;
  Map map_;
  std::vector<SoughtPoint> sought_;
};

TEST_F(SlantedLooks, AreWarpedAsTheirSurfaceStands) {
  for (const SoughtPoint& sought : sought_) {
    const PointLook& look = *map_.point(sought.id).look;
    if (look.normal_world.isZero()) continue;
    EXPECT_GT(look.normal_world.dot(normal_), 0.99);
  }
  const Found known = seek();
  for (const SoughtPoint& sought : sought_) {
    auto facing = std::make_shared<PointLook>(*map_.point(sought.id).look);
    facing->normal_world.setZero();
    map_.point(sought.id).look = facing;
  }
  const Found facing = seek();
  EXPECT_GT(known.count, sought_.size() / 2);
  EXPECT_GT(known.count, facing.count);
  EXPECT_LT(known.median_error, 0.05);
  EXPECT_LT(known.median_error, 0.5 * facing.median_error);
}

}  // namespace
}  // namespace dynslam::slam
