// Implementation of robust_pose.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

#include "dynslam/core/errors.hpp"
#include "dynslam/geometry/detail/rigid_refine.hpp"
#include "dynslam/geometry/detail/rigid_search.hpp"

namespace dynslam::geometry {

inline void RobustPoseOptions::validate() const {
  const char* me = "RobustPoseOptions";
  const auto positive = [me](double value, const char* name) {
    require(std::isfinite(value) && value > 0.0, me, name, value, "a positive number");
  };
  const auto not_negative = [me](double value, const char* name) {
    require(std::isfinite(value) && value >= 0.0, me, name, value, "a finite number >= 0");
  };
  require(max_hypotheses >= 1 && max_hypotheses <= 8, me, "max_hypotheses", max_hypotheses, "1..8");
  require(max_iterations >= 1, me, "max_iterations", max_iterations, "at least 1");
  require(confidence > 0.0 && confidence < 1.0, me, "confidence", confidence, "a number in (0, 1)");
  positive(pixel_threshold, "pixel_threshold");
  positive(depth_threshold, "depth_threshold");
  not_negative(depth_floor, "depth_floor");
  depth_noise.validate();
  require(min_inliers >= 4, me, "min_inliers", min_inliers, "at least 4");
  require(min_share >= 0.0 && min_share < 1.0, me, "min_share", min_share, "a number in [0, 1)");
  positive(separation, "separation");
  require(refinements >= 0, me, "refinements", refinements, "a number >= 0");
  not_negative(prior_weight, "prior_weight");
  not_negative(age_weight, "age_weight");
  not_negative(extent_weight, "extent_weight");
  not_negative(depth_weight, "depth_weight");
}

namespace detail {

inline void require_problem(const PoseProblem& problem, const PosePrior* prior) {
  const char* me = "estimate_pose";
  const std::size_t n = problem.world.size();
  require(problem.pixels.size() == n, me, "problem.pixels.size", problem.pixels.size(),
          std::to_string(n) + ", the number of map points");
  const auto check = [&](std::size_t size, const char* name) {
    require(size == 0 || size == n, me, std::string("problem.") + name + ".size", size,
            "0 or " + std::to_string(n) + ", the number of map points");
  };
  check(problem.depths.size(), "depths");
  check(problem.scales.size(), "scales");
  check(problem.weights.size(), "weights");
  check(problem.ages.size(), "ages");
  if (prior == nullptr) return;
  require(prior->T_cam_world.all_finite(), me, "prior.T_cam_world", "NaN or infinity",
          "a finite pose");
  require(prior->sigma_rotation > 0.0, me, "prior.sigma_rotation", prior->sigma_rotation,
          "a positive number");
  require(prior->sigma_translation > 0.0, me, "prior.sigma_translation", prior->sigma_translation,
          "a positive number");
}

/// Median distance in pixels between the images of the points under two poses.
inline double motion_difference(const PinholeCamera& camera, Span<const PosePoint> points,
                                const RigidTransform& a, const RigidTransform& b,
                                std::vector<double>& values) {
  values.clear();
  for (const PosePoint& point : points) {
    const Eigen::Vector3d Xa = a * point.world, Xb = b * point.world;
    if (!PinholeCamera::in_domain(Xa) || !PinholeCamera::in_domain(Xb)) continue;
    // Depth counts as the pixels by which a camera 0.1 m aside would see it move.
    const double depth = 0.1 * camera.fx * std::abs(1.0 / Xa.z() - 1.0 / Xb.z());
    values.push_back(std::max(depth, (camera.project(Xa) - camera.project(Xb)).norm()));
  }
  return median(values);
}

/// Spatial and temporal evidence about one hypothesis from the points that move with it.
inline void describe(const PinholeCamera& camera, Span<const PosePoint> points,
                     const PosePrior* prior, const RobustPoseOptions& o, double median_depth,
                     double mean_age, PoseHypothesis& h) {
  constexpr int kColumns = 8, kRows = 6;
  bool tiles[kColumns * kRows] = {};
  int at_border = 0, is_far = 0, with_depth = 0, used = 0;
  double weight = 0.0, all = 0.0, square = 0.0, age = 0.0;
  for (const PosePoint& point : points) {
    all += point.weight;
    const double error = point_error(camera, point, h.T_cam_world, o);
    if (!(error < 1.0)) continue;
    ++used;
    weight += point.weight;
    age += point.age;
    const Eigen::Vector2d residual = camera.project(h.T_cam_world * point.world) - point.pixel;
    square += residual.squaredNorm();
    const int x =
        std::clamp(static_cast<int>(point.pixel.x() * kColumns / camera.width), 0, kColumns - 1);
    const int y =
        std::clamp(static_cast<int>(point.pixel.y() * kRows / camera.height), 0, kRows - 1);
    tiles[y * kColumns + x] = true;
    if (x == 0 || y == 0 || x == kColumns - 1 || y == kRows - 1) ++at_border;
    if (point.depth > 0.0) ++with_depth;
    if (point.depth > median_depth) ++is_far;
  }
  h.inliers = used;
  h.support = all > 0.0 ? weight / all : 0.0;
  const double n = std::max(1, used);
  h.rms = std::sqrt(square / n);
  h.border = at_border / n;
  h.far_share = is_far / static_cast<double>(std::max(1, with_depth));
  h.age = mean_age > 0.0 ? age / n / mean_age : 0.0;
  h.extent =
      static_cast<double>(std::count(tiles, tiles + kColumns * kRows, true)) / (kColumns * kRows);
  if (prior == nullptr) return;
  const Vector6d xi = se3_log(h.T_cam_world * prior->T_cam_world.inverse());
  h.prior_distance =
      xi.head<3>().squaredNorm() / (prior->sigma_translation * prior->sigma_translation) +
      xi.tail<3>().squaredNorm() / (prior->sigma_rotation * prior->sigma_rotation);
}

inline double hypothesis_score(const PoseHypothesis& h, const RobustPoseOptions& o) {
  // The prior's term has the heavy tail of a Cauchy: far is far, however far.
  return h.support + o.extent_weight * (h.extent + 0.25 * h.border + 0.25 * h.far_share) +
         o.age_weight * 0.5 * std::min(h.age, 2.0) + o.depth_weight * h.depth_score -
         o.prior_weight * 0.5 * std::log1p(h.prior_distance / 6.0);
}

/// Takes the points that move with T and makes it a hypothesis, unless it is one already. False if
/// they are too few for a motion.
inline bool add_motion(const PinholeCamera& camera, const RobustPoseOptions& o, int needed,
                       const RigidTransform& T, RobustPoseWorkspace& w, RobustPoseResult& result) {
  const Span<const PosePoint> points = w.points;
  collect_inliers(camera, points, w.taken, T, o, w.inliers);
  if (static_cast<int>(w.inliers.size()) < needed) return false;
  for (const int i : w.inliers) w.taken[static_cast<std::size_t>(i)] = 1;
  const bool known =
      std::any_of(result.hypotheses.begin(), result.hypotheses.end(), [&](const PoseHypothesis& h) {
        return motion_difference(camera, points, h.T_cam_world, T, w.values) < o.separation;
      });
  if (known) return true;
  result.hypotheses.emplace_back();
  result.hypotheses.back().T_cam_world = T;
  return true;
}

/// Finds motions one after another among the points still free. The one that continues the prior
/// comes first: between two frames a sample can blend two motions into one that explains more
/// points than either, none of them well.
inline void find_motions(const PinholeCamera& camera, const PosePrior* prior,
                         const RobustPoseOptions& o, RobustPoseWorkspace& w,
                         RobustPoseResult& result) {
  const Span<const PosePoint> points = w.points;
  const int needed = std::max(
      o.min_inliers, static_cast<int>(std::ceil(o.min_share * static_cast<double>(points.size()))));
  Random random(o.seed);
  sampling_order(points, random, w.order);
  w.taken.assign(points.size(), 0);
  if (prior != nullptr) {
    RigidTransform T = prior->T_cam_world;
    refine_motion(camera, o, w, T);
    add_motion(camera, o, needed, T, w, result);
  }
  for (int attempt = 0; attempt < 2 * o.max_hypotheses; ++attempt) {
    if (static_cast<int>(result.hypotheses.size()) >= o.max_hypotheses) break;
    RigidTransform T;
    if (!search_motion(camera, prior, o, random, w, T)) break;
    refine_motion(camera, o, w, T);
    if (!add_motion(camera, o, needed, T, w, result)) break;
  }
}

/// Every point goes to the motion that explains it best.
inline void assign_points(const PinholeCamera& camera, const RobustPoseOptions& o,
                          const RobustPoseWorkspace& w, RobustPoseResult& result) {
  for (const PosePoint& point : w.points) {
    double best = 1.0;
    for (std::size_t h = 0; h < result.hypotheses.size(); ++h) {
      const double error = point_error(camera, point, result.hypotheses[h].T_cam_world, o);
      if (!(error < best)) continue;
      best = error;
      result.motion[static_cast<std::size_t>(point.index)] = static_cast<std::int8_t>(h);
    }
  }
}

inline void choose_motion(const RobustPoseOptions& o, RobustPoseResult& result) {
  int dominant = 0;
  const int n = static_cast<int>(result.hypotheses.size());
  for (int h = 0; h < n; ++h) {
    PoseHypothesis& hypothesis = result.hypotheses[static_cast<std::size_t>(h)];
    hypothesis.score = hypothesis_score(hypothesis, o);
    const auto& at = result.hypotheses;
    if (hypothesis.inliers > at[static_cast<std::size_t>(dominant)].inliers) dominant = h;
    if (result.chosen < 0 || hypothesis.score > at[static_cast<std::size_t>(result.chosen)].score) {
      result.chosen = h;
    }
  }
  const PoseHypothesis& chosen = result.hypotheses[static_cast<std::size_t>(result.chosen)];
  result.T_cam_world = chosen.T_cam_world;
  result.dominant_is_background = dominant == result.chosen;
  result.status = PoseStatus::kOk;
  for (int h = 0; h < n; ++h) {
    if (h == result.chosen) continue;
    const double score = result.hypotheses[static_cast<std::size_t>(h)].score;
    if (chosen.score - score < 0.1 * std::abs(chosen.score)) result.status = PoseStatus::kAmbiguous;
  }
}

}  // namespace detail

inline void estimate_pose(const PinholeCamera& camera, const PoseProblem& problem,
                          const PosePrior* prior, const DepthCheck& depth_check,
                          const RobustPoseOptions& options, RobustPoseWorkspace& w,
                          RobustPoseResult& result) {
  options.validate();
  camera.validate();
  detail::require_problem(problem, prior);
  result.status = PoseStatus::kTooFewPoints;
  result.T_cam_world = RigidTransform();
  result.chosen = -1;
  result.dominant_is_background = true;
  result.hypotheses.clear();
  result.motion.assign(problem.size(), -1);

  detail::gather_points(camera, problem, options, w.points);
  if (static_cast<int>(w.points.size()) < options.min_inliers) return;
  double mean_age = 0.0;
  int with_depth = 0;
  w.values.clear();
  for (const detail::PosePoint& point : w.points) {
    mean_age += point.age / static_cast<double>(w.points.size());
    if (point.depth <= 0.0) continue;
    ++with_depth;
    w.values.push_back(point.depth);
  }
  if (with_depth < 3 && prior == nullptr) return;
  const double median_depth = detail::median(w.values);

  result.status = PoseStatus::kNoConsensus;
  detail::find_motions(camera, prior, options, w, result);
  if (result.hypotheses.empty()) return;
  for (PoseHypothesis& h : result.hypotheses) {
    detail::describe(camera, w.points, prior, options, median_depth, mean_age, h);
    if (depth_check) {
      const double answer = depth_check(h.T_cam_world);
      h.depth_score = std::isfinite(answer) ? std::clamp(answer, 0.0, 1.0) : 0.0;
    }
  }
  detail::assign_points(camera, options, w, result);
  detail::choose_motion(options, result);
}

}  // namespace dynslam::geometry
