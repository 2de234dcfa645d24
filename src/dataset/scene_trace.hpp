// What the camera sees: the fast ray caster of the rendered scene.
//
// Everything is expressed through w = 1 / depth. Along the rays of a pinhole camera w of a plane is
// linear in pixel coordinates, and w of a quadric is linear plus the root of a quadratic
// polynomial. The coefficients are computed in double precision for the middle of every tile, the
// pixels of the tile in single precision around it, in loops that the compiler vectorizes.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"

#include "scene_motion.hpp"
#include "scene_world.hpp"

namespace dynslam::dataset::scene {

inline constexpr int kTile = 16;  ///< pixels a side
inline constexpr int kTilePixels = kTile * kTile;
inline constexpr int kMaxSamples = 4 * kTilePixels;

/// Rays of a tile: places relative to (x, y), the middle of the tile, and what they meet. `count`
/// is at most kMaxSamples; the loops run up to the next multiple of eight.
struct Samples {
  double x = 0.0, y = 0.0;
  int count = 0;
  alignas(32) float dx[kMaxSamples] = {};
  alignas(32) float dy[kMaxSamples] = {};
  alignas(32) float w[kMaxSamples] = {};  ///< 1 / depth
  alignas(32) std::int32_t surface[kMaxSamples] = {};

  int padded() const { return (count + 7) & ~7; }
};

/// Linear function of homogeneous pixel coordinates: c . (u, v, 1).
using Linear = Eigen::Vector3d;

/// One of up to three quadrics of a solid: w = b + sqrt(D) where D >= 0.
struct QuadricView {
  Eigen::Matrix3d D;  ///< quadratic form of (u, v, 1)
  Linear b;
  bool clipped = false;  ///< cone: lower <= axis / w <= upper
  Linear axis;
  double lower = 0.0, upper = 0.0;
};

/// A solid as one camera sees it.
struct SolidView {
  Shape shape = Shape::kBox;
  int first_surface = 0;
  int body = 0;
  float x0 = 0, y0 = 0, x1 = 0, y1 = 0;  ///< rectangle of pixels outside which it is not seen
  float nearest_w = 0;                   ///< upper bound of w over the solid
  /// Planes: the first `front` face the camera, w of each and its surface's number in the solid.
  int planes = 0, front = 0;
  std::array<Linear, 6> plane;
  std::array<int, 6> plane_face{};
  int quadrics = 0;
  std::array<QuadricView, 3> quadric;
};

/// The scene from one pose at one time.
class View {
 public:
  View(const World& world, const PinholeCamera& camera, const RigidTransform& T_world_cam,
       const BodyPoses& T_world_body, bool movers);

  const PinholeCamera& camera() const { return camera_; }
  const RigidTransform& T_cam_body(int body) const {
    return T_cam_body_[static_cast<std::size_t>(body)];
  }
  /// Candidates for the tile with upper left pixel (x, y), nearest first, into `found`.
  void candidates(int x, int y, std::vector<int>& found) const;
  /// Fills samples.w and samples.surface.
  void trace(const std::vector<int>& candidates, Samples& samples) const;

 private:
  void add(const Solid& solid);
  void add_planes(SolidView& view, const Solid& solid, const RigidTransform& T_cam_solid) const;
  bool add_quadrics(SolidView& view, const Solid& solid, const RigidTransform& T_cam_solid) const;
  bool bound_box(SolidView& view, const Solid& solid, const RigidTransform& T_cam_solid) const;
  Linear in_pixels(const Eigen::Vector3d& m) const { return K_inverse_.transpose() * m; }

  PinholeCamera camera_;
  Eigen::Matrix3d K_inverse_;
  std::array<RigidTransform, kBodies> T_cam_body_;
  SolidView room_;
  std::vector<SolidView> solids_;  ///< nearest first
};

/// Places the pixel centres of the tile with upper left pixel (x, y), row by row.
void place_pixels(int x, int y, Samples& samples);

}  // namespace dynslam::dataset::scene
