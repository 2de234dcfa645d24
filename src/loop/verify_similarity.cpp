// Rigid motion or similarity from points known on both sides: three-point RANSAC, Gauss-Newton.
#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include <Eigen/Cholesky>
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

class SimilaritySearch : public MotionSearch<SimilaritySearch, 3> {
 public:
  SimilaritySearch(const PointMatches& m, const PinholeCamera& query_camera,
                   const PinholeCamera& candidate_camera, bool with_scale,
                   const RansacOptions& options)
      : MotionSearch(m.query_points.cols(), options),
        m_(m),
        query_camera_(query_camera),
        candidate_camera_(candidate_camera),
        with_scale_(with_scale) {
    for (Index i = 0; i < m.query_points.cols(); ++i) {
      admit(i, m.query_points.col(i).allFinite() && m.query_pixels.col(i).allFinite() &&
                   m.candidate_points.col(i).allFinite() && m.candidate_pixels.col(i).allFinite());
    }
  }

  double error(const Motion& motion, Index i) const {
    const Vector3d y = motion * m_.query_points.col(i);
    const Vector3d x = back(motion, m_.candidate_points.col(i));
    if (!PinholeCamera::in_domain(y) || !PinholeCamera::in_domain(x)) return kFar;
    return std::max((candidate_camera_.project(y) - m_.candidate_pixels.col(i)).norm(),
                    (query_camera_.project(x) - m_.query_pixels.col(i)).norm());
  }

  template <typename Offer>
  void solve(const std::array<Index, 3>& chosen, Offer&& offer) const {
    Matrix3d from, to;
    for (Index k = 0; k < 3; ++k) {
      from.col(k) = m_.query_points.col(chosen[static_cast<std::size_t>(k)]);
      to.col(k) = m_.candidate_points.col(chosen[static_cast<std::size_t>(k)]);
    }
    // Three points in a line leave the turn about it open.
    const Vector3d a = from.col(1) - from.col(0), b = from.col(2) - from.col(0);
    if (!(a.cross(b).norm() > 1e-3 * a.norm() * b.norm())) return;
    offer(motion_between(from, to, with_scale_));
  }

  // Least squared reprojection errors in both images, over rho, omega and the scale's logarithm.
  Motion refine(Motion motion, const std::vector<Index>& inliers) const {
    using Vector7d = Eigen::Matrix<double, 7, 1>;
    using Matrix7d = Eigen::Matrix<double, 7, 7>;
    for (int round = 0; round < 5; ++round) {
      Matrix7d H = Matrix7d::Zero();
      Vector7d g = Vector7d::Zero();
      const auto add = [&](const Eigen::Matrix<double, 2, 7>& J, const Eigen::Vector2d& r) {
        H += J.transpose() * J;
        g += J.transpose() * r;
      };
      for (const Index i : inliers) {
        const Vector3d y = motion * m_.query_points.col(i);
        const Vector3d x = back(motion, m_.candidate_points.col(i));
        if (!PinholeCamera::in_domain(y) || !PinholeCamera::in_domain(x)) continue;
        Eigen::Matrix<double, 3, 7> dy, dx;
        dy << Matrix3d::Identity(), -skew(y), y - motion.T.t;
        add(candidate_camera_.project_jacobian(y) * dy,
            candidate_camera_.project(y) - m_.candidate_pixels.col(i));
        // x = (1/s) R' (exp(-rho, -omega) c - t), its s times e^sigma.
        const Matrix3d A = motion.T.R.transpose() / motion.scale;
        const Vector3d c = m_.candidate_points.col(i);
        dx << -A, A * skew(c), -A * (c - motion.T.t);
        add(query_camera_.project_jacobian(x) * dx,
            query_camera_.project(x) - m_.query_pixels.col(i));
      }
      if (!with_scale_) {
        H.row(6).setZero();
        H.col(6).setZero();
        H(6, 6) = 1.0;
        g(6) = 0.0;
      }
      const Vector7d step = -H.ldlt().solve(g);
      if (!step.allFinite()) break;
      // y -> exp(rho, omega) applied to s e^sigma R x + t.
      const RigidTransform turn = se3_exp(step.head<6>());
      motion.T = turn * motion.T;
      motion.scale *= std::exp(step(6));
      if (step.norm() < 1e-9) break;
    }
    motion.T = motion.T.normalized();
    return motion;
  }

 private:
  static Vector3d back(const Motion& motion, const Vector3d& y) {
    return motion.T.R.transpose() * (y - motion.T.t) / motion.scale;
  }

  const PointMatches& m_;
  PinholeCamera query_camera_, candidate_camera_;
  bool with_scale_;
};

}  // namespace

Verification verify_similarity(const PointMatches& matches, const PinholeCamera& query_camera,
                               const PinholeCamera& candidate_camera, bool with_scale,
                               const RansacOptions& options, MotionModel* model) {
  options.validate();
  query_camera.validate();
  candidate_camera.validate();
  const auto check = [&](const char* what, Index columns) {
    require(columns == matches.query_points.cols(), "verify_similarity", what, columns,
            std::to_string(matches.query_points.cols()) + " columns as query_points");
  };
  check("query_pixels", matches.query_pixels.cols());
  check("candidate_points", matches.candidate_points.cols());
  check("candidate_pixels", matches.candidate_pixels.cols());
  SimilaritySearch search(matches, query_camera, candidate_camera, with_scale, options);
  NullModel null;
  null.sample = 3;
  null.probability = std::max(disc_share(options.max_error, query_camera),
                              disc_share(options.max_error, candidate_camera));
  const auto places = [&](const std::vector<std::uint8_t>& flags) {
    return std::min(different_places(matches.query_pixels, flags),
                    different_places(matches.candidate_pixels, flags));
  };
  return conclude(search, places, null, options, false, model);
}

}  // namespace dynslam::loop
