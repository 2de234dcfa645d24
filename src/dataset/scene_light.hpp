// Light of the rendered scene.
#pragma once

#include <array>
#include <vector>

#include "scene_world.hpp"

namespace dynslam::dataset::scene {

/// The two lamps under the ceiling (metres): middles at (+-kLampX, kLampY).
inline constexpr double kLampX = 1.3, kLampY = 0.2, kLampHalfX = 0.6, kLampHalfY = 0.15;

/// Soft shadows of the furniture under the lamps, ambient light, gamma.
class Lighting {
 public:
  /// For a room whose furniture stands.
  explicit Lighting(const World& world);

  /// Light on a point with normal n, as a factor on texture colours (gamma applied).
  float at(const Eigen::Vector3d& point, const Eigen::Vector3d& normal) const;
  /// Light at the corners of a face of a box, as in Appearance::light.
  std::array<float, 4> corners(const Solid& solid, int face) const;
  /// Multiplies the picture of a face with its light; the picture covers the face.
  void paint(const Solid& solid, int face, Canvas& canvas) const;

 private:
  struct Caster {
    Solid solid;
    RigidTransform T_solid_world;
  };
  bool hidden(const Eigen::Vector3d& from, const Eigen::Vector3d& way) const;
  std::vector<Caster> casters_;
};

}  // namespace dynslam::dataset::scene
