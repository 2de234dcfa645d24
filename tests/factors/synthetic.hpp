// Synthetic frames with known truth for the tests and benchmarks of the factors room.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <random>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/points.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/factors/pose_optimizer.hpp"

namespace dynslam::factors::synthetic {

inline DepthCamera kinect() {
  DepthCamera camera;
  camera.fx = camera.fy = 525.0;
  camera.cx = 319.5;
  camera.cy = 239.5;
  camera.width = 640;
  camera.height = 480;
  camera.bf = 40.0;
  return camera;
}

struct FrameOptions {
  int points = 500;
  double movers = 0.0;           // share of points that move coherently
  double outliers = 0.0;         // share of points with a wrong match, anywhere in the image
  double noise = 1.0;            // pixels
  double motion = 0.15;          // how far the movers went, metres
  double start_rotation = 0.02;  // radians off the truth at the start
  double start_distance = 0.05;  // metres off
  bool depth = true;
};

// One frame: what a tracker has in its hands, and what is true.
struct Frame {
  DepthCamera camera = kinect();
  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Vector2f> pixels;
  std::vector<float> right;
  std::vector<float> inverse_sigma;
  std::vector<float> weights;
  std::vector<std::uint8_t> moves;
  RigidTransform truth, start;

  PoseObservations<float> view() const {
    return {as_points<double>(points), as_points<float>(pixels), right, inverse_sigma, weights};
  }
};

// Draws in a fixed order: the order in which a compiler evaluates arguments is its own.
inline Eigen::Vector3d random_direction(std::mt19937& rng) {
  std::normal_distribution<double> normal;
  Eigen::Vector3d v;
  for (int k = 0; k < 3; ++k) v[k] = normal(rng);
  return v.normalized();
}

inline Vector6d random_twist(std::mt19937& rng, double distance, double rotation) {
  Vector6d xi;
  xi.head<3>() = distance * random_direction(rng);
  xi.tail<3>() = rotation * random_direction(rng);
  return xi;
}

inline Eigen::Vector2d random_pixel(std::mt19937& rng) {
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  Eigen::Vector2d p;
  p.x() = 639.0 * uniform(rng);
  p.y() = 479.0 * uniform(rng);
  return p;
}

inline Frame make_frame(const FrameOptions& o, unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::normal_distribution<double> normal;
  Frame f;
  f.truth = se3_exp(random_twist(rng, 1.0, 0.5));
  f.start = se3_exp(random_twist(rng, o.start_distance, o.start_rotation)) * f.truth;
  const RigidTransform moved = se3_exp(random_twist(rng, o.motion, 0.5 * o.motion));
  for (int i = 0; i < o.points; ++i) {
    const int octave = static_cast<int>(uniform(rng) * 4.0);
    const double sigma = std::pow(1.2, octave);
    const Eigen::Vector2d p = random_pixel(rng);
    const Eigen::Vector3d X = f.camera.unproject(p, 1.0 + 5.0 * uniform(rng));
    const bool moves = uniform(rng) < o.movers;
    // Movers turn about their own centre, in front of the camera.
    const Eigen::Vector3d centre(0.0, 0.0, 3.0);
    const Eigen::Vector3d seen = moves ? (moved * (X - centre).eval() + centre).eval() : X;
    Eigen::Vector3d m = f.camera.project3(seen.z() > 0.2 ? seen : X);
    for (int k = 0; k < 3; ++k) m[k] += o.noise * sigma * normal(rng);
    if (uniform(rng) < o.outliers) {
      m.head<2>() = random_pixel(rng);
      m[2] = m[0] - 5.0 - 30.0 * uniform(rng);
    }
    f.points.push_back(f.truth.inverse() * X);
    f.pixels.emplace_back(m.head<2>().cast<float>());
    f.right.push_back(o.depth ? static_cast<float>(m[2]) : std::numeric_limits<float>::quiet_NaN());
    f.inverse_sigma.push_back(static_cast<float>(1.0 / sigma));
    f.weights.push_back(1.0F);
    f.moves.push_back(moves ? 1 : 0);
  }
  return f;
}

// Distance between two poses' camera centres, metres.
inline double pose_error(const RigidTransform& a, const RigidTransform& b) {
  return (a.inverse().t - b.inverse().t).norm();
}

}  // namespace dynslam::factors::synthetic
