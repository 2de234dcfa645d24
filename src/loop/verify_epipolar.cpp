// Fundamental matrix by seven-point RANSAC with local optimization.
#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/QR>

#include "dynslam/core/errors.hpp"
#include "dynslam/loop/verification.hpp"

#include "ransac.hpp"

namespace dynslam::loop {
namespace {

using Eigen::Index;
using Eigen::Matrix3d;
using Row9 = Eigen::Matrix<double, 1, 9>;

// Real roots of c3 x^3 + c2 x^2 + c1 x + c0.
int solve_cubic(double c3, double c2, double c1, double c0, std::array<double, 3>& roots) {
  const double size = std::max({std::abs(c3), std::abs(c2), std::abs(c1), std::abs(c0)});
  if (!(size > 0.0)) return 0;
  if (std::abs(c3) < 1e-12 * size) {
    if (std::abs(c2) < 1e-12 * size) {
      if (std::abs(c1) < 1e-12 * size) return 0;
      roots[0] = -c0 / c1;
      return 1;
    }
    const double d = c1 * c1 - 4.0 * c2 * c0;
    if (d < 0.0) return 0;
    const double q = -0.5 * (c1 + std::copysign(std::sqrt(d), c1));
    roots[0] = q / c2;
    if (q == 0.0) return 1;
    roots[1] = c0 / q;
    return 2;
  }
  const double a = c2 / c3, b = c1 / c3, c = c0 / c3;
  const double q = (a * a - 3.0 * b) / 9.0;
  const double r = (2.0 * a * a * a - 9.0 * a * b + 27.0 * c) / 54.0;
  if (r * r < q * q * q) {
    const double theta = std::acos(std::clamp(r / std::sqrt(q * q * q), -1.0, 1.0));
    constexpr double kTurn = 2.0943951023931953;  // a third of a turn
    for (int i = 0; i < 3; ++i)
      roots[static_cast<std::size_t>(i)] =
          -2.0 * std::sqrt(q) * std::cos(theta / 3.0 + kTurn * i) - a / 3.0;
    return 3;
  }
  const double s =
      -std::copysign(std::cbrt(std::abs(r) + std::sqrt(std::max(0.0, r * r - q * q * q))), r);
  roots[0] = s + (s == 0.0 ? 0.0 : q / s) - a / 3.0;
  return 1;
}

// Matches in coordinates that are about 1 (Hartley 1997).
struct Normalized {
  Eigen::Matrix3Xd query, candidate;  // homogeneous
  Matrix3d T_query, T_candidate;      // pixels to normalized
  std::vector<std::uint8_t> usable;   // finite

  Row9 row(Index i) const {
    const Matrix3d outer = candidate.col(i) * query.col(i).transpose();
    Row9 row;
    row << outer.row(0), outer.row(1), outer.row(2);
    return row;
  }
};

Matrix3d matrix_of(const Eigen::Matrix<double, 9, 1>& f) {
  Matrix3d F;
  F << f(0), f(1), f(2), f(3), f(4), f(5), f(6), f(7), f(8);
  return F;
}

class Search {
 public:
  Search(const Points2d& query, const Points2d& candidate, int width, int height,
         const RansacOptions& options)
      : n_(static_cast<std::size_t>(query.cols())), options_(options) {
    // Normalizing by the image instead of by the points keeps the outliers out of it.
    const double s = 2.0 / std::max(width, height);
    Matrix3d T;
    T << s, 0.0, -0.5 * s * width, 0.0, s, -0.5 * s * height, 0.0, 0.0, 1.0;
    m_.T_query = m_.T_candidate = T;
    m_.query.resize(3, query.cols());
    m_.candidate.resize(3, query.cols());
    for (Index i = 0; i < query.cols(); ++i) {
      m_.query.col(i) = T * query.col(i).homogeneous();
      m_.candidate.col(i) = T * candidate.col(i).homogeneous();
      m_.usable.push_back(m_.query.col(i).allFinite() && m_.candidate.col(i).allFinite());
      if (m_.usable.back() != 0) pool_.push_back(i);
    }
    const double e = options.max_error * s;
    max_squared_ = e * e;
  }

