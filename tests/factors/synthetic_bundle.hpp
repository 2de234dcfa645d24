// A synthetic local map with known truth: keyframes along an arc looking at a cloud of points.
#pragma once

#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "dynslam/factors/bundle_adjustment.hpp"

#include "factors/synthetic.hpp"

namespace dynslam::factors::synthetic {

struct BundleShape {
  int keyframes = 20;
  int fixed = 2;
  int points = 2000;
  double seen = 0.42;  // share of the points in view that a keyframe has matched
  double noise = 1.0;  // pixels
  double outliers = 0.0;
  double depth = 1.0;  // share of observations with depth
  double start_distance = 0.03, start_rotation = 0.01, start_point = 0.05;
  double length = 2.0;  // metres the camera travels
};

struct Bundle {
  DepthCamera camera = kinect();
  std::vector<RigidTransform> truth, poses;
  std::vector<Eigen::Vector3d> true_points, points;
  std::vector<std::uint8_t> fixed;
  std::vector<BundleObservation> observations;
  std::vector<std::uint8_t> outlier;  // by observation
  std::vector<std::uint8_t> inliers;
  std::vector<float> weights, squared_residuals;

  BundleProblem view() {
    inliers.resize(observations.size());
    weights.resize(observations.size());
    squared_residuals.resize(observations.size());
    return {camera, poses, fixed, points, {}, observations, inliers, weights, squared_residuals};
  }
};

inline Bundle make_bundle(const BundleShape& shape, unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::normal_distribution<double> normal;
  Bundle b;
  for (int k = 0; k < shape.keyframes; ++k) {
    const double along = shape.keyframes > 1 ? k / (shape.keyframes - 1.0) - 0.5 : 0.0;
    Vector6d xi;
    xi << -shape.length * along, 0.1 * std::sin(6.0 * along), 0.0, 0.0, 0.15 * along, 0.0;
    b.truth.push_back(se3_exp(xi));
    b.fixed.push_back(k < shape.fixed ? 1 : 0);
    b.poses.push_back(k < shape.fixed
                          ? b.truth.back()
                          : se3_exp(random_twist(rng, shape.start_distance, shape.start_rotation)) *
                                b.truth.back());
  }
  for (int p = 0; p < shape.points; ++p) {
    Eigen::Vector3d X;
    X.x() = (shape.length + 5.0) * (uniform(rng) - 0.5);
    X.y() = 4.0 * (uniform(rng) - 0.5);
    X.z() = 2.5 + 3.5 * uniform(rng);
    b.true_points.push_back(X);
    b.points.push_back(X + shape.start_point * random_direction(rng));
    for (int k = 0; k < shape.keyframes; ++k) {
      const Eigen::Vector3d in_camera = b.truth[k] * X;
      if (in_camera.z() < 0.3 || !b.camera.contains(b.camera.project(in_camera))) continue;
      if (uniform(rng) > shape.seen) continue;
      Eigen::Vector3d m = b.camera.project3(in_camera);
      for (int i = 0; i < 3; ++i) m[i] += shape.noise * normal(rng);
      const bool outlier = uniform(rng) < shape.outliers;
      if (outlier) {
        m.head<2>() = random_pixel(rng);
        m[2] = m[0] - 10.0;
      }
      BundleObservation o;
      o.keyframe = static_cast<std::uint32_t>(k);
      o.point = static_cast<std::uint32_t>(p);
      o.u = static_cast<float>(m[0]);
      o.v = static_cast<float>(m[1]);
      if (uniform(rng) < shape.depth) o.right_column = static_cast<float>(m[2]);
      b.observations.push_back(o);
      b.outlier.push_back(outlier ? 1 : 0);
    }
  }
  return b;
}

}  // namespace dynslam::factors::synthetic
