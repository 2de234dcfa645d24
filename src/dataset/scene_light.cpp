#include "scene_light.hpp"

#include <algorithm>
#include <cmath>

namespace dynslam::dataset::scene {

namespace {

using Eigen::Vector3d;

constexpr double kAmbient = 0.34, kLampPower = 0.62, kGamma = 2.2;

/// Middle of a face, its half axes, and its normal towards where it is seen from.
struct FaceFrame {
  Vector3d center, u, v, normal;
  FaceFrame(const Solid& solid, int face) {
    const int axis = face / 2;
    const auto a = static_cast<std::size_t>(axis);
    const RigidTransform& T = solid.T_body_solid;
    const Vector3d out = (face % 2 == 0 ? 1.0 : -1.0) * T.R.col(axis);
    center = T.t + solid.size[axis] * out;
    u = solid.size[kFaceU[a]] * T.R.col(kFaceU[a]);
    v = solid.size[kFaceV[a]] * T.R.col(kFaceV[a]);
    normal = solid.shape == Shape::kRoom ? Vector3d(-out) : out;
  }
};

}  // namespace

Lighting::Lighting(const World& world) {
  for (const Solid& solid : world.solids) {
    // Pictures, books and handles throw no shadow worth its cost.
    if (solid.shape != Shape::kBox || solid.size.maxCoeff() < 0.2) continue;
    if (solid.size.minCoeff() < 0.01 || solid.T_body_solid.t.z() > kRoomZ - 0.1) continue;
    casters_.push_back({solid, solid.T_body_solid.inverse()});
  }
}

bool Lighting::hidden(const Vector3d& from, const Vector3d& way) const {
  return std::any_of(casters_.begin(), casters_.end(), [&](const Caster& caster) {
    const Vector3d origin = caster.T_solid_world * from, along = caster.T_solid_world.R * way;
    const Hit hit = intersect(caster.solid, origin, along);
    return hit.surface >= 0 && hit.depth < 1.0;
  });
}

float Lighting::at(const Vector3d& point, const Vector3d& normal) const {
  // Corners are darker, less of the room is seen from them; the ceiling has its light from below.
  const double corner = std::min({1.0, 0.72 + 0.5 * point.z(), 0.72 + 0.5 * (kRoomZ - point.z())});
  double light = kAmbient * corner + 0.35 * std::max(0.0, -normal.z());
  constexpr int kAlong = 3, kAcross = 2;
  for (const int side : {-1, 1}) {
    for (int i = 0; i < kAlong * kAcross; ++i) {
      const double x = ((i % kAlong) + 0.5) / kAlong * 2.0 - 1.0;
      const double y = ((i / kAlong) + 0.5) / kAcross * 2.0 - 1.0;
      const Vector3d lamp(side * kLampX + x * kLampHalfX, kLampY + y * kLampHalfY, kRoomZ - 0.045);
      const Vector3d way = lamp - point;
      const double distance2 = way.squaredNorm(), distance = std::sqrt(distance2);
      // A little light comes round edges and off the ceiling, hence the cosine that wraps around.
      const double falls = (way.dot(normal) / distance + 0.25) / 1.25;
      const double leaves = std::max(0.12, way.z() / distance);
      if (falls <= 0.0 || hidden(point + 0.004 * normal, way)) continue;
      light += kLampPower * 6.0 / (kAlong * kAcross) * falls * leaves / std::max(0.6, distance2);
    }
  }
  return static_cast<float>(std::pow(std::min(light, 1.5), 1.0 / kGamma));
}

std::array<float, 4> Lighting::corners(const Solid& solid, int face) const {
  const FaceFrame f(solid, face);
  std::array<float, 4> light{};
  for (std::size_t corner = 0; corner < 4; ++corner) {
    const double a = corner % 2 == 0 ? -0.85 : 0.85, b = corner < 2 ? -0.85 : 0.85;
    light[corner] = at(f.center + a * f.u + b * f.v, f.normal);
  }
  return light;
}

void Lighting::paint(const Solid& solid, int face, Canvas& canvas) const {
  constexpr int kColumns = 40, kRows = 20;
  const FaceFrame f(solid, face);
  std::vector<float> grid;
  grid.reserve((kColumns + 1) * (kRows + 1));
  for (int row = 0; row <= kRows; ++row) {
    for (int column = 0; column <= kColumns; ++column) {
      const double a = 2.0 * column / kColumns - 1.0, b = 2.0 * row / kRows - 1.0;
      grid.push_back(at(f.center + 0.998 * (a * f.u + b * f.v), f.normal));
    }
  }
  for (int y = 0; y < canvas.height(); ++y) {
    const float v = (static_cast<float>(y) + 0.5F) * kRows / static_cast<float>(canvas.height());
    const int row = static_cast<int>(v);
    const float fy = v - static_cast<float>(row);
    for (int x = 0; x < canvas.width(); ++x) {
      const float u =
          (static_cast<float>(x) + 0.5F) * kColumns / static_cast<float>(canvas.width());
      const int column = static_cast<int>(u);
      const float fx = u - static_cast<float>(column);
      const float* p = grid.data() + row * (kColumns + 1) + column;
      const float above = p[0] + fx * (p[1] - p[0]);
      const float below = p[kColumns + 1] + fx * (p[kColumns + 2] - p[kColumns + 1]);
      Color& color = canvas.at(x, y);
      color = color * (above + fy * (below - above));
    }
  }
}

Appearance paint_world(const World& world) {
  const Lighting lighting(world);
  Appearance look;
  look.textures.reserve(world.recipes.size());
  for (const Recipe& recipe : world.recipes) {
    Canvas canvas = recipe.paint();
    if (recipe.room_face >= 0) lighting.paint(world.solids[0], recipe.room_face, canvas);
    look.textures.emplace_back(canvas);
  }
  for (const auto& paint : world.grains) look.grains.emplace_back(paint());
  look.light.reserve(world.surfaces.size());
  for (const Surface& surface : world.surfaces) {
    const auto index = static_cast<int>(look.light.size());
    const Solid& solid = world.solids[static_cast<std::size_t>(surface.solid)];
    std::array<float, 4> light = {1.0F, 1.0F, 1.0F, 1.0F};
    if (surface.shine > 0.0F) {
      light.fill(surface.shine);
    } else if (solid.shape == Shape::kBox && !surface.lit_by_normal) {
      light = lighting.corners(solid, index - solid.first_surface);
    }
    look.light.push_back(light);
  }
  return look;
}

}  // namespace dynslam::dataset::scene
