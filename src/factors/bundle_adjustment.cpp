#include "dynslam/factors/bundle_adjustment.hpp"

#include <cmath>

#include "dynslam/core/errors.hpp"

#include "factors/ceres_routes.hpp"
#include "factors/schur_solver.hpp"

namespace dynslam::factors {
namespace {

constexpr const char* kOptimizeBundle = "optimize_bundle";

void check_output(std::size_t got, std::size_t expected, const char* name) {
  require(got == 0 || got == expected, kOptimizeBundle, name, got,
          "as many as observations, or none");
}

void check(const BundleProblem& problem, const BundleOptions& options) {
  options.validate();
  problem.camera.validate();
  const std::size_t keyframes = problem.T_cam_world.size(), points = problem.points_world.size();
  require(problem.keyframe_fixed.empty() || problem.keyframe_fixed.size() == keyframes,
          kOptimizeBundle, "keyframe_fixed", problem.keyframe_fixed.size(),
          "as many as T_cam_world, or none");
  require(problem.point_fixed.empty() || problem.point_fixed.size() == points, kOptimizeBundle,
          "point_fixed", problem.point_fixed.size(), "as many as points_world, or none");
  const std::size_t n = problem.observations.size();
  check_output(problem.inliers.size(), n, "inliers");
  check_output(problem.weights.size(), n, "weights");
  check_output(problem.squared_residuals.size(), n, "squared_residuals");
  for (const RigidTransform& T : problem.T_cam_world) {
    require(T.all_finite(), kOptimizeBundle, "T_cam_world", "NaN or infinity", "finite poses");
    const double off = (T.R.transpose() * T.R - Eigen::Matrix3d::Identity()).norm();
    require(off < 1e-3 && T.R.determinant() > 0.0, kOptimizeBundle, "T_cam_world.R",
            "a matrix that is not a rotation", "a rotation");
  }
  for (const BundleObservation& o : problem.observations) {
    require(o.keyframe < keyframes, kOptimizeBundle, "observations.keyframe", o.keyframe,
            "an index into T_cam_world");
    require(o.point < points, kOptimizeBundle, "observations.point", o.point,
            "an index into points_world");
    require(!(o.weight < 0.0F) && !(o.weight > 1.0F), kOptimizeBundle, "observations.weight",
            o.weight, "a static weight in [0, 1]");
    require(!(o.inverse_sigma < 0.0F), kOptimizeBundle, "observations.inverse_sigma",
            o.inverse_sigma, "1/sigma >= 0");
  }
}

}  // namespace

void BundleOptions::validate() const {
  const char* where = "BundleOptions";
  require(std::isfinite(lambda) && lambda > 0.0, where, "lambda", lambda, "a positive number");
  loss.validate();
  require(max_iterations >= 1, where, "max_iterations", max_iterations, "at least 1");
  require(chi2_mono > 0.0, where, "chi2_mono", chi2_mono, "a positive number");
  require(chi2_depth > 0.0, where, "chi2_depth", chi2_depth, "a positive number");
  require(cost_tolerance >= 0.0, where, "cost_tolerance", cost_tolerance, "a number >= 0");
  require(std::isfinite(initial_damping) && initial_damping > 0.0, where, "initial_damping",
          initial_damping, "a positive number");
  require(ceres_dense_keyframes >= 0, where, "ceres_dense_keyframes", ceres_dense_keyframes,
          "a number >= 0");
}

struct BundleWorkspace::Impl {
  SchurSolver solver;
};

BundleWorkspace::BundleWorkspace() : impl_(std::make_unique<Impl>()) {}
BundleWorkspace::~BundleWorkspace() = default;
BundleWorkspace::BundleWorkspace(BundleWorkspace&&) noexcept = default;
BundleWorkspace& BundleWorkspace::operator=(BundleWorkspace&&) noexcept = default;

BundleSummary optimize_bundle(const BundleProblem& problem, const BundleOptions& options,
                              BundleWorkspace* workspace) {
  check(problem, options);
  if (options.solver == BundleSolver::kCeres) {
    require(has_ceres(), kOptimizeBundle, "options.solver", "kCeres in a build without Ceres",
            "kSchur");
    return optimize_bundle_with_ceres(problem, options);
  }
  if (workspace) return workspace->impl().solver.run(problem, options);
  SchurSolver solver;
  return solver.run(problem, options);
}

}  // namespace dynslam::factors
