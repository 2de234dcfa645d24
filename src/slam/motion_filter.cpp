#include "motion_filter.hpp"

#include <algorithm>
#include <cmath>

#include "matrix6.hpp"

namespace dynslam::slam {
namespace {

constexpr double kFirstSpeed = 1.0;      // m/s, before anything is known
constexpr double kFirstTurn = 2.0;       // rad/s
constexpr double kMostBriskness = 400;   // 20 m/s^2 and 40 rad/s^2
constexpr double kLearningRate = 0.2;    // of briskness: a few frames for a factor of two
constexpr double kStrongSurprise = 2.0;  // beyond it one frame does not count for more
constexpr double kSmallSurprise = 0.5;

Matrix6d diagonal(double rho, double omega) {
  Vector6d values;
  values << Eigen::Vector3d::Constant(rho), Eigen::Vector3d::Constant(omega);
  return values.asDiagonal();
}

Matrix6d symmetric(const Matrix6d& m) { return 0.5 * (m + m.transpose()); }

}  // namespace

void MotionFilter::predict(const RigidTransform& T_last_world, double dt) {
  predicted_ = moving_ && dt > 0.0;
  moving_ = false;
  if (!predicted_) return;
  const Matrix6d acceleration = briskness_ * diagonal(kHandAcceleration * kHandAcceleration,
                                                      kWristAcceleration * kWristAcceleration);
  const RigidTransform T_cam_last = se3_exp(dt * velocity_);
  const Matrix6d carry = se3_adjoint(T_cam_last);
  step_ = dt * dt * (velocity_covariance_ + 0.25 * dt * dt * acceleration);
  pose_step_ = dt * carry * cross_ + step_;
  velocity_step_ = dt * (velocity_covariance_ + 0.5 * dt * dt * acceleration);
  pose_ =
      symmetric(carry * pose_ * carry.transpose() + pose_step_ + pose_step_.transpose() - step_);
  cross_ = carry * cross_ + velocity_step_;
  velocity_covariance_ += dt * dt * acceleration;
  mean_ = (T_cam_last * T_last_world).normalized();
}

void MotionFilter::observe_step(const RigidTransform& T_cam_world, const Matrix6d& information) {
  const Vector6d off = se3_log(T_cam_world * mean_.inverse());
  // (D + R)^-1 for a measurement whose covariance R may be infinite in some directions.
  const Matrix6d weight = inverse_of(Matrix6d::Identity() + information * step_) * information;
  const Matrix6d pose_gain = pose_step_ * weight, velocity_gain = velocity_step_ * weight;
  mean_ = (se3_exp(pose_gain * off) * mean_).normalized();
  velocity_ += velocity_gain * off;
  pose_ = symmetric(pose_ - pose_gain * pose_step_.transpose());
  cross_ -= pose_gain * velocity_step_.transpose();
  velocity_covariance_ =
      symmetric(velocity_covariance_ - velocity_gain * velocity_step_.transpose());
}

factors::PosePrior MotionFilter::prior() const { return {mean_, symmetric(inverse_of(pose_))}; }

void MotionFilter::update(const RigidTransform& T_cam_world, const Matrix6d& covariance) {
  moving_ = true;
  if (!predicted_) {
    begin(covariance);
    return;
  }
  predicted_ = false;
  const Vector6d off = se3_log(T_cam_world * mean_.inverse());
  learn_briskness(off, covariance);
  const Matrix6d gain = cross_.transpose() * inverse_of(pose_);
  velocity_ += gain * off;
  velocity_covariance_ =
      symmetric(velocity_covariance_ - gain * (pose_ - covariance) * gain.transpose());
  cross_ = covariance * gain.transpose();
  pose_ = covariance;
}

void MotionFilter::begin(const Matrix6d& covariance) {
  briskness_ = 1.0;
  velocity_.setZero();
  pose_ = covariance;
  cross_.setZero();
  velocity_covariance_ = diagonal(kFirstSpeed * kFirstSpeed, kFirstTurn * kFirstTurn);
}

// The normalized innovation of the measurement alone is 1 on average if the noise is right.
void MotionFilter::learn_briskness(const Vector6d& off, const Matrix6d& covariance) {
  const Matrix6d expected = inverse_of(pose_), both = inverse_of(covariance);
  const Matrix6d measured = both - expected;
  const double surprise = off.dot(both * inverse_of(measured) * expected * off) / 6.0;
  if (!(surprise > 0.0) || !std::isfinite(surprise)) return;
  const double step = std::clamp(surprise, kSmallSurprise, kStrongSurprise);
  briskness_ = std::clamp(briskness_ * std::pow(step, kLearningRate), 1.0, kMostBriskness);
}

}  // namespace dynslam::slam
