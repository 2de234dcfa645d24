// Colours of what the rays meet.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "scene_trace.hpp"

namespace dynslam::dataset::scene {

/// Textures and light of one view.
class Shader {
 public:
  Shader(const World& world, const Appearance& look, const View& view,
         const RigidTransform& T_world_cam, const BodyPoses& T_world_body, bool movers);

  /// Memory of one thread.
  struct Scratch {
    std::vector<std::int32_t> surfaces;  ///< those in the tile
    std::int32_t index[kMaxSamples];
    alignas(32) float dx[kMaxSamples], dy[kMaxSamples], z[kMaxSamples], w[kMaxSamples];
    alignas(32) float s[kMaxSamples], t[kMaxSamples], lod[kMaxSamples], light[kMaxSamples];
  };

  /// Colour (B, G, R, 255) of every sample into out[0 .. count).
  void shade(const Samples& samples, Scratch& scratch, std::uint32_t* out) const;

 private:
  void gather(const Samples& samples, std::int32_t surface, Scratch& scratch, int* count) const;
  void map_plane(const Samples& samples, int surface, int count, Scratch& scratch) const;
  void map_round(const Samples& samples, int surface, int count, Scratch& scratch) const;
  void cast_shadows(const Surface& surface, int count, Scratch& scratch) const;
  void fetch(const Surface& surface, int count, const Scratch& scratch, std::uint32_t* out) const;
  Linear in_pixels(const Eigen::Vector3d& m) const { return K_inverse_.transpose() * m; }

  const World& world_;
  const Appearance& look_;
  Eigen::Matrix3d K_inverse_;
  float focal_;
  std::vector<RigidTransform> T_solid_cam_;
  Eigen::Vector3d up_, key_;           ///< directions of light in camera coordinates
  std::vector<Eigen::Vector3d> feet_;  ///< in the world; the floor is darker below them
};

}  // namespace dynslam::dataset::scene
