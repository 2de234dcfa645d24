// Matches between two views of a made-up scene.
#pragma once

#include <random>
#include <vector>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/slam/two_view.hpp"

#include "slam/vga_camera.hpp"

namespace dynslam::slam {

enum class Scene { kRoom, kWall, kSlantedWall, kRoughWall };

// Matches of points in front of both cameras with noise of half a pixel and a share of outliers.
struct Matches {
  std::vector<Eigen::Vector2d> first, second;
  std::vector<double> depths;
  std::vector<bool> wrong;

  Matches(Scene scene, const RigidTransform& T_second_first, double outliers, int count = 300,
          unsigned seed = 7) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> u(20.0, 620.0), v(20.0, 460.0), unit(0.0, 1.0);
    std::normal_distribution<double> noise(0.0, 0.5);
    while (static_cast<int>(first.size()) < count) {
      const Eigen::Vector2d pixel(u(random), v(random));
      double depth = 4.0;
      if (scene == Scene::kRoom) depth = 2.0 + 6.0 * unit(random);
      if (scene == Scene::kSlantedWall || scene == Scene::kRoughWall) {
        depth /= 1.0 + 0.5 * (pixel.x() - 319.5) / 500.0;
      }
      if (scene == Scene::kRoughWall) depth *= 0.975 + 0.05 * unit(random);
      const Eigen::Vector3d X = camera().unproject(pixel, depth);
      const auto seen = camera().project_into_image(T_second_first * X);
      if (!seen) continue;
      wrong.push_back(unit(random) < outliers);
      first.push_back(pixel + Eigen::Vector2d(noise(random), noise(random)));
      second.push_back(wrong.back() ? Eigen::Vector2d(u(random), v(random))
                                    : *seen + Eigen::Vector2d(noise(random), noise(random)));
      depths.push_back(depth);
    }
  }

  TwoViewReconstruction reconstruct(const TwoViewOptions& options = {}) const {
    return reconstruct_two_views(camera(), as_points<double>(first), as_points<double>(second), {},
                                 {}, options);
  }
};

}  // namespace dynslam::slam
