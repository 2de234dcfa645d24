#include "scene_shade.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace dynslam::dataset::scene {

namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr float kHalfTurn = 3.14159265F;

/// Logarithm to the base of two, to 0.09; x > 0. Enough to choose a mip level.
inline float rough_log2(float x) {
  std::int32_t bits;
  std::memcpy(&bits, &x, sizeof bits);
  return static_cast<float>(bits - 0x3F800000) * 0x1.0p-23F;
}

/// Angle of (x, y), to 0.0003 radians; the polynomial for |tangent| <= 1 is a minimax fit.
inline float rough_atan2(float y, float x) {
  const float ax = std::abs(x), ay = std::abs(y);
  const float big = std::max(std::max(ax, ay), 1e-20F), small = std::min(ax, ay);
  const float q = small / big, q2 = q * q;
  float a = q * (0.9998660F +
                 q2 * (-0.3302995F + q2 * (0.1801410F + q2 * (-0.0851330F + q2 * 0.0208351F))));
  a = ay > ax ? 0.5F * kHalfTurn - a : a;
  a = x < 0.0F ? kHalfTurn - a : a;
  return y < 0.0F ? -a : a;
}

/// Polynomial coordinates around the middle of a tile.
struct Around {
  float x, y, c;
  Around(const Linear& f, const Samples& samples)
      : x(static_cast<float>(f.x())),
        y(static_cast<float>(f.y())),
        c(static_cast<float>(f.x() * samples.x + f.y() * samples.y + f.z())) {}
  float at(float dx, float dy) const { return x * dx + (y * dy + c); }
};

/// c * k / 256 a channel, at most 255.
inline std::uint32_t scale_color(std::uint32_t c, std::uint32_t k) {
  const std::uint32_t b = std::min(255U, ((c & 255U) * k) >> 8);
  const std::uint32_t g = std::min(255U, (((c >> 8) & 255U) * k) >> 8);
  const std::uint32_t r = std::min(255U, (((c >> 16) & 255U) * k) >> 8);
  return b | g << 8 | r << 16 | 0xFF000000U;
}

}  // namespace

Shader::Shader(const World& world, const Appearance& look, const View& view,
               const RigidTransform& T_world_cam, const BodyPoses& T_world_body, bool movers)
    : world_(world), look_(look) {
  const PinholeCamera& camera = view.camera();
  K_inverse_ << 1.0 / camera.fx, 0.0, -camera.cx / camera.fx,  //
      0.0, 1.0 / camera.fy, -camera.cy / camera.fy,            //
      0.0, 0.0, 1.0;
  focal_ = static_cast<float>(std::sqrt(camera.fx * camera.fy));
  T_solid_cam_.reserve(world.solids.size());
  for (const Solid& solid : world.solids) {
    T_solid_cam_.push_back((view.T_cam_body(solid.body) * solid.T_body_solid).inverse());
  }
  up_ = T_world_cam.R.transpose() * Vector3d::UnitZ();
  key_ = T_world_cam.R.transpose() * Vector3d(0.45, -0.75, 0.48);
  if (!movers) return;
  for (int person = 0; person < kPeople; ++person) {
    for (const int part : {kTorso, kLeftFoot, kRightFoot}) {
      feet_.push_back(
          T_world_body[static_cast<std::size_t>(1 + person * kPartsPerPerson + part)].t);
    }
  }
}

void Shader::shade(const Samples& samples, Scratch& scratch, std::uint32_t* out) const {
  scratch.surfaces.clear();
  std::int32_t last = -1;
  for (int i = 0; i < samples.count; ++i) {
    const std::int32_t surface = samples.surface[i];
    if (surface == last) continue;
    last = surface;
    std::vector<std::int32_t>& list = scratch.surfaces;
    if (std::find(list.begin(), list.end(), surface) == list.end()) list.push_back(surface);
  }
  for (const std::int32_t index : scratch.surfaces) {
    int count = 0;
    gather(samples, index, scratch, &count);
    const Surface& surface = world_.surfaces[static_cast<std::size_t>(index)];
    const Solid& solid = world_.solids[static_cast<std::size_t>(surface.solid)];
    const bool round = solid.shape == Shape::kEllipsoid || solid.shape == Shape::kLimb ||
                       (solid.shape == Shape::kCylinder && index == solid.first_surface);
    if (round) {
      map_round(samples, index, count, scratch);
    } else {
      map_plane(samples, index, count, scratch);
    }
    fetch(surface, count, scratch, out);
  }
}

