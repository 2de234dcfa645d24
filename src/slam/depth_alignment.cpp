#include "depth_alignment.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

namespace dynslam::slam {
namespace {

constexpr int kCell = 4;              // pixels
constexpr float kJump = 0.04F;        // share of depth by which neighbours of a surface may differ
constexpr double kMinOverlap = 0.35;  // of the points of `to`
constexpr double kMaxRms = 0.02;      // metres
constexpr double kMinCosine = 0.7;    // between normals of partners
constexpr double kMinCurvature = 4e-3;  // smallest over largest eigenvalue of the information
constexpr int kMinPartners = 300;

struct Round {
  double gate;  // metres
  int iterations;
};
constexpr Round kRounds[] = {{0.30, 6}, {0.12, 6}, {0.05, 8}};

float noise(float z) { return 0.0012F + 0.0019F * (z - 0.4F) * (z - 0.4F); }

Eigen::Vector3f normal_of(const Eigen::Vector3f& at, const Eigen::Vector3f& right,
                          const Eigen::Vector3f& below) {
  if (at.z() == 0.0F || right.z() == 0.0F || below.z() == 0.0F) return Eigen::Vector3f::Zero();
  const float jump = kJump * at.z();
  if (std::abs(right.z() - at.z()) > jump || std::abs(below.z() - at.z()) > jump) {
    return Eigen::Vector3f::Zero();
  }
  Eigen::Vector3f n = (right - at).cross(below - at).normalized();
  if (n.dot(at) > 0.0F) n = -n;
  // Grazing surfaces have unreliable depth.
  return -n.dot(at.normalized()) > 0.2F ? n : Eigen::Vector3f::Zero();
}

struct NormalEquations {
  Matrix6d H = Matrix6d::Zero();
  Vector6d b = Vector6d::Zero();
  double squares = 0.0;
  int partners = 0;
  int candidates = 0;
};

void accumulate(const SurfaceGrid& from, const SurfaceGrid& to, const PinholeCamera& camera,
                const RigidTransform& T, double gate, NormalEquations& sum) {
  for (std::size_t i = 0; i < to.points.size(); ++i) {
    if (to.normals[i].isZero()) continue;
    const Eigen::Vector3d p = T * to.points[i].cast<double>();
    if (p.z() <= kMinDepth) continue;
    const Eigen::Vector2d pixel = camera.project(p);
    if (!camera.contains(pixel)) continue;
    ++sum.candidates;
    const int x = std::min(static_cast<int>(pixel.x()) / kCell, from.width - 1);
    const int y = std::min(static_cast<int>(pixel.y()) / kCell, from.height - 1);
    const auto j = static_cast<std::size_t>(y * from.width + x);
    if (from.normals[j].isZero()) continue;
    const Eigen::Vector3d n = from.normals[j].cast<double>();
    const Eigen::Vector3d gap = p - from.points[j].cast<double>();
    if (gap.norm() > gate || n.dot(T.R * to.normals[i].cast<double>()) < kMinCosine) continue;
    const double r = n.dot(gap);
    const double sigma = std::max(0.003, static_cast<double>(noise(to.points[i].z())));
    const double whitened = std::abs(r) / sigma;
    const double weight = (whitened > 2.0 ? 2.0 / whitened : 1.0) / (sigma * sigma);
    Vector6d J;
    J << n, p.cross(n);
    sum.H.noalias() += weight * J * J.transpose();
    sum.b.noalias() += weight * r * J;
    sum.squares += r * r;
    ++sum.partners;
  }
}

// Whether the planes that were met hold the motion in every direction. Rotations are compared with
// translations at the scene's own distance, so that the figure has no unit.
bool well_determined(const Matrix6d& H, double distance) {
  Vector6d scale;
  scale << 1, 1, 1, 1 / distance, 1 / distance, 1 / distance;
  const Matrix6d scaled = scale.asDiagonal() * H * scale.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(scaled, Eigen::EigenvaluesOnly);
  return eigen.eigenvalues()[0] > kMinCurvature * eigen.eigenvalues()[5];
}

double mean_distance(const SurfaceGrid& grid) {
  double sum = 0.0;
  int count = 0;
  for (std::size_t i = 0; i < grid.points.size(); ++i) {
    if (grid.normals[i].isZero()) continue;
    sum += grid.points[i].z();
    ++count;
  }
  return count > 0 ? sum / count : 1.0;
}

}  // namespace

void build_surface_grid(ImageView<const float> depth, const PinholeCamera& camera,
                        SurfaceGrid& grid) {
  grid.width = depth.width / kCell;
  grid.height = depth.height / kCell;
  const auto cells = static_cast<std::size_t>(grid.width) * static_cast<std::size_t>(grid.height);
  grid.points.assign(cells, Eigen::Vector3f::Zero());
  grid.normals.assign(cells, Eigen::Vector3f::Zero());
  for (int y = 0; y < grid.height; ++y) {
    for (int x = 0; x < grid.width; ++x) {
      // The mean of the middle pixels, if they are one surface.
      float sum = 0.0F, nearest = 1e9F, farthest = 0.0F;
      int count = 0;
      for (int dy = 1; dy <= 2; ++dy) {
        for (int dx = 1; dx <= 2; ++dx) {
          const int u = kCell * x + dx, v = kCell * y + dy;
          const float z = depth(u, v);
          if (!(z > 0.0F)) continue;
          sum += z;
          nearest = std::min(nearest, z);
          farthest = std::max(farthest, z);
          ++count;
        }
      }
      if (count < 3 || farthest - nearest > kJump * nearest) continue;
      const Eigen::Vector2d centre(kCell * x + 1.5, kCell * y + 1.5);
      grid.points[static_cast<std::size_t>(y * grid.width + x)] =
          camera.unproject(centre, sum / static_cast<float>(count)).cast<float>();
    }
  }
  for (int y = 0; y + 1 < grid.height; ++y) {
    for (int x = 0; x + 1 < grid.width; ++x) {
      const auto i = static_cast<std::size_t>(y * grid.width + x);
      grid.normals[i] = normal_of(grid.points[i], grid.points[i + 1],
                                  grid.points[i + static_cast<std::size_t>(grid.width)]);
    }
  }
}

std::optional<SurfaceAlignment> align_surfaces(const SurfaceGrid& from, const SurfaceGrid& to,
                                               const PinholeCamera& camera,
                                               const RigidTransform& initial) {
  if (from.empty() || to.empty()) return std::nullopt;
  SurfaceAlignment result;
  result.T_from_to = initial;
  const double distance = mean_distance(to);
  NormalEquations last;
  for (const Round& round : kRounds) {
    for (int i = 0; i < round.iterations; ++i) {
      last = {};
      accumulate(from, to, camera, result.T_from_to, round.gate, last);
      if (last.partners < kMinPartners || !well_determined(last.H, distance)) return std::nullopt;
      const Vector6d step = -last.H.ldlt().solve(last.b);
      if (!step.allFinite()) return std::nullopt;
      result.T_from_to = (se3_exp(step) * result.T_from_to).normalized();
      if (step.norm() < 1e-5) break;
    }
  }
  result.information = last.H;
  result.overlap = static_cast<double>(last.partners) / std::max(1, last.candidates);
  result.rms = std::sqrt(last.squares / last.partners);
  if (result.overlap < kMinOverlap || result.rms > kMaxRms) return std::nullopt;
  return result;
}

}  // namespace dynslam::slam
