#include "dynslam/evaluation/alignment.hpp"

#include <string>

#include <Eigen/SVD>

#include "dynslam/core/errors.hpp"

namespace dynslam::evaluation {
namespace {

constexpr double kCollinearRatio = 1e-10;
constexpr double kNoExtentRatio = 1e-12;

// Means, variance and covariance of associated points.
struct Moments {
  Eigen::Vector3d mean_truth = Eigen::Vector3d::Zero();
  Eigen::Vector3d mean_estimate = Eigen::Vector3d::Zero();
  double variance_truth = 0.0;
  double variance_estimate = 0.0;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
};

Moments moments(const Points3d& truth, const Points3d& estimate) {
  Moments m;
  const double n = static_cast<double>(truth.cols());
  m.mean_truth = truth.rowwise().sum() / n;
  m.mean_estimate = estimate.rowwise().sum() / n;
  for (Eigen::Index i = 0; i < truth.cols(); ++i) {
    const Eigen::Vector3d a = truth.col(i) - m.mean_truth;
    const Eigen::Vector3d b = estimate.col(i) - m.mean_estimate;
    m.variance_truth += a.squaredNorm();
    m.variance_estimate += b.squaredNorm();
    m.covariance.noalias() += a * b.transpose();
  }
  m.variance_truth /= n;
  m.variance_estimate /= n;
  m.covariance /= n;
  return m;
}

// All points are one point up to rounding, which grows with the distance from the origin.
bool no_extent(double variance, const Points3d& points) {
  return variance <= kNoExtentRatio * kNoExtentRatio * points.colwise().squaredNorm().maxCoeff();
}

}  // namespace

std::string_view to_string(Alignment alignment) {
  switch (alignment) {
    case Alignment::kNone:
      return "none";
    case Alignment::kSE3:
      return "se3";
    case Alignment::kSim3:
      return "sim3";
  }
  return "?";
}

std::string_view to_string(AlignmentStatus status) {
  switch (status) {
    case AlignmentStatus::kOk:
      return "ok";
    case AlignmentStatus::kNotAsked:
      return "not asked";
    case AlignmentStatus::kNoPoints:
      return "no points";
    case AlignmentStatus::kNoExtent:
      return "no extent: translation only";
    case AlignmentStatus::kCollinear:
      return "straight line: rotation about it is free";
  }
  return "?";
}

AlignmentResult align_points(const Points3d& truth, const Points3d& estimate, Alignment alignment) {
  require(truth.cols() == estimate.cols(), "align_points", "estimate", estimate.cols(),
          "as many points as truth has, " + std::to_string(truth.cols()));
  require(truth.allFinite(), "align_points", "truth", "NaN or infinity", "finite points");
  require(estimate.allFinite(), "align_points", "estimate", "NaN or infinity", "finite points");
  AlignmentResult result;
  if (alignment == Alignment::kNone) return result;
  result.points = static_cast<std::size_t>(truth.cols());
  result.status = AlignmentStatus::kNoPoints;
  if (truth.cols() == 0) return result;

  const Moments m = moments(truth, estimate);
  Similarity& S = result.truth_from_estimate;
  const Eigen::JacobiSVD<Eigen::Matrix3d, Eigen::NoQRPreconditioner> svd(
      m.covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Vector3d& d = svd.singularValues();
  Eigen::Vector3d F = Eigen::Vector3d::Ones();
  if (no_extent(m.variance_truth, truth) || no_extent(m.variance_estimate, estimate) ||
      d(0) <= kNoExtentRatio * std::sqrt(m.variance_truth * m.variance_estimate)) {
    result.status = AlignmentStatus::kNoExtent;
  } else if (d(1) <= kCollinearRatio * d(0)) {
    result.status = AlignmentStatus::kCollinear;
    F = {1.0, 0.0, 0.0};
    S.T.R = Eigen::Quaterniond::FromTwoVectors(svd.matrixV().col(0), svd.matrixU().col(0))
                .toRotationMatrix();
  } else {
    result.status = AlignmentStatus::kOk;
    F(2) = svd.matrixU().determinant() * svd.matrixV().determinant() < 0.0 ? -1.0 : 1.0;
    S.T.R = svd.matrixU() * F.asDiagonal() * svd.matrixV().transpose();
  }
  if (alignment == Alignment::kSim3 && result.status != AlignmentStatus::kNoExtent) {
    S.scale = d.dot(F) / m.variance_estimate;
  }
  S.T.t = m.mean_truth - S.scale * (S.T.R * m.mean_estimate);
  return result;
}

Trajectory transform(Span<const StampedPose> estimate, const Similarity& truth_from_estimate) {
  Trajectory result;
  result.reserve(estimate.size());
  for (const StampedPose& pose : estimate) {
    result.push_back({pose.timestamp, truth_from_estimate * pose.T_world_cam});
  }
  return result;
}

}  // namespace dynslam::evaluation
