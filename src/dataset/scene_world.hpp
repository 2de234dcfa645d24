// What the rendered scene consists of: solids made of surfaces, hung on bodies.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/dataset/scene.hpp"

#include "scene_texture.hpp"

namespace dynslam::dataset::scene {

/// The room (metres): x and y from the middle, z up from the floor.
inline constexpr double kRoomX = 3.0, kRoomY = 2.5, kRoomZ = 2.9;

/// Bodies that move as one. Body 0 is the room; the two people have kPartsPerPerson each; the
/// carried box comes last.
enum Part {
  kTorso,
  kHead,
  kLeftUpperArm,
  kRightUpperArm,
  kLeftForearm,
  kRightForearm,
  kLeftThigh,
  kRightThigh,
  kLeftShin,
  kRightShin,
  kLeftFoot,
  kRightFoot,
  kPartsPerPerson
};
inline constexpr int kPeople = 2;
inline constexpr int kCarriedBoxBody = 1 + kPeople * kPartsPerPerson;
inline constexpr int kBodies = kCarriedBoxBody + 1;

/// Shapes, each convex, given in coordinates of their own (metres).
enum class Shape {
  kRoom,       ///< the box |x| <= size.x, ... seen from inside; six surfaces
  kBox,        ///< the box |x| <= size.x, |y| <= size.y, |z| <= size.z; six surfaces
  kCylinder,   ///< x^2 + y^2 <= size.x^2, |z| <= size.z; surfaces: side, top, bottom
  kEllipsoid,  ///< (x/size.x)^2 + (y/size.y)^2 + (z/size.z)^2 <= 1; one surface
  kLimb,  ///< hull of the balls of radius size.x at 0 and size.y at (0, 0, -size.z); one surface
};

/// Number of surfaces of a shape.
constexpr int surfaces_of(Shape shape) {
  return shape == Shape::kCylinder ? 3 : (shape == Shape::kRoom || shape == Shape::kBox) ? 6 : 1;
}

/// Faces of boxes and of the room are +x, -x, +y, -y, +z, -z. The face's own coordinates (u, v) are
/// (y, z), (x, z) and (x, y).
inline constexpr std::array<int, 3> kFaceU = {1, 0, 0};
inline constexpr std::array<int, 3> kFaceV = {2, 2, 1};

/// Look of a surface: texel = scale * (u, v) + offset, both textures; colour times detail / 128
/// times light. Curved surfaces have u = angle * radius, v = z.
struct Surface {
  std::uint8_t label = kStaticLabel;
  int solid = 0;
  int texture = 0;
  float scale_u = 1.0F, scale_v = 1.0F, offset_u = 0.0F, offset_v = 0.0F;
  int detail = 0;  ///< grain, kDetailTexelsPerMetre
  float detail_offset_u = 0.0F, detail_offset_v = 0.0F;
  bool lit_by_normal = false;  ///< moving or round; otherwise by the light of the room
  float shine = 0.0F;          ///< > 0: this light, whatever the lamps do
  bool takes_shadows = false;  ///< darkened under the people
};
inline constexpr float kDetailTexelsPerMetre = 400.0F;

struct Solid {
  Shape shape = Shape::kBox;
  int body = 0;
  RigidTransform T_body_solid;
  Eigen::Vector3d size = Eigen::Vector3d::Ones();
  int first_surface = 0;
};

/// A texture to be: what it takes to paint it, once somebody wants to see colours.
struct Recipe {
  int width = 0, height = 0;
  std::function<Canvas()> paint;
  int room_face = -1;  ///< >= 0: covers this face of the room and takes its light
};

/// Everything but motion and colours. Solid 0 is the room.
struct World {
  std::vector<Solid> solids;
  std::vector<Surface> surfaces;
  std::vector<Recipe> recipes;
  std::vector<std::function<Canvas()>> grains;  ///< grey

  int add_texture(int width, int height, std::function<Canvas()> paint, int room_face = -1) {
    recipes.push_back({width, height, std::move(paint), room_face});
    return static_cast<int>(recipes.size()) - 1;
  }
  /// Adds a solid whose surfaces all look like `look`; returns its index.
  int add_solid(Shape shape, int body, const RigidTransform& T_body_solid,
                const Eigen::Vector3d& size, const Surface& look);
  Surface& face(int solid, int face) {
    return surfaces[static_cast<std::size_t>(solids[static_cast<std::size_t>(solid)].first_surface +
                                             face)];
  }
};

/// Colours and light of a world.
struct Appearance {
  std::vector<Texture> textures;
  std::vector<Grain> grains;
  /// Light at the four corners (-u, -v), (+u, -v), (-u, +v), (+u, +v) of every face, gamma applied.
  std::vector<std::array<float, 4>> light;
};

/// What `cast` finds.
struct Hit {
  double depth = 0.0;  ///< along d: the point is origin + depth * direction
  int surface = -1;
};

/// Ball that holds a solid, in the solid's coordinates; infinite for the room.
struct Ball {
  Eigen::Vector3d center;
  double radius;
};
Ball ball_around(const Solid& solid);

/// First meeting of a ray with the solid (slabs and quadratic equations in the solid's coordinates,
/// double precision); surface -1 if there is none. The origin lies outside, for the room inside.
Hit intersect(const Solid& solid, const Eigen::Vector3d& origin, const Eigen::Vector3d& direction);

/// Room, furniture and pictures.
World build_room(std::uint64_t seed);
/// The two people and the box, hung on their bodies.
void add_people(World& world, std::uint64_t seed);
/// Paints all textures and lights the room. About 0.3 s.
Appearance paint_world(const World& world);

}  // namespace dynslam::dataset::scene
