// Where a camera that has mass can be, given how it moved.
#pragma once

#include <Eigen/Core>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/factors/pose_optimizer.hpp"

namespace dynslam::slam {

// What hands do to a camera without haste; MotionFilter finds out itself how far it is exceeded.
constexpr double kHandAcceleration = 1.0;   // m/s^2
constexpr double kWristAcceleration = 2.0;  // rad/s^2

/// Kalman filter over pose and twist under white acceleration.
///
/// The features of one frame leave some directions all but open (a sideways step looks like a
/// turn); what they say there jitters from frame to frame as no hand does. As a prior of the pose,
/// the motion so far settles these directions and leaves the others to the features. It also takes
/// more than a few frames of a mover's features to make a camera begin to move along.
///
/// Perturbations are left ones, [rho; omega] of T_cam_world. Metres: not for mono. A call costs a
/// few products of 6 x 6 matrices; not thread-safe.
class MotionFilter {
 public:
  /// Expects the camera `dt` seconds after the last update; `T_last_world` is the pose of that
  /// update, moved by whatever the map was corrected by since. Without an update between two
  /// predictions the motion is forgotten.
  void predict(const RigidTransform& T_last_world, double dt);
  /// Forgets all: the next update begins anew.
  void reset() { moving_ = predicted_ = false; }
  /// Takes a prediction back: the next update begins anew.
  void forget_prediction() { predicted_ = false; }
  /// Whether there is a prediction.
  bool predicted() const { return predicted_; }

  /// Takes in a pose that was measured relative to the last one, and therefore shares its error;
  /// `information` of the motion between may be singular. Call between predict and update.
  void observe_step(const RigidTransform& T_cam_world, const Matrix6d& information);

  /// The prediction; call only when there is one.
  factors::PosePrior prior() const;

  /// The pose as estimated under prior(), with the covariance of that estimate. Without a
  /// prediction it is where a motion begins.
  void update(const RigidTransform& T_cam_world, const Matrix6d& covariance);

 private:
  void begin(const Matrix6d& covariance);
  void learn_briskness(const Vector6d& off, const Matrix6d& covariance);

  bool moving_ = false, predicted_ = false;
  double briskness_ = 1.0;  // variance of acceleration over that of calm hands
  RigidTransform mean_;
  Vector6d velocity_ = Vector6d::Zero();  // twist of T_cam_last a second
  Matrix6d pose_, cross_, velocity_covariance_;
  Matrix6d step_, pose_step_, velocity_step_;  // covariances with the motion since the last update
};

}  // namespace dynslam::slam
