// Matched points of a made-up scene seen by two cameras, with the truth known for each match.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <random>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "dynslam/core/match.hpp"
#include "dynslam/matching/traits.hpp"

namespace synthetic {

struct Motion {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  double roll_degrees = 0.0;  // what the key point angles turn by
};

inline Eigen::Matrix3d turn(double yaw, double pitch, double roll) {
  const double degree = std::acos(-1.0) / 180.0;
  using Eigen::AngleAxisd;
  using Eigen::Vector3d;
  return (AngleAxisd(yaw * degree, Vector3d::UnitY()) *
          AngleAxisd(pitch * degree, Vector3d::UnitX()) *
          AngleAxisd(roll * degree, Vector3d::UnitZ()))
      .toRotationMatrix();
}

struct Setup {
  std::size_t matches = 500;
  double outliers = 0.5;  // share of wrong matches
  Motion camera;
  bool mover = false;  // a box in the middle moves by itself
  Motion mover_motion;
  bool angles = true;  // key points carry angles
  double noise = 0.7;  // sigma of the points, pixels
  unsigned seed = 1;
  double scale2 = 1.0;  // second image enlarged by this
};

struct Pairs {
  std::vector<dynslam::matching::Keypoint> points1, points2;
  std::vector<dynslam::Match> matches;
  std::vector<std::uint8_t> good;
  std::vector<std::uint8_t> on_mover;
};

/// Half of the points in 25 clusters at depths of 1.5 to 8 m, half on a wall and a floor; 640x480,
/// f = 525.
inline Pairs make_pairs(const Setup& setup) {
  std::mt19937 random(setup.seed);
  const auto uniform = [&](double a, double b) {
    return a + (b - a) * (static_cast<double>(random()) / 4294967296.0);
  };
  std::normal_distribution<double> normal;
  constexpr double kFocal = 525.0, kCx = 320.0, kCy = 240.0;
  const auto inside = [](double x, double y) { return x >= 0 && y >= 0 && x < 640 && y < 480; };
  Eigen::Matrix<double, 3, 25> clusters;
  for (int i = 0; i < 25; ++i) {
    clusters.col(i) << uniform(20, 620), uniform(20, 460), uniform(1.5, 8);
  }
  const Eigen::Vector3d box(0.0, 0.0, 2.0);
  Pairs pairs;
  while (pairs.matches.size() < setup.matches) {
    double x = uniform(0, 640), y = uniform(0, 480);
    double z = y > 300 ? 2.0 : 4.5;
    if (uniform(0, 1) < 0.5) {
      const Eigen::Vector3d cluster = clusters.col(static_cast<Eigen::Index>(random() % 25));
      x = cluster[0] + 25 * normal(random);
      y = cluster[1] + 25 * normal(random);
      z = cluster[2];
    }
    if (!inside(x, y)) continue;
    const bool on_box = setup.mover && std::abs(x - kCx) < 110 && std::abs(y - kCy) < 110;
    if (on_box) z = 2.0 + 0.2 * (x - kCx) / 110;
    Eigen::Vector3d point((x - kCx) / kFocal * z, (y - kCy) / kFocal * z, z);
    if (on_box) {
      point = setup.mover_motion.rotation * (point - box) + box + setup.mover_motion.translation;
    }
    point = setup.camera.rotation * point + setup.camera.translation;
    const bool good = uniform(0, 1) >= setup.outliers;
    double u = uniform(0, 640), v = uniform(0, 480);
    if (good) {
      if (point.z() < 0.2) continue;
      u = kFocal * point.x() / point.z() + kCx + setup.noise * normal(random);
      v = kFocal * point.y() / point.z() + kCy + setup.noise * normal(random);
      if (!inside(u, v)) continue;
    }
    dynslam::matching::Keypoint a, b;
    a.x = static_cast<float>(x), a.y = static_cast<float>(y);
    b.x = static_cast<float>(setup.scale2 * u), b.y = static_cast<float>(setup.scale2 * v);
    if (setup.angles) {
      const double angle = uniform(0, 360);
      const double other =
          good ? angle + setup.camera.roll_degrees + 6 * normal(random) + 720 : uniform(0, 360);
      a.angle = static_cast<float>(angle);
      b.angle = static_cast<float>(std::fmod(other, 360.0));
    }
    const auto index = static_cast<std::int32_t>(pairs.matches.size());
    pairs.matches.push_back({index, index, good ? 25.0F : 55.0F});
    pairs.points1.push_back(a);
    pairs.points2.push_back(b);
    pairs.good.push_back(good ? 1 : 0);
    pairs.on_mover.push_back(on_box ? 1 : 0);
  }
  return pairs;
}

struct Score {
  double precision = 0.0, recall = 0.0;
};

inline Score score(const std::vector<std::uint8_t>& keep, const std::vector<std::uint8_t>& good) {
  double both = 0, kept = 0, right = 0;
  for (std::size_t i = 0; i < keep.size(); ++i) {
    both += keep[i] != 0 && good[i] != 0;
    kept += keep[i] != 0;
    right += good[i] != 0;
  }
  return {kept > 0 ? both / kept : 0.0, right > 0 ? both / right : 0.0};
}

}  // namespace synthetic