  void run() {
    Random random(options_.seed);
    int needed = options_.max_iterations;
    for (int i = 0; i < needed && pool_.size() >= 7; ++i) {
      const auto chosen = random.sample<7>(static_cast<std::uint32_t>(pool_.size()));
      Eigen::Matrix<double, 9, 7> A;
      for (std::size_t k = 0; k < 7; ++k)
        A.col(static_cast<Index>(k)) = m_.row(pool_[chosen[k]]).transpose();
      if (try_sample(A)) needed = iterations_needed(best_count_, pool_.size(), 7, options_);
    }
  }

  std::vector<std::uint8_t> inliers() const { return flags(best_); }
  std::size_t count() const { return best_count_; }
  const std::vector<std::uint8_t>& usable() const { return m_.usable; }
  Matrix3d pixel_F() const {
    Matrix3d F = m_.T_candidate.transpose() * best_ * m_.T_query;
    const double norm = F.norm();
    if (norm > 0.0) F /= norm;
    return F;
  }

 private:
  bool try_sample(const Eigen::Matrix<double, 9, 7>& A) {
    const Eigen::HouseholderQR<Eigen::Matrix<double, 9, 7>> qr(A);
    Eigen::Matrix<double, 9, 2> null = Eigen::Matrix<double, 9, 2>::Zero();
    null(7, 0) = null(8, 1) = 1.0;
    null.applyOnTheLeft(qr.householderQ());
    const Matrix3d F1 = matrix_of(null.col(0)), F2 = matrix_of(null.col(1));
    // det(x F1 + (1 - x) F2) from four of its values.
    const auto det = [&](double x) { return (x * F1 + (1.0 - x) * F2).determinant(); };
    const double d0 = det(0.0), d1 = det(1.0), dm = det(-1.0), d2 = det(2.0);
    const double c2 = 0.5 * (d1 + dm) - d0;
    const double c3 = (d2 - 2.0 * d1 + d0 - 2.0 * c2) / 6.0;
    const double c1 = d1 - d0 - c2 - c3;
    std::array<double, 3> roots = {};
    const int count = solve_cubic(c3, c2, c1, d0, roots);
    bool better = false;
    for (int r = 0; r < count; ++r) {
      const double x = roots[static_cast<std::size_t>(r)];
      better = offer(x * F1 + (1.0 - x) * F2) || better;
    }
    return better;
  }

  bool offer(const Matrix3d& F) {
    const std::size_t found = count_inliers(F);
    if (found <= best_count_ || found < 8) {
      if (found > best_count_) best_ = F, best_count_ = found;
      return false;
    }
    best_ = F;
    best_count_ = found;
    for (int round = 0; round < 4; ++round) {
      const Matrix3d refined = refit(best_);
      const std::size_t now = count_inliers(refined);
      if (now < best_count_) break;
      const bool same = now == best_count_;
      best_ = refined;
      best_count_ = now;
      if (same) break;
    }
    return true;
  }

  double squared_error(const Matrix3d& F, Index i) const {
    const Eigen::Vector3d line = F * m_.query.col(i);
    const Eigen::Vector3d back = F.transpose() * m_.candidate.col(i);
    const double e = m_.candidate.col(i).dot(line);
    const double least = std::min(line.head<2>().squaredNorm(), back.head<2>().squaredNorm());
    return e * e / least;  // NaN and infinity are no inliers
  }

  std::size_t count_inliers(const Matrix3d& F) const {
    std::size_t count = 0;
    for (const Index i : pool_) count += squared_error(F, i) <= max_squared_ ? 1U : 0U;
    return count;
  }

