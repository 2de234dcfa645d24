// Camera pose from points and their pixels: P3P RANSAC and Gauss-Newton.
#include <array>
#include <cmath>
#include <string>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/so3.hpp"
#include "dynslam/loop/verification.hpp"

#include "motion_search.hpp"
#include "ransac.hpp"

namespace dynslam::loop {
namespace {

using Eigen::Index;
using Eigen::Matrix3d;
using Eigen::Vector3d;

// Real roots of c[4] x^4 + ... + c[0], as eigenvalues of the companion matrix. It is a Hessenberg
// matrix as it stands, which spares the compiler the reduction to one.
int solve_quartic(const std::array<double, 5>& c, std::array<double, 4>& roots) {
  if (!(std::abs(c[4]) > 1e-12)) return 0;
  Eigen::Matrix4d companion = Eigen::Matrix4d::Zero();
  companion(1, 0) = companion(2, 1) = companion(3, 2) = 1.0;
  for (Index i = 0; i < 4; ++i) companion(i, 3) = -c[static_cast<std::size_t>(i)] / c[4];
  if (!companion.allFinite()) return 0;
  const double scale = companion.cwiseAbs().maxCoeff();
  companion /= scale;
  Eigen::RealSchur<Eigen::Matrix4d> schur;
  schur.computeFromHessenberg(companion, companion, false);
  if (schur.info() != Eigen::Success) return 0;
  const Eigen::Matrix4d T = scale * schur.matrixT();
  std::size_t count = 0;
  for (Index i = 0; i < 4; ++i) {
    double real = T(i, i), imaginary = 0.0;
    if (i < 3 && T(i + 1, i) != 0.0) {  // two conjugate roots
      const double half = 0.5 * (T(i, i) - T(i + 1, i + 1));
      real = T(i + 1, i + 1) + half;
      imaginary = std::sqrt(std::abs(half * half + T(i + 1, i) * T(i, i + 1)));
      ++i;
    }
    if (imaginary < 1e-4 * (1.0 + std::abs(real))) roots[count++] = real;
  }
  return static_cast<int>(count);
}

class PoseSearch : public MotionSearch<PoseSearch, 3> {
 public:
  PoseSearch(const Points3d& points, const Points2d& pixels, const PinholeCamera& camera,
             const RansacOptions& options)
      : MotionSearch(points.cols(), options), points_(points), pixels_(pixels), camera_(camera) {
    for (Index i = 0; i < points.cols(); ++i)
      admit(i, points.col(i).allFinite() && pixels.col(i).allFinite());
  }

  double error(const Motion& motion, Index i) const {
    const Vector3d X = motion.T * points_.col(i);
    if (!PinholeCamera::in_domain(X)) return kFar;
    return (camera_.project(X) - pixels_.col(i)).norm();
  }

  // Grunert's solution in the notation of Haralick et al.: s1, s2 = u s1, s3 = v s1 are the
  // distances of the points from the camera; a, b, c the sides opposite to them.
  template <typename Offer>
  void solve(const std::array<Index, 3>& chosen, Offer&& offer) const {
    std::array<Vector3d, 3> P, f;
    for (std::size_t i = 0; i < 3; ++i) {
      P[i] = points_.col(chosen[i]);
      f[i] = camera_.bearing(pixels_.col(chosen[i])).normalized();
    }
    const double a2 = (P[1] - P[2]).squaredNorm(), b2 = (P[0] - P[2]).squaredNorm(),
                 c2 = (P[0] - P[1]).squaredNorm();
    if (!(a2 > 1e-12 && b2 > 1e-12 && c2 > 1e-12)) return;
    const double ca = f[1].dot(f[2]), cb = f[0].dot(f[2]), cg = f[0].dot(f[1]);
    const double m = (a2 - c2) / b2, p = (a2 + c2) / b2, q = c2 / b2;
    const std::array<double, 5> c = {
        (1 + m) * (1 + m) - 4 * (a2 / b2) * cg * cg,
        4 * (-m * (1 + m) * cb + 2 * (a2 / b2) * cg * cg * cb - (1 - p) * ca * cg),
        2 * (m * m - 1 + 2 * m * m * cb * cb + 2 * ((b2 - c2) / b2) * ca * ca -
             4 * p * ca * cb * cg + 2 * ((b2 - a2) / b2) * cg * cg),
        4 * (m * (1 - m) * cb - (1 - p) * ca * cg + 2 * q * ca * ca * cb),
        (m - 1) * (m - 1) - 4 * q * ca * ca};
    std::array<double, 4> roots = {};
    const int count = solve_quartic(c, roots);
    for (int r = 0; r < count; ++r) {
      const double v = roots[static_cast<std::size_t>(r)];
      const double below = 2 * (cg - v * ca), s = 1 + v * v - 2 * v * cb;
      if (!(v > 0.0) || std::abs(below) < 1e-9 || !(s > 0.0)) continue;
      const double u = ((m - 1) * v * v - 2 * m * cb * v + 1 + m) / below;
      if (!(u > 0.0)) continue;
      const double s1 = std::sqrt(b2 / s);
      Eigen::Matrix3d from, to;
      from << P[0], P[1], P[2];
      to << s1 * f[0], u * s1 * f[1], v * s1 * f[2];
      offer(motion_between(from, to, false));
    }
  }

  Motion refine(Motion motion, const std::vector<Index>& inliers) const {
    for (int round = 0; round < 5; ++round) {
      Matrix6d H = Matrix6d::Zero();
      Vector6d g = Vector6d::Zero();
      for (const Index i : inliers) {
        const Vector3d X = motion.T * points_.col(i);
        if (!PinholeCamera::in_domain(X)) continue;
        Eigen::Matrix<double, 3, 6> dX;
        dX << Matrix3d::Identity(), -skew(X);
        const Eigen::Matrix<double, 2, 6> J = camera_.project_jacobian(X) * dX;
        H += J.transpose() * J;
        g += J.transpose() * (camera_.project(X) - pixels_.col(i));
      }
      const Vector6d step = -H.ldlt().solve(g);
      if (!step.allFinite()) break;
      motion.T = se3_exp(step) * motion.T;
      if (step.norm() < 1e-9) break;
    }
    motion.T = motion.T.normalized();
    return motion;
  }

 private:
  const Points3d& points_;
  const Points2d& pixels_;
  PinholeCamera camera_;
};

}  // namespace

Verification verify_pose(const Points3d& candidate_points, const Points2d& query_pixels,
                         const PinholeCamera& query_camera, const RansacOptions& options,
                         MotionModel* model) {
  options.validate();
  query_camera.validate();
  require(candidate_points.cols() == query_pixels.cols(), "verify_pose", "query_pixels columns",
          query_pixels.cols(), std::to_string(candidate_points.cols()) + " as of the points");
  PoseSearch search(candidate_points, query_pixels, query_camera, options);
  NullModel null;
  null.sample = 3;
  null.solutions = 4.0;
  null.probability = disc_share(options.max_error, query_camera);
  const auto places = [&](const std::vector<std::uint8_t>& flags) {
    return different_places(query_pixels, flags);
  };
  // The search moves the candidate's points to the query's camera.
  return conclude(search, places, null, options, true, model);
}

}  // namespace dynslam::loop
