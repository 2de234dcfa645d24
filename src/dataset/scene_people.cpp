// Bodies and clothes of the people.
#include "scene_paint.hpp"
#include "scene_world.hpp"

namespace dynslam::dataset::scene {

namespace {

using Eigen::Vector3d;

/// One texel of clothes, skin and hair is 2.5 mm.
constexpr float kTexelsPerMetre = 400.0F;

RigidTransform at(double x, double y, double z) {
  return {Eigen::Matrix3d::Identity(), Vector3d(x, y, z)};
}

class Tailor {
 public:
  Tailor(World& world, std::uint64_t seed, int person)
      : world_(world), random_(seed, 50 + static_cast<std::uint64_t>(person)) {
    std::uint64_t purpose = 100 + 20 * static_cast<std::uint64_t>(person);
    const auto picture = [&](int side, Canvas (*paint)(Random)) {
      return world.add_texture(side, side,
                               [paint, random = Random(seed, purpose++)] { return paint(random); });
    };
    shirt_ = picture(512, paint_shirt);
    trousers_ = picture(512, paint_trousers);
    skin_ = picture(256, paint_skin);
    hair_ = picture(256, paint_hair);
    body_ = 1 + person * kPartsPerPerson;
  }

  void dress() {
    ellipsoid(kTorso, {0, 0, 0.03}, {0.14, 0.18, 0.16}, trousers_);
    ellipsoid(kTorso, {0, 0, 0.29}, {0.155, 0.205, 0.29}, shirt_);
    ellipsoid(kTorso, {0, 0, 0.43}, {0.115, 0.235, 0.10}, shirt_);
    limb(kTorso, at(0, 0, 0.62), {0.052, 0.058, 0.14}, skin_);
    ellipsoid(kHead, {0.0, 0, 0.14}, {0.10, 0.082, 0.13}, skin_, true);
    ellipsoid(kHead, {-0.022, 0, 0.168}, {0.10, 0.09, 0.122}, hair_);
    for (int side = 0; side < 2; ++side) {
      limb(kLeftUpperArm + side, {}, {0.062, 0.050, 0.28}, shirt_);
      limb(kLeftForearm + side, {}, {0.050, 0.036, 0.23}, shirt_);
      ellipsoid(kLeftForearm + side, {0, 0, -0.30}, {0.042, 0.028, 0.075}, skin_);
      limb(kLeftThigh + side, {}, {0.095, 0.066, 0.43}, trousers_);
      limb(kLeftShin + side, {}, {0.066, 0.044, 0.41}, trousers_);
      // The shoe points along +x.
      const Eigen::Matrix3d ahead =
          Eigen::AngleAxisd(-1.5707963267948966, Vector3d::UnitY()).toRotationMatrix();
      limb(kLeftFoot + side, {ahead, Vector3d(-0.03, 0, -0.045)}, {0.052, 0.042, 0.19}, hair_);
    }
  }

 private:
  Surface look(int texture, bool in_place) {
    Surface s;
    const Recipe& t = world_.recipes[static_cast<std::size_t>(texture)];
    s.label = kPersonLabel;
    s.texture = texture;
    s.lit_by_normal = true;
    s.scale_u = s.scale_v = kTexelsPerMetre;
    s.offset_u = static_cast<float>(4 * t.width);
    s.offset_v = static_cast<float>(4 * t.height + t.height / 2);
    if (!in_place) {
      s.offset_u += static_cast<float>(random_.below(t.width));
      s.offset_v += static_cast<float>(random_.below(t.height));
    }
    s.detail = 2;
    s.detail_offset_u = static_cast<float>(2048 + random_.below(512));
    s.detail_offset_v = static_cast<float>(2048 + random_.below(512));
    return s;
  }
  void ellipsoid(int part, const Vector3d& center, const Vector3d& size, int texture,
                 bool in_place = false) {
    world_.add_solid(Shape::kEllipsoid, body_ + part, at(center.x(), center.y(), center.z()), size,
                     look(texture, in_place));
  }
  /// size: radius at the joint, radius at the end, length.
  void limb(int part, const RigidTransform& pose, const Vector3d& size, int texture) {
    world_.add_solid(Shape::kLimb, body_ + part, pose, size, look(texture, false));
  }

  World& world_;
  Random random_;
  int shirt_ = 0, trousers_ = 0, skin_ = 0, hair_ = 0, body_ = 0;
};

}  // namespace

void add_people(World& world, std::uint64_t seed) {
  for (int person = 0; person < kPeople; ++person) Tailor(world, seed, person).dress();
  Random random(seed, 60);
  Surface look;
  look.label = kCarriedBoxLabel;
  look.lit_by_normal = true;
  look.detail = 2;
  const Vector3d half(0.20, 0.25, 0.22);
  const int box = world.add_solid(Shape::kBox, kCarriedBoxBody, {}, half, look);
  for (int face = 0; face < 6; ++face) {
    Surface& s = world.face(box, face);
    const Random paint_random(seed, 70 + static_cast<std::uint64_t>(face));
    s.texture =
        world.add_texture(256, 256, [paint_random] { return paint_cardboard(paint_random); });
    s.scale_u = s.scale_v = 500.0F;
    s.offset_u = s.offset_v = 1024.0F + 128.0F;
    s.detail_offset_u = s.detail_offset_v = 2048.0F;
  }
}

}  // namespace dynslam::dataset::scene