  std::vector<std::uint8_t> flags(const Matrix3d& F) const {
    std::vector<std::uint8_t> result(n_, 0);
    for (const Index i : pool_)
      result[static_cast<std::size_t>(i)] = squared_error(F, i) <= max_squared_ ? 1 : 0;
    return result;
  }

  // Eight-point algorithm over the inliers of F, rank two enforced.
  Matrix3d refit(const Matrix3d& F) const {
    Eigen::Matrix<double, 9, 9> normal = Eigen::Matrix<double, 9, 9>::Zero();
    for (const Index i : pool_) {
      if (!(squared_error(F, i) <= max_squared_)) continue;
      const Row9 row = m_.row(i);
      normal.selfadjointView<Eigen::Lower>().rankUpdate(row.transpose());
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 9, 9>> solver(normal);
    const Matrix3d full = matrix_of(solver.eigenvectors().col(0));
    // Without the direction of its least singular value a matrix is the nearest one of rank two.
    const Eigen::SelfAdjointEigenSolver<Matrix3d> of_square(full.transpose() * full);
    const Eigen::Vector3d least = of_square.eigenvectors().col(0);
    return full - full * least * least.transpose();
  }

  std::size_t n_;
  RansacOptions options_;
  Normalized m_;
  std::vector<Index> pool_;
  double max_squared_ = 0.0;
  Matrix3d best_ = Matrix3d::Zero();
  std::size_t best_count_ = 0;
};

}  // namespace

void RansacOptions::validate() const {
  require(std::isfinite(max_error) && max_error > 0.0, "RansacOptions", "max_error", max_error,
          "a positive number of pixels");
  require(min_inliers >= 4, "RansacOptions", "min_inliers", min_inliers, "at least 4");
  require(std::isfinite(min_significance) && min_significance >= 0.0, "RansacOptions",
          "min_significance", min_significance, "a number >= 0");
  require(max_iterations >= 1, "RansacOptions", "max_iterations", max_iterations, "at least 1");
  require(confidence > 0.0 && confidence < 1.0, "RansacOptions", "confidence", confidence,
          "a probability in (0, 1)");
}

Verification verify_epipolar(const Points2d& query, const Points2d& candidate, int image_width,
                             int image_height, const RansacOptions& options, EpipolarModel* model) {
  options.validate();
  require(options.min_inliers >= 8, "verify_epipolar", "min_inliers", options.min_inliers,
          "at least 8");
  require(query.cols() == candidate.cols(), "verify_epipolar", "candidate columns",
          candidate.cols(), std::to_string(query.cols()) + " as of the query");
  require(image_width > 0, "verify_epipolar", "image_width", image_width, "at least 1 pixel");
  require(image_height > 0, "verify_epipolar", "image_height", image_height, "at least 1 pixel");
  Search search(query, candidate, image_width, image_height, options);
  const auto places = [&](const std::vector<std::uint8_t>& flags) {
    return std::min(different_places(query, flags), different_places(candidate, flags));
  };
  Verification result;
  result.matches = places(search.usable());
  if (model != nullptr) {
    model->F.setZero();
    model->inliers.assign(static_cast<std::size_t>(query.cols()), 0);
  }
  if (result.matches < options.min_inliers) {
    result.verdict = Verdict::kFewMatches;
    return result;
  }
  search.run();
  const std::vector<std::uint8_t> inliers = search.inliers();
  const double width = image_width, height = image_height;
  NullModel null;
  null.sample = 7;
  null.solutions = 3.0;
  // A line of the diagonal's length, max_error to both sides of it.
  null.probability = 2.0 * options.max_error * std::hypot(width, height) / (width * height);
  judge(result, result.matches, std::min(places(inliers), result.matches), null, options);
  if (model != nullptr) {
    model->F = search.pixel_F();
    model->inliers = inliers;
  }
  return result;
}

}  // namespace dynslam::loop
