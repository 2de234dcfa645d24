#include "motion_valleys.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include "dynslam/core/so3.hpp"

namespace dynslam::slam {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Matrix5d = Eigen::Matrix<double, 5, 5>;
using Vector5d = Eigen::Matrix<double, 5, 1>;

constexpr int kDirections = 24;      // over the half sphere: 16 degrees apart
constexpr int kIterations = 15;      // of a descent
constexpr double kWidest = 1024.0;   // of the loss at first, chi^2: 32 pixels
constexpr double kNarrowing = 0.25;  // an iteration
constexpr double kSamePoseDeg = 5.0;
constexpr double kPi = 3.14159265358979323846;

// Two bearings and the variance of a bearing, squared radians.
struct Rays {
  Vector3d first, second;
  double first_variance, second_variance;
};

struct Valley {
  RigidTransform T_second_first;
  double likelihood = 0.0;
};

std::vector<Rays> rays_of(const PinholeCamera& camera, const std::vector<PixelMatch>& matches) {
  std::vector<Rays> rays;
  const double pixel = 2.0 / (camera.fx + camera.fy);
  for (const PixelMatch& m : matches) {
    rays.push_back({camera.bearing(m.first).normalized(), camera.bearing(m.second).normalized(),
                    std::pow(pixel * m.first_scale, 2), std::pow(pixel * m.second_scale, 2)});
  }
  return rays;
}

// The epipolar error of a match and its variance to first order (Sampson 1982).
struct Error {
  Vector3d turned;  // the first bearing in the second camera
  double value = 0.0;
  double variance = 0.0;
};

Error error_of(const Rays& rays, const RigidTransform& T) {
  Error error;
  error.turned = T.R * rays.first;
  const Vector3d plane = T.t.cross(error.turned), back = rays.second.cross(T.t);
  error.value = rays.second.dot(plane);
  const double e2 = error.value * error.value;
  error.variance = (plane.squaredNorm() - e2) * rays.second_variance +
                   (back.squaredNorm() - e2) * rays.first_variance;
  return error;
}

// One step of Gauss-Newton on the rotation and the direction, under a loss so wide.
bool descend(const std::vector<Rays>& rays, double width, RigidTransform& T) {
  const Vector3d a = T.t.unitOrthogonal(), b = T.t.cross(a);
  Matrix5d H = Matrix5d::Zero();
  Vector5d g = Vector5d::Zero();
  for (const Rays& r : rays) {
    const Error error = error_of(r, T);
    if (!(error.variance > 0.0)) continue;
    const double s = error.value * error.value / error.variance;
    const double weight = std::pow(width / (width + s), 2) / error.variance;
    const Vector3d normal = error.turned.cross(r.second);
    Vector5d J;
    J << error.turned.cross(r.second.cross(T.t)), a.dot(normal), b.dot(normal);
    H.selfadjointView<Eigen::Lower>().rankUpdate(J, weight);
    g += weight * error.value * J;
  }
  H.diagonal() *= 1.0 + 1e-3;  // the direction is as good as free where nothing has parallax
  const Vector5d step = H.selfadjointView<Eigen::Lower>().ldlt().solve(-g);
  if (!step.allFinite()) return false;
  T.R = so3_exp(step.head<3>()) * T.R;
  T.t = (T.t + step[3] * a + step[4] * b).normalized();
  return true;
}

double likelihood(const std::vector<Rays>& rays, const RigidTransform& T) {
  double sum = 0.0;
  for (const Rays& r : rays) {
    const Error error = error_of(r, T);
    if (!(error.variance > 0.0)) continue;
    sum += std::max(0.0, kChi2Line - error.value * error.value / error.variance);
  }
  return sum;
}

// Evenly spread over the half sphere (a Fibonacci lattice).
Vector3d direction(int i) {
  const double z = (i + 0.5) / kDirections, angle = i * kPi * (3.0 - std::sqrt(5.0));
  const double r = std::sqrt(1.0 - z * z);
  return {r * std::cos(angle), r * std::sin(angle), z};
}

}  // namespace

bool same_valley(const RigidTransform& a, const RigidTransform& b) {
  const double between = std::atan2(a.t.cross(b.t).norm(), a.t.dot(b.t));
  return std::max(rotation_angle(a.R, b.R), between) < kSamePoseDeg * kPi / 180.0;
}

std::vector<RigidTransform> motion_valleys(const PinholeCamera& camera,
                                           const std::vector<PixelMatch>& matches,
                                           const Matrix3d& R_second_first, std::size_t most) {
  const std::vector<Rays> rays = rays_of(camera, matches);
  std::vector<Valley> valleys;
  for (int i = 0; i < kDirections; ++i) {
    RigidTransform T(R_second_first, direction(i));
    double width = kWidest;
    bool descended = true;
    for (int k = 0; k < kIterations && descended; ++k) {
      descended = descend(rays, width, T);
      width = std::max(kNarrowing * width, kChi2Line);
    }
    if (descended) valleys.push_back({T.normalized(), likelihood(rays, T)});
  }
  std::stable_sort(valleys.begin(), valleys.end(),
                   [](const Valley& a, const Valley& b) { return a.likelihood > b.likelihood; });
  std::vector<RigidTransform> distinct;
  for (const Valley& valley : valleys) {
    const RigidTransform& T = valley.T_second_first;
    const bool known = std::any_of(distinct.begin(), distinct.end(), [&](const RigidTransform& d) {
      return same_valley(d, T) || same_valley(d, RigidTransform(T.R, -T.t));
    });
    if (!known && distinct.size() < most) distinct.push_back(T);
  }
  return distinct;
}

}  // namespace dynslam::slam