void Shader::gather(const Samples& samples, std::int32_t surface, Scratch& scratch,
                    int* count) const {
  int n = 0;
  for (int i = 0; i < samples.count; ++i) {
    scratch.index[n] = i;
    n += samples.surface[i] == surface ? 1 : 0;
  }
  for (int k = 0; k < n; ++k) {
    const int i = scratch.index[k];
    scratch.dx[k] = samples.dx[i];
    scratch.dy[k] = samples.dy[i];
    scratch.w[k] = samples.w[i];
  }
  for (int k = n; k < ((n + 7) & ~7); ++k) {
    scratch.dx[k] = scratch.dx[n - 1];
    scratch.dy[k] = scratch.dy[n - 1];
    scratch.w[k] = scratch.w[n - 1];
  }
  for (int k = 0; k < ((n + 7) & ~7); ++k) scratch.z[k] = 1.0F / scratch.w[k];
  *count = n;
}

void Shader::map_plane(const Samples& samples, int index, int count, Scratch& scratch) const {
  const Surface& surface = world_.surfaces[static_cast<std::size_t>(index)];
  const Solid& solid = world_.solids[static_cast<std::size_t>(surface.solid)];
  const RigidTransform& T = T_solid_cam_[static_cast<std::size_t>(surface.solid)];
  const int number = index - solid.first_surface;
  const int face = solid.shape == Shape::kCylinder ? number + 3 : number;
  const auto axis = static_cast<std::size_t>(face / 2);
  const int u_axis = kFaceU[axis], v_axis = kFaceV[axis];
  const double su = surface.scale_u, sv = surface.scale_v;
  const Around u(su * in_pixels(T.R.row(u_axis)), samples);
  const Around v(sv * in_pixels(T.R.row(v_axis)), samples);
  const auto u0 = static_cast<float>(su * T.t[u_axis] + static_cast<double>(surface.offset_u));
  const auto v0 = static_cast<float>(sv * T.t[v_axis] + static_cast<double>(surface.offset_v));
  // The area that a pixel covers grows with depth and with 1 / cos; cos = w * distance to plane.
  const Vector3d& size = solid.size;
  const double sign = face % 2 == 0 ? 1.0 : -1.0;
  const double distance =
      std::abs(sign * T.t[static_cast<int>(axis)] - size[static_cast<int>(axis)]);
  const float base = rough_log2(std::sqrt(std::abs(surface.scale_u * surface.scale_v)) / focal_) -
                     0.75F * rough_log2(static_cast<float>(std::max(distance, 1e-4)));
  const auto light = [&] {
    std::array<float, 4> l = look_.light[static_cast<std::size_t>(index)];
    if (surface.lit_by_normal) {
      const Vector3d n = sign * T.R.row(static_cast<int>(axis)).transpose();
      l.fill(static_cast<float>(0.74 + 0.16 * n.dot(up_) + 0.16 * n.dot(key_)));
    }
    return l;
  }();
  const float l0 = light[0], lu = light[1] - light[0], lv = light[2] - light[0];
  const float luv = light[3] - light[2] - light[1] + light[0];
  const auto au = static_cast<float>(0.5 / (su * size[u_axis])),
             av = static_cast<float>(0.5 / (sv * size[v_axis]));
  const float offset_u = surface.offset_u, offset_v = surface.offset_v;
  const int n = (count + 7) & ~7;
  for (int i = 0; i < n; ++i) {
    const float dx = scratch.dx[i], dy = scratch.dy[i], z = scratch.z[i];
    const float s = u.at(dx, dy) * z + u0, t = v.at(dx, dy) * z + v0;
    scratch.s[i] = s;
    scratch.t[i] = t;
    scratch.lod[i] = base + 1.75F * rough_log2(z);
    const float a = (s - offset_u) * au + 0.5F, b = (t - offset_v) * av + 0.5F;
    scratch.light[i] = l0 + lu * a + (lv + luv * a) * b;
  }
  if (surface.takes_shadows) cast_shadows(surface, count, scratch);
}

