// Search for one rigid motion among points: sampling, minimal solution, scoring and refinement;
// a part of robust_pose.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/so3.hpp"
#include "dynslam/geometry/robust_pose.hpp"

namespace dynslam::geometry::detail {

/// The same numbers on every platform (SplitMix64, Steele, Lea and Flood, OOPSLA 2014).
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}

  std::uint64_t next() {
    std::uint64_t z = (state_ += 0x9e3779b97f4a7c15ULL);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
  }
  /// Uniform in 0 .. n - 1; the bias of the remainder is below n / 2^64.
  int below(int n) { return static_cast<int>(next() % static_cast<std::uint64_t>(n)); }

 private:
  std::uint64_t state_;
};

/// Median; 0 for none. Reorders the values.
inline double median(std::vector<double>& values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Usable points of a problem, ready to compute with.
inline void gather_points(const PinholeCamera& camera, const PoseProblem& problem,
                          const RobustPoseOptions& o, std::vector<PosePoint>& points) {
  points.clear();
  for (std::size_t i = 0; i < problem.size(); ++i) {
    PosePoint point;
    point.world = problem.world[i];
    point.pixel = problem.pixels[i].cast<double>();
    if (!point.world.allFinite() || !point.pixel.allFinite()) continue;
    point.index = static_cast<int>(i);
    const float depth = problem.depths.empty() ? 0.0F : problem.depths[i];
    point.depth = has_depth(depth) ? depth : 0.0;
    if (point.depth > 0.0) point.camera = camera.unproject(point.pixel, point.depth);
    const float weight = problem.weights.empty() ? 0.5F : problem.weights[i];
    point.weight = std::isnan(weight) ? 0.5 : std::clamp(static_cast<double>(weight), 0.0, 1.0);
    const float age = problem.ages.empty() ? 0.0F : problem.ages[i];
    point.age = std::isfinite(age) ? std::max(0.0F, age) : 0.0;
    const float scale = problem.scales.empty() ? 1.0F : problem.scales[i];
    point.pixel_limit = o.pixel_threshold * (scale > 0.0F && std::isfinite(scale) ? scale : 1.0);
    point.depth_limit = o.depth_threshold * o.depth_noise.sigma(point.depth) + o.depth_floor;
    points.push_back(point);
  }
}

/// Largest of image and depth error in units of their limits; < 1 is an inlier, infinity cannot be
/// seen from there.
inline double point_error(const PinholeCamera& camera, const PosePoint& point,
                          const RigidTransform& T_cam_world, const RobustPoseOptions& /*options*/) {
  const Eigen::Vector3d X = T_cam_world * point.world;
  if (!(X.z() > kMinDepth)) return std::numeric_limits<double>::infinity();
  const double image = (camera.project(X) - point.pixel).norm() / point.pixel_limit;
  if (point.depth <= 0.0) return image;
  return std::max(image, std::abs(X.z() - point.depth) / point.depth_limit);
}

/// Points with depth, heaviest first; equals in random order, so that samples do not cluster.
inline void sampling_order(Span<const PosePoint> points, Random& random, std::vector<int>& order) {
  order.clear();
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (points[i].depth > 0.0) order.push_back(static_cast<int>(i));
  }
  for (int i = static_cast<int>(order.size()) - 1; i > 0; --i) {
    std::swap(order[static_cast<std::size_t>(i)],
              order[static_cast<std::size_t>(random.below(i + 1))]);
  }
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return points[static_cast<std::size_t>(a)].weight > points[static_cast<std::size_t>(b)].weight;
  });
}

/// Axes of a triangle: along its first side, and its normal. False if it is close to a line.
inline bool triangle_axes(const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                          const Eigen::Vector3d& c, Eigen::Matrix3d& axes) {
  const Eigen::Vector3d side = b - a, normal = side.cross(c - a);
  const double length2 = side.squaredNorm();
  if (!(normal.squaredNorm() > 0.01 * length2 * (c - a).squaredNorm()) || !(length2 > 1e-4)) {
    return false;
  }
  axes.col(0) = side / std::sqrt(length2);
  axes.col(2) = normal.normalized();
  axes.col(1) = axes.col(2).cross(axes.col(0));
  return true;
}

/// Motion that lays three world points onto three camera points. False where sides differ in length
/// by more than the depths' noise allows, or the triangle is thin.
inline bool align_triangle(const PosePoint& a, const PosePoint& b, const PosePoint& c,
                           RigidTransform& T_cam_world) {
  const auto fits = [](const PosePoint& p, const PosePoint& q) {
    const double world = (p.world - q.world).norm(), camera = (p.camera - q.camera).norm();
    return std::abs(world - camera) <= p.depth_limit + q.depth_limit;
  };
  if (!fits(a, b) || !fits(b, c) || !fits(c, a)) return false;
  Eigen::Matrix3d from, to;
  if (!triangle_axes(a.world, b.world, c.world, from)) return false;
  if (!triangle_axes(a.camera, b.camera, c.camera, to)) return false;
  T_cam_world.R = to * from.transpose();
  T_cam_world.t = (a.camera + b.camera + c.camera) / 3.0 -
                  T_cam_world.R * ((a.world + b.world + c.world) / 3.0);
  return true;
}

