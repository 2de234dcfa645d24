#include "scene_motion.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

#include "scene_random.hpp"

namespace dynslam::dataset::scene {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kPi = 3.14159265358979323846;
constexpr double kDegree = kPi / 180.0;

// Where the camera hovers (metres), and how it looks: slightly down.
constexpr double kHomeX = 0.0, kHomeY = -1.45, kHomeZ = 1.35, kHomePitch = -7.0 * kDegree;
// The middle of the circle that kRound goes (metres), and how long a turn takes (seconds).
constexpr double kRoundY = -0.8, kRoundRadius = 0.5, kRoundPeriod = 20.0;

Eigen::Matrix3d turn_y(double angle) {
  return Eigen::AngleAxisd(angle, Vector3d::UnitY()).toRotationMatrix();
}
Eigen::Matrix3d turn_z(double angle) {
  return Eigen::AngleAxisd(angle, Vector3d::UnitZ()).toRotationMatrix();
}
RigidTransform joint(const Vector3d& at, const Eigen::Matrix3d& R = Eigen::Matrix3d::Identity()) {
  return {R, at};
}

/// Camera at `position`; yaw 0 looks along +y, positive to the left; pitch positive up; roll about
/// the optical axis.
RigidTransform looking(const Vector3d& position, double yaw, double pitch, double roll) {
  // Camera axes x right, y down, z forward, in the world at yaw 0.
  Eigen::Matrix3d level;
  level << 1, 0, 0,  //
      0, 0, 1,       //
      0, -1, 0;
  const Eigen::Matrix3d R = turn_z(yaw) *
                            Eigen::AngleAxisd(pitch, Vector3d::UnitX()).toRotationMatrix() * level *
                            turn_z(roll);
  return {R, position};
}

}  // namespace

double Wave::at(double t) const { return amplitude * std::sin(2.0 * kPi * frequency * t + phase); }

Motion::Motion(const SceneOptions& options)
    : kind_(options.motion),
      camera_speed_(options.camera_speed),
      tremor_(options.tremor),
      mover_speed_(options.mover_speed),
      movers_(options.movers) {
  Random random(options.seed, 2);
  const auto wave = [&](double amplitude, double frequency) {
    return Wave{amplitude * random.uniform(0.85, 1.15), frequency * random.uniform(0.88, 1.12),
                random.uniform(0.0, 2.0 * kPi)};
  };
  x_ = {wave(0.34, 0.100), wave(0.11, 0.27)};
  y_ = {wave(0.22, 0.110), wave(0.07, 0.31)};
  z_ = {wave(0.09, 0.130), wave(0.035, 0.29)};
  yaw_ = {wave(13.0 * kDegree, 0.060), wave(8.5 * kDegree, 0.19)};
  pitch_ = {wave(4.0 * kDegree, 0.120), wave(2.0 * kDegree, 0.37)};
  roll_ = {wave(2.2 * kDegree, 0.150), wave(1.0 * kDegree, 0.41)};
  drift_ = wave(11.0 * kDegree, 0.017);
  for (std::size_t axis = 0; axis < 6; ++axis) {
    const double amplitude = axis < 3 ? 0.0010 : 0.12 * kDegree;
    tremble_[axis] = {wave(amplitude, 4.3), wave(0.6 * amplitude, 7.9)};
  }
  const double speed = random.uniform(0.85, 1.0), direction = random.chance(0.5) ? 1.0 : -1.0;
  const double start = random.uniform(0.0, 6.0), lag = random.uniform(0.45, 0.7);
  for (int i = 0; i < kPeople; ++i) {
    Walker& w = walkers_[static_cast<std::size_t>(i)];
    // They walk abreast, the farther one a little behind: for seconds both are one motion. The
    // nearer one carries the box.
    w.distance = i == 0 ? random.uniform(1.36, 1.42) : random.uniform(1.76, 1.86);
    w.half_straight = 0.72;
    w.radius = 0.30;
    w.speed = speed;
    w.start = start - i * lag;
    w.direction = direction;
    w.height = random.uniform(0.96, 1.07);
    w.phase = random.uniform(0.0, 2.0 * kPi);
    w.carries = i == 0;
  }
}