void Shader::cast_shadows(const Surface& surface, int count, Scratch& scratch) const {
  const RigidTransform T_solid_world =
      world_.solids[static_cast<std::size_t>(surface.solid)].T_body_solid.inverse();
  for (const Vector3d& point : feet_) {
    const Vector3f foot = (T_solid_world * point).cast<float>();
    for (int i = 0; i < count; ++i) {
      const float u = (scratch.s[i] - surface.offset_u) / surface.scale_u - foot.x();
      const float v = (scratch.t[i] - surface.offset_v) / surface.scale_v - foot.y();
      scratch.light[i] *= 1.0F - 0.28F / (1.0F + 30.0F * (u * u + v * v));
    }
  }
}

void Shader::map_round(const Samples& samples, int index, int count, Scratch& scratch) const {
  const Surface& surface = world_.surfaces[static_cast<std::size_t>(index)];
  const Solid& solid = world_.solids[static_cast<std::size_t>(surface.solid)];
  const RigidTransform& T = T_solid_cam_[static_cast<std::size_t>(surface.solid)];
  const Around x(in_pixels(T.R.row(0)), samples), y(in_pixels(T.R.row(1)), samples),
      z(in_pixels(T.R.row(2)), samples);
  const Vector3f t = T.t.cast<float>(), size = solid.size.cast<float>();
  const Vector3f up = (T.R * up_).cast<float>(), key = (T.R * key_).cast<float>();
  // Normal: n = k * (x, y, z - nearest point of the axis).
  Vector3f k(1.0F, 1.0F, 0.0F);
  float low = 0.0F, high = 0.0F;
  float radius = size.x();
  if (solid.shape == Shape::kEllipsoid) {
    k = size.cwiseAbs2().cwiseInverse();
    radius = 0.5F * (size.x() + size.y());
  } else if (solid.shape == Shape::kLimb) {
    k = Vector3f::Ones();
    low = -size.z();
    radius = 0.5F * (size.x() + size.y());
  }
  const float su = surface.scale_u * radius, sv = surface.scale_v;
  const float u0 = surface.offset_u, v0 = surface.offset_v;
  const float base = rough_log2(std::sqrt(std::abs(surface.scale_u * surface.scale_v)) / focal_);
  const int n = (count + 7) & ~7;
  for (int i = 0; i < n; ++i) {
    const float dx = scratch.dx[i], dy = scratch.dy[i], depth = scratch.z[i];
    const float rx = x.at(dx, dy), ry = y.at(dx, dy), rz = z.at(dx, dy);  // the ray
    const float px = rx * depth + t.x(), py = ry * depth + t.y(), pz = rz * depth + t.z();
    const float core = std::min(std::max(pz, low), high);
    const float nx = k.x() * px, ny = k.y() * py, nz = k.z() * (pz - core);
    const float inverse = 1.0F / std::sqrt(nx * nx + ny * ny + nz * nz + 1e-20F);
    const float lift = (nx * up.x() + ny * up.y() + nz * up.z()) * inverse;
    const float side = (nx * key.x() + ny * key.y() + nz * key.z()) * inverse;
    const float facing = std::max(0.1F, -(nx * rx + ny * ry + nz * rz) * inverse);
    scratch.s[i] = su * rough_atan2(py, px) + u0;
    scratch.t[i] = sv * pz + v0;
    scratch.lod[i] = base + rough_log2(depth) - 0.75F * rough_log2(facing);
    scratch.light[i] = 0.74F + 0.16F * lift + 0.16F * side;
  }
}

void Shader::fetch(const Surface& surface, int count, const Scratch& scratch,
                   std::uint32_t* out) const {
  const Texture& color = look_.textures[static_cast<std::size_t>(surface.texture)];
  const Grain& grain = look_.grains[static_cast<std::size_t>(surface.detail)];
  const float ku = kDetailTexelsPerMetre / surface.scale_u;
  const float kv = kDetailTexelsPerMetre / surface.scale_v;
  const float u0 = surface.detail_offset_u - ku * surface.offset_u;
  const float v0 = surface.detail_offset_v - kv * surface.offset_v;
  const float finer = rough_log2(std::sqrt(std::abs(ku * kv)));
  for (int i = 0; i < count; ++i) {
    const float s = scratch.s[i], t = scratch.t[i], lod = scratch.lod[i];
    const std::uint32_t c = color.sample(s, t, lod);
    const std::uint32_t d = grain.sample(ku * s + u0, kv * t + v0, lod + finer);
    const float k = scratch.light[i] * 2.0F * static_cast<float>(d);
    out[scratch.index[i]] = scale_color(c, static_cast<std::uint32_t>(std::max(k, 0.0F)));
  }
}

}  // namespace dynslam::dataset::scene
