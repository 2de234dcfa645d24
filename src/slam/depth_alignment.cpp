#include "depth_alignment.hpp"

#include <algorithm>
#include <cmath>

#include "alignment_kernels.hpp"
#include "matrix6.hpp"

namespace dynslam::slam {
namespace {

constexpr float kJump = 0.04F;      // share of depth by which neighbours of a surface may differ
constexpr float kMinCosine = 0.7F;  // between normals of partners
constexpr double kMinCurvature = 4e-3;  // smallest over largest eigenvalue of the information
constexpr int kMinPartners = 300;

constexpr float kBrightnessSigma = 6.0F;  // grey levels: noise and shading

constexpr float kMaxChi2 = 25.0F;  // what one residual can say about the fit as a whole

struct Round {
  double gate;  // metres
  int iterations;
};
// Metres and radians a step: below, partners only change places.
constexpr double kConverged = 1e-4;
constexpr Round kRounds[] = {{0.30, 6}, {0.12, 6}, {0.05, 8}};

bool has_normal(const Eigen::Vector3f& normal) { return normal.squaredNorm() > 0.5F; }

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
};

NormalEquations equations_of(const kernels::AlignmentSums& sums) {
  NormalEquations equations;
  int k = 0;
  for (int i = 0; i < 6; ++i) {
    equations.b[i] = sums.g[i];
    for (int j = i; j < 6; ++j, ++k) equations.H(i, j) = equations.H(j, i) = sums.H[k];
  }
  return equations;
}

// Whether the planes that were met hold the motion in every direction. Rotations are compared with
// translations at the scene's own distance, so that the figure has no unit.
bool well_determined(const Matrix6d& H, double distance) {
  Vector6d scale;
  scale << 1, 1, 1, 1 / distance, 1 / distance, 1 / distance;
  const Matrix6d scaled = scale.asDiagonal() * H * scale.asDiagonal();
  const Vector6d curvature = eigenvalues_of(scaled);
  return curvature[0] > kMinCurvature * curvature[5];
}

double mean_distance(const SurfaceGrid& grid) {
  double sum = 0.0;
  int count = 0;
  for (std::size_t i = 0; i < grid.points.size(); ++i) {
    if (!has_normal(grid.normals[i])) continue;
    sum += grid.points[i].z();
    ++count;
  }
  return count > 0 ? sum / count : 1.0;
}

// Mean of the middle pixels of a cell, if they are one surface.
Eigen::Vector3f cell_point(const cv::Mat& depth, int x, int y, const PinholeCamera& camera) {
  float sum = 0.0F, nearest = 1e9F, farthest = 0.0F;
  int count = 0;
  for (int v = kSurfaceCell * y + 1; v <= kSurfaceCell * y + 2; ++v) {
    const float* row = depth.ptr<float>(v);
    for (int u = kSurfaceCell * x + 1; u <= kSurfaceCell * x + 2; ++u) {
      const float z = row[u];
      if (!(z > 0.0F)) continue;
      sum += z;
      nearest = std::min(nearest, z);
      farthest = std::max(farthest, z);
      ++count;
    }
  }
  if (count < 3 || farthest - nearest > kJump * nearest) return Eigen::Vector3f::Zero();
  const Eigen::Vector2d centre(kSurfaceCell * x + 1.5, kSurfaceCell * y + 1.5);
  return camera.unproject(centre, sum / static_cast<float>(count)).cast<float>();
}

// Adds the certainty of the guess: xi is the left perturbation from it.
void add_guess(const Matrix6d& information, const RigidTransform& T, const RigidTransform& guess,
               NormalEquations& sum) {
  sum.H += information;
  sum.b += information * se3_log(T * guess.inverse());
}

}  // namespace

void build_surface_grid(const cv::Mat& depth, const cv::Mat& gray_cells,
                        const PinholeCamera& camera, SurfaceGrid& grid) {
  grid.width = depth.cols / kSurfaceCell;
  grid.height = depth.rows / kSurfaceCell;
  const auto cells = static_cast<std::size_t>(grid.width) * static_cast<std::size_t>(grid.height);
  grid.points.resize(cells);
  grid.normals.resize(cells);
  grid.trust.release();
  if (gray_cells.empty()) {
    grid.gray.release();
  } else {
    gray_cells.convertTo(grid.gray, CV_32F);
  }
  const auto pitch = static_cast<std::size_t>(grid.width);
  for (int y = 0; y < grid.height; ++y) {
    Eigen::Vector3f* points = grid.points.data() + static_cast<std::size_t>(y) * pitch;
    for (int x = 0; x < grid.width; ++x) points[x] = cell_point(depth, x, y, camera);
  }
  for (std::size_t i = 0; i < cells; ++i) {
    const bool last = (i + 1) % pitch == 0 || i + pitch >= cells;  // in its row or column
    grid.normals[i] = last ? Eigen::Vector3f(Eigen::Vector3f::Zero())
                           : normal_of(grid.points[i], grid.points[i + 1], grid.points[i + pitch]);
  }
}

std::optional<SurfaceAlignment> align_surfaces(const SurfaceGrid& from, const SurfaceGrid& to,
                                               const PinholeCamera& camera,
                                               const RigidTransform& initial,
                                               const AlignmentOptions& options) {
  if (from.empty() || to.empty()) return std::nullopt;
  SurfaceAlignment result;
  result.T_from_to = initial;
  // Only an open direction asks for it.
  const double distance = options.guess_information ? 0.0 : mean_distance(to);
  const int min_partners = kMinPartners / (options.step * options.step);
  const bool brightness = options.use_brightness && !from.gray.empty() && !to.gray.empty();
  kernels::AlignmentSums sums;
  NormalEquations last;
  for (const Round& round : kRounds) {
    if (round.gate > options.first_gate || round.gate < options.last_gate) continue;
    const kernels::Matching matching{static_cast<float>(round.gate),
                                     brightness ? kBrightnessSigma : 0.0F, kMinCosine, kMaxChi2,
                                     options.step};
    for (int i = 0; i < round.iterations; ++i) {
      sums = kernels::sum_partners(from, to, camera, result.T_from_to, matching);
      if (sums.partners < min_partners) return std::nullopt;
      last = equations_of(sums);
      if (options.guess_information) {
        add_guess(*options.guess_information, result.T_from_to, initial, last);
      } else if (!well_determined(last.H, distance)) {
        return std::nullopt;
      }
      const Vector6d step = -solve_symmetric(last.H, last.b);
      if (!step.allFinite()) return std::nullopt;
      result.T_from_to = (se3_exp(step) * result.T_from_to).normalized();
      if (step.norm() < kConverged) break;
    }
  }
  // Where the fit is worse than its noise, it is as much less certain.
  result.information = last.H / std::max(1.0, sums.chi2 / std::max(1e-9, sums.trust));
  result.overlap = static_cast<double>(sums.partners) / std::max(1, sums.candidates);
  result.rms = std::sqrt(sums.squares / sums.partners);
  if (result.overlap < options.min_overlap || result.rms > options.max_rms) return std::nullopt;
  return result;
}

}  // namespace dynslam::slam