double Motion::camera_clock(double t) const {
  // A quiet beginning: the rate grows from 0.15 to 1 in the first 1.5 s, smoothly.
  constexpr double kQuiet = 0.15, kEnd = 1.5;
  const double x = std::clamp(t / kEnd, 0.0, 1.0);
  double grown = kEnd * (x * x * x - 0.5 * x * x * x * x);
  if (t > kEnd) grown += t - kEnd;
  return camera_speed_ * (kQuiet * t + (1.0 - kQuiet) * grown);
}

Motion::Anchor Motion::anchor(double t) const {
  if (kind_ != CameraMotion::kHandHeld) return {{kHomeX, kHomeY}, 0.0};
  const double c = camera_clock(t);
  return {{kHomeX + x_[0].at(c), kHomeY + y_[0].at(c)}, yaw_[0].at(c) + drift_.at(c)};
}

RigidTransform Motion::hand_held(double t) const {
  const double c = camera_clock(t);
  const auto sum = [c](const std::array<Wave, 2>& w) { return w[0].at(c) + w[1].at(c); };
  const RigidTransform path =
      looking({kHomeX + sum(x_), kHomeY + sum(y_), kHomeZ + sum(z_)}, sum(yaw_) + drift_.at(c),
              kHomePitch + sum(pitch_), sum(roll_));
  Vector6d shake;
  for (int axis = 0; axis < 6; ++axis) {
    const std::array<Wave, 2>& w = tremble_[static_cast<std::size_t>(axis)];
    shake[axis] = tremor_ * (w[0].at(t) + w[1].at(t));
  }
  return path * se3_exp(shake);
}

RigidTransform Motion::T_world_cam(double t) const {
  const double c = camera_clock(t);
  const Vector3d home(kHomeX, kHomeY, kHomeZ);
  switch (kind_) {
    case CameraMotion::kHandHeld:
      break;
    case CameraMotion::kPureRotation:
      return looking(home, Wave{24 * kDegree, 0.125, 0.0}.at(c),
                     kHomePitch + Wave{6 * kDegree, 0.171, 0.7}.at(c),
                     Wave{3 * kDegree, 0.213, 0.3}.at(c));
    case CameraMotion::kRound: {
      const double yaw = 2.0 * kPi * c / kRoundPeriod;
      const Vector3d outwards(-std::sin(yaw), std::cos(yaw), 0.0);
      return looking(Vector3d(kHomeX, kRoundY, kHomeZ) + kRoundRadius * outwards, yaw,
                     kHomePitch + Wave{3 * kDegree, 0.171, 0.7}.at(c), 0.0);
    }
    case CameraMotion::kForward: {
      const RigidTransform T = looking(home, 0.0, kHomePitch, 0.0);
      return {T.R, T.t + Wave{0.4, 0.11, 0.0}.at(c) * T.R.col(2)};
    }
    case CameraMotion::kSideways: {
      const RigidTransform T = looking(home, 0.0, kHomePitch, 0.0);
      return {T.R, T.t + Wave{0.55, 0.09, 0.0}.at(c) * T.R.col(0)};
    }
  }
  return hand_held(t);
}

BodyPoses Motion::T_world_body(double t) const {
  BodyPoses poses;
  if (!movers_) return poses;
  for (std::size_t i = 0; i < kPeople; ++i) {
    RigidTransform* parts = poses.data() + 1 + i * kPartsPerPerson;
    pose_person(walkers_[i], t, parts);
    if (walkers_[i].carries) {
      poses[kCarriedBoxBody] = parts[kTorso] * joint({0.44, 0.0, 0.12 * walkers_[i].height});
    }
  }
  return poses;
}

