#include "depth_alignment.hpp"

#include <algorithm>
#include <cmath>

#include "matrix6.hpp"

namespace dynslam::slam {
namespace {

constexpr float kJump = 0.04F;      // share of depth by which neighbours of a surface may differ
constexpr double kMinCosine = 0.7;  // between normals of partners
constexpr double kMinCurvature = 4e-3;  // smallest over largest eigenvalue of the information
constexpr int kMinPartners = 300;

constexpr double kBrightnessSigma = 6.0;  // grey levels: noise and shading

constexpr double kMaxChi2 = 25.0;  // what one residual can say about the fit as a whole

struct Round {
  double gate;  // metres
  int iterations;
};
// Metres and radians a step: below, partners only change places.
constexpr double kConverged = 1e-4;
constexpr Round kRounds[] = {{0.30, 6}, {0.12, 6}, {0.05, 8}};

bool has_normal(const Eigen::Vector3f& normal) { return normal.squaredNorm() > 0.5F; }

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
  double chi2 = 0.0, trust = 0.0;  // whitened squares (clipped) and their weights
  int partners = 0;
  int candidates = 0;
};

// Brightness at a cell position and its slope, in grey levels and grey levels a cell.
bool sample(const cv::Mat& gray, float x, float y, float& value, Eigen::Vector2d& slope) {
  const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));
  if (x0 < 0 || y0 < 0 || x0 + 1 >= gray.cols || y0 + 1 >= gray.rows) return false;
  const float a = x - static_cast<float>(x0), b = y - static_cast<float>(y0);
  const float* upper = gray.ptr<float>(y0) + x0;
  const float* lower = gray.ptr<float>(y0 + 1) + x0;
  value = (1 - b) * ((1 - a) * upper[0] + a * upper[1]) + b * ((1 - a) * lower[0] + a * lower[1]);
  slope.x() = (1 - b) * (upper[1] - upper[0]) + b * (lower[1] - lower[0]);
  slope.y() = (1 - a) * (lower[0] - upper[0]) + a * (lower[1] - upper[1]);
  return true;
}

void add(const Vector6d& J, double r, double sigma, double trust, NormalEquations& sum) {
  const double whitened = std::abs(r) / sigma;
  const double weight = trust * (whitened > 2.0 ? 2.0 / whitened : 1.0) / (sigma * sigma);
  sum.chi2 += trust * std::min(whitened * whitened, kMaxChi2);
  sum.trust += trust;
  const Vector6d weighted = weight * J;
  sum.H.noalias() += weighted * J.transpose();
  sum.b.noalias() += r * weighted;
}

void add_brightness(const SurfaceGrid& from, const SurfaceGrid& to, std::size_t i,
                    const PinholeCamera& camera, const Eigen::Vector3d& p,
                    const Eigen::Vector2d& pixel, double trust, NormalEquations& sum) {
  float value = 0.0F;
  Eigen::Vector2d slope;
  const float x = static_cast<float>(pixel.x() + 0.5) / kSurfaceCell - 0.5F;
  const float y = static_cast<float>(pixel.y() + 0.5) / kSurfaceCell - 0.5F;
  if (!sample(from.gray, x, y, value, slope)) return;
  const Eigen::Vector2d g(slope.x() * camera.fx / kSurfaceCell,
                          slope.y() * camera.fy / kSurfaceCell);
  const Eigen::Vector3d d(g.x() / p.z(), g.y() / p.z(),
                          -(g.x() * p.x() + g.y() * p.y()) / (p.z() * p.z()));
  Vector6d J;
  J << d, p.cross(d);
  add(J, value - to.gray.ptr<float>()[i], kBrightnessSigma, trust, sum);
}

void accumulate(const SurfaceGrid& from, const SurfaceGrid& to, const PinholeCamera& camera,
                const RigidTransform& T, double gate, const AlignmentOptions& options,
                NormalEquations& total) {
  const Eigen::Matrix3d R = T.R;
  const Eigen::Vector3d t = T.t;
  NormalEquations sum;  // nobody else's, so that it need not be read again after each write
  const bool brightness = options.use_brightness && !from.gray.empty() && !to.gray.empty();
  for (int row = 0; row < to.height; row += options.step) {
    for (int column = 0; column < to.width; column += options.step) {
      const auto i = static_cast<std::size_t>(row * to.width + column);
      if (!has_normal(to.normals[i])) continue;
      const Eigen::Vector3d p = R * to.points[i].cast<double>() + t;
      if (p.z() <= kMinDepth) continue;
      const Eigen::Vector2d pixel = camera.project(p);
      if (!camera.contains(pixel)) continue;
      ++sum.candidates;
      const int x = std::min(static_cast<int>(pixel.x()) / kSurfaceCell, from.width - 1);
      const int y = std::min(static_cast<int>(pixel.y()) / kSurfaceCell, from.height - 1);
      const auto j = static_cast<std::size_t>(y * from.width + x);
      if (!has_normal(from.normals[j])) continue;
      const Eigen::Vector3d n = from.normals[j].cast<double>();
      const Eigen::Vector3d gap = p - from.points[j].cast<double>();
      if (gap.squaredNorm() > gate * gate) continue;
      if (n.dot(R * to.normals[i].cast<double>()) < kMinCosine) continue;
      const double trust = from.trust.empty() ? 1.0 : from.trust.at<float>(y, x);
      if (trust <= 0.0) continue;
      const double r = n.dot(gap);
      Vector6d J;
      J << n, p.cross(n);
      add(J, r, std::max(0.003, static_cast<double>(noise(to.points[i].z()))), trust, sum);
      if (brightness) add_brightness(from, to, i, camera, p, pixel, trust, sum);
      sum.squares += r * r;
      ++sum.partners;
    }
  }
  total = sum;
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
  const double distance = mean_distance(to);
  const int min_partners = kMinPartners / (options.step * options.step);
  NormalEquations last;
  for (const Round& round : kRounds) {
    if (round.gate > options.first_gate || round.gate < options.last_gate) continue;
    for (int i = 0; i < round.iterations; ++i) {
      accumulate(from, to, camera, result.T_from_to, round.gate, options, last);
      if (last.partners < min_partners) return std::nullopt;
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
  result.information = last.H / std::max(1.0, last.chi2 / std::max(1e-9, last.trust));
  result.overlap = static_cast<double>(last.partners) / std::max(1, last.candidates);
  result.rms = std::sqrt(last.squares / last.partners);
  if (result.overlap < options.min_overlap || result.rms > options.max_rms) return std::nullopt;
  return result;
}

}  // namespace dynslam::slam