/// Weighted truncated quadratic support of a pose (MSAC) and its number of inliers.
struct Support {
  double value = 0.0;
  int inliers = 0;
};

inline Support measure_support(const PinholeCamera& camera, Span<const PosePoint> points,
                               const std::vector<std::uint8_t>& taken,
                               const RigidTransform& T_cam_world, const RobustPoseOptions& o) {
  Support support;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (taken[i] != 0) continue;
    const double error = point_error(camera, points[i], T_cam_world, o);
    if (!(error < 1.0)) continue;
    ++support.inliers;
    support.value += (0.05 + points[i].weight) * (1.0 - error * error);
  }
  return support;
}

inline void collect_inliers(const PinholeCamera& camera, Span<const PosePoint> points,
                            const std::vector<std::uint8_t>& taken, const RigidTransform& T,
                            const RobustPoseOptions& o, std::vector<int>& inliers) {
  inliers.clear();
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (taken[i] == 0 && point_error(camera, points[i], T, o) < 1.0) {
      inliers.push_back(static_cast<int>(i));
    }
  }
}

/// Samples still needed to draw three inliers at once with the confidence asked for.
inline int samples_needed(int inliers, int points, double confidence, int most) {
  const double share = static_cast<double>(inliers) / std::max(1, points);
  const double good = share * share * share;
  if (good > 1.0 - 1e-9) return 1;
  if (good < 1e-9) return most;
  const double needed = std::ceil(std::log(1.0 - confidence) / std::log1p(-good));
  return needed < most ? std::max(1, static_cast<int>(needed)) : most;
}

/// PROSAC's growth of the set that samples are drawn from (Chum and Matas 2005, eqs. 3 to 5).
class ProsacGrowth {
 public:
  ProsacGrowth(int points, int samples) : points_(points) {
    expected_ = samples;
    for (int i = 0; i < 3; ++i) expected_ *= static_cast<double>(3 - i) / (points - i);
  }
  /// Size of the set for sample number `k` (from 1); `forced`: its last point must be taken.
  int size(int k, bool& forced) {
    while (k > until_ && n_ < points_) {
      const double next = expected_ * (n_ + 1) / (n_ + 1 - 3);
      until_ += std::max(1, static_cast<int>(std::ceil(next - expected_)));
      expected_ = next;
      ++n_;
    }
    forced = k <= until_;
    return n_;
  }

 private:
  int points_;
  int n_ = 3;
  int until_ = 1;
  double expected_ = 1.0;
};

/// Best motion among the points that are not taken. False if there is none.
inline bool search_motion(const PinholeCamera& camera, const PosePrior* prior,
                          const RobustPoseOptions& o, Random& random, RobustPoseWorkspace& w,
                          RigidTransform& best_pose) {
  const Span<const PosePoint> points = w.points;
  w.active.clear();
  for (const int i : w.order) {
    if (w.taken[static_cast<std::size_t>(i)] == 0) w.active.push_back(i);
  }
  int left = 0;
  for (const std::uint8_t taken : w.taken) left += taken == 0 ? 1 : 0;
  Support best;
  const auto consider = [&](const RigidTransform& T) {
    const Support support = measure_support(camera, points, w.taken, T, o);
    if (support.value <= best.value) return;
    best = support;
    best_pose = T;
  };
  if (prior != nullptr) consider(prior->T_cam_world);
  const int n = static_cast<int>(w.active.size());
  if (n >= 3) {
    ProsacGrowth growth(n, o.max_iterations);
    // A sample that fails the test of its sides costs little and counts a tenth.
    int scored = 0;
    for (int k = 1; k <= 10 * o.max_iterations && scored < o.max_iterations; ++k) {
      bool forced = false;
      const int size = growth.size(k, forced);
      int s[3];
      s[2] = forced ? size - 1 : random.below(size);
      do s[0] = random.below(size);
      while (s[0] == s[2]);
      do s[1] = random.below(size);
      while (s[1] == s[2] || s[1] == s[0]);
      const auto at = [&](int i) -> const PosePoint& {
        return points[static_cast<std::size_t>(w.active[static_cast<std::size_t>(s[i])])];
      };
      RigidTransform T;
      if (!align_triangle(at(0), at(1), at(2), T)) continue;
      ++scored;
      consider(T);
      // At least a few more than strictly needed: the first sample is seldom the most exact.
      if (scored >= 20 &&
          scored >= samples_needed(best.inliers, left, o.confidence, o.max_iterations)) {
        break;
      }
    }
  }
  return best.inliers >= 4;
}

}  // namespace dynslam::geometry::detail