void Motion::pose_person(const Walker& w, double t, RigidTransform* parts) const {
  // Round a track of two straights and two half circles, across the anchor's line of sight.
  const double lap = 4.0 * w.half_straight + 2.0 * kPi * w.radius;
  const double way = w.start + mover_speed_ * w.speed * t;
  double s = way - lap * std::floor(way / lap);
  const double half = 2.0 * w.half_straight + kPi * w.radius;
  const bool back = s >= half;
  if (back) s -= half;
  double across, along, heading;
  if (s < 2.0 * w.half_straight) {
    across = s - w.half_straight, along = -w.radius, heading = 0.0;
  } else {
    const double a = (s - 2.0 * w.half_straight) / w.radius;
    across = w.half_straight + w.radius * std::sin(a);
    along = -w.radius * std::cos(a), heading = a;
  }
  if (back) across = -across, along = -along, heading += kPi;
  const Anchor from = anchor(t);
  if (w.direction < 0.0) across = -across, heading = kPi - heading;
  const Vector2d right(std::cos(from.yaw), std::sin(from.yaw));
  const Vector2d ahead(-std::sin(from.yaw), std::cos(from.yaw));
  const Vector2d at = from.position + across * right + (w.distance + along) * ahead;
  const Eigen::Matrix3d facing = turn_z(from.yaw + heading);

  // Gait. Angles positive forward; the lower foot stands on the floor.
  const double h = w.height;
  const double phase = w.phase + 2.0 * kPi * way / (1.37 * h);
  const double thigh = 0.43 * h, shin = 0.41 * h;
  double swing[2], knee[2], drop[2];
  for (int side = 0; side < 2; ++side) {
    const double p = phase + side * kPi;
    swing[side] = 0.40 * std::sin(p) + 0.05;
    const double lift = std::max(0.0, std::cos(p - 0.3));
    knee[side] = 0.10 + 0.75 * lift * lift;
    drop[side] = thigh * std::cos(swing[side]) + shin * std::cos(swing[side] - knee[side]);
  }
  constexpr double kSharp = 60.0;  // a smooth maximum
  const double stand =
      std::log(std::exp(kSharp * (drop[0] - 0.8)) + std::exp(kSharp * (drop[1] - 0.8))) / kSharp +
      0.8;
  const RigidTransform pelvis(facing * turn_z(0.06 * std::sin(phase)),
                              Vector3d(at.x(), at.y(), stand + 0.10 * h));
  parts[kTorso] = pelvis * joint({0, 0, 0}, turn_y(0.04));
  parts[kHead] =
      parts[kTorso] * joint({0.01, 0, 0.53 * h}, turn_z(0.15 * std::sin(0.8 * way + w.phase)));
  for (int side = 0; side < 2; ++side) {
    const double out = side == 0 ? 1.0 : -1.0;
    const RigidTransform hip =
        pelvis * joint({0, out * 0.095 * h, -0.03 * h}, turn_y(-swing[side]));
    const RigidTransform knee_joint = hip * joint({0, 0, -thigh}, turn_y(knee[side]));
    parts[kLeftThigh + side] = hip;
    parts[kLeftShin + side] = knee_joint;
    parts[kLeftFoot + side] =
        knee_joint * joint({0, 0, -shin}, turn_y(0.6 * (swing[side] - knee[side])));
    const double arm =
        w.carries ? 0.50 + 0.02 * std::sin(2.0 * phase) : -0.38 * std::sin(phase + side * kPi);
    const double elbow = w.carries ? 0.75 : 0.35 + 0.2 * std::max(0.0, arm);
    const Eigen::Matrix3d outward =
        Eigen::AngleAxisd(out * 0.10, Vector3d::UnitX()).toRotationMatrix();
    const RigidTransform shoulder =
        parts[kTorso] * joint({0, out * 0.215 * h, 0.46 * h}, outward * turn_y(-arm));
    parts[kLeftUpperArm + side] = shoulder;
    parts[kLeftForearm + side] = shoulder * joint({0, 0, -0.28 * h}, turn_y(-elbow));
  }
}

}  // namespace dynslam::dataset::scene
