// Motion of the camera and of the people.
#pragma once

#include <array>
#include <cstdint>

#include <Eigen/Core>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/dataset/scene.hpp"

#include "scene_world.hpp"

namespace dynslam::dataset::scene {

/// Poses of all bodies at one time, T_world_body. Without movers only the room's is of any meaning.
using BodyPoses = std::array<RigidTransform, kBodies>;

/// a sin(2 pi f t + phase).
struct Wave {
  double amplitude = 0.0, frequency = 0.0, phase = 0.0;
  double at(double t) const;
};

/// All motion as a function of time in seconds from the first frame; closed form, so any time can
/// be asked for in any order. Every function is smooth enough for a velocity (the walkers' knees
/// apart).
class Motion {
 public:
  explicit Motion(const SceneOptions& options);

  RigidTransform T_world_cam(double t) const;
  BodyPoses T_world_body(double t) const;

 private:
  /// Where the camera would be without its quicker motions; the people keep in front of it.
  struct Anchor {
    Eigen::Vector2d position;
    double yaw;
  };
  struct Walker {
    double distance;  ///< from the anchor to the middle of the track, metres
    double half_straight, radius;
    double speed, start;
    double direction;  ///< +1 or -1: which way round
    double height;     ///< factor on all lengths
    double phase;      ///< of the gait
    bool carries;
  };
  double camera_clock(double t) const;
  Anchor anchor(double t) const;
  RigidTransform hand_held(double t) const;
  void pose_person(const Walker& walker, double t, RigidTransform* parts) const;

  CameraMotion kind_;
  double camera_speed_, tremor_, mover_speed_;
  bool movers_;
  // Two waves each; the slow ones of x, y and yaw are the anchor's.
  std::array<Wave, 2> x_, y_, z_, yaw_, pitch_, roll_;
  Wave drift_;
  std::array<std::array<Wave, 2>, 6> tremble_;
  std::array<Walker, kPeople> walkers_;
};

}  // namespace dynslam::dataset::scene
