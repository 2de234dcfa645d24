// Renders a second of a room with two people walking through it and shows what its exact truth is
// good for: how much of the image moves, how many point correspondences a static world explains,
// and what the simulated depth sensor does to depth.
#include <cmath>
#include <cstdio>

#include "dynslam/dataset/scene.hpp"

namespace {

namespace ds = dynslam::dataset;

/// Share of the pixels that are neither static nor without label.
double share_moving(const cv::Mat& mask) {
  int moving = 0;
  for (int y = 0; y < mask.rows; ++y) {
    for (int x = 0; x < mask.cols; ++x) moving += mask.at<unsigned char>(y, x) != 0;
  }
  return static_cast<double>(moving) / static_cast<double>(mask.total());
}

/// Correspondences between two frames, and how many of them the camera's motion alone explains.
void count_explained(const ds::RenderedScene& scene, std::size_t from, std::size_t to) {
  const dynslam::RigidTransform T = scene.T_world_cam(to).inverse() * scene.T_world_cam(from);
  int total = 0, explained = 0, dynamic = 0;
  for (int y = 8; y < scene.camera().height; y += 16) {
    for (int x = 8; x < scene.camera().width; x += 16) {
      const auto here = scene.cast(from, {x, y});
      const auto there = scene.correspondence(from, {x, y}, to);
      if (!here || !there || !there->visible) continue;
      const Eigen::Vector3d if_static = T * scene.camera().unproject({x, y}, here->depth);
      ++total;
      dynamic += here->label != ds::kStaticLabel;
      explained += (scene.camera().project(if_static) - there->pixel).norm() < 0.5;
    }
  }
  std::printf(
      "frames %zu -> %zu: %d points seen in both, %d of them on movers; a static world "
      "explains %d\n",
      from, to, total, dynamic, explained);
}

/// Root mean square error of measured depth, and the share of holes.
void compare_depth(const cv::Mat& measured, const cv::Mat& exact) {
  double squares = 0.0;
  int holes = 0, count = 0;
  for (int y = 0; y < exact.rows; ++y) {
    for (int x = 0; x < exact.cols; ++x) {
      const float z = measured.at<float>(y, x);
      if (z == 0.0F) {
        ++holes;
        continue;
      }
      squares += std::pow(static_cast<double>(z - exact.at<float>(y, x)), 2);
      ++count;
    }
  }
  std::printf("depth: %.1f mm RMS error, %.1f %% holes\n", 1000.0 * std::sqrt(squares / count),
              100.0 * holes / static_cast<double>(exact.total()));
}

}  // namespace

int main() {
  // [ten-line example]
  ds::SceneOptions options;
  options.seed = 3;
  options.camera = ds::scene_camera(320, 240);
  const ds::RenderedScene scene(options);
  for (std::size_t i = 30; i <= 60; i += 10) {
    const ds::Frame frame = scene.render(i);  // color, depth, mask, T_world_cam
    const Eigen::Vector3d& at = frame.T_world_cam->t;
    std::printf("%s s: camera at (%.3f, %.3f, %.3f) m, %2.0f %% of the image moves\n",
                frame.name.c_str(), at.x(), at.y(), at.z(), 100.0 * share_moving(frame.mask));
  }
  // [ten-line example]
  count_explained(scene, 30, 36);
  compare_depth(scene.render(30).depth, scene.exact_depth(30));
  return 0;
}
