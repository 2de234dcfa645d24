// Inner loops of the ray caster: one solid, the samples of one tile. Included by scene_trace.cpp
// alone. All loops are branch-free, with selects instead, so that the compiler can vectorize them.
#pragma once

#include <algorithm>
#include <cmath>

#include "scene_trace.hpp"

namespace dynslam::dataset::scene {
namespace {

/// Linear function around the middle of a tile.
struct TileLinear {
  float x, y, c;
  TileLinear() = default;
  TileLinear(const Linear& f, const Samples& samples)
      : x(static_cast<float>(f.x())),
        y(static_cast<float>(f.y())),
        c(static_cast<float>(f.x() * samples.x + f.y() * samples.y + f.z())) {}
  float at(float dx, float dy) const { return x * dx + (y * dy + c); }
};

/// Quadratic form of (u, v, 1) around the middle of a tile.
struct TileQuadratic {
  float xx, xy, yy, x, y, c;
  TileQuadratic(const Eigen::Matrix3d& H, const Samples& samples) {
    const Eigen::Vector3d p(samples.x, samples.y, 1.0), Hp = H * p;
    xx = static_cast<float>(H(0, 0));
    xy = static_cast<float>(2.0 * H(0, 1));
    yy = static_cast<float>(H(1, 1));
    x = static_cast<float>(2.0 * Hp.x());
    y = static_cast<float>(2.0 * Hp.y());
    c = static_cast<float>(p.dot(Hp));
  }
  float at(float dx, float dy) const {
    return (xx * dx + (xy * dy + x)) * dx + ((yy * dy + y) * dy + c);
  }
};

/// Whether no ray of the tile meets a box: somewhere it enters one face only after it has left
/// through another, and as both are linear it is enough to look at the corners.
bool misses_tile(const SolidView& s, float x0, float y0, float x1, float y1) {
  const auto below_zero = [&](const Linear& f) {
    return f.x() * (f.x() > 0 ? x1 : x0) + f.y() * (f.y() > 0 ? y1 : y0) + f.z() < 0.0;
  };
  for (int i = 0; i < s.front; ++i) {
    const Linear& enter = s.plane[static_cast<std::size_t>(i)];
    if (below_zero(enter)) return true;
    for (int j = s.front; j < s.planes; ++j) {
      if (below_zero(enter - s.plane[static_cast<std::size_t>(j)])) return true;
    }
  }
  return false;
}

float least_w(const Samples& samples) {
  float least[8];
  for (int k = 0; k < 8; ++k) least[k] = samples.w[k];
  for (int i = 8; i < samples.padded(); i += 8) {
    for (int k = 0; k < 8; ++k) {
      least[k] = samples.w[i + k] < least[k] ? samples.w[i + k] : least[k];
    }
  }
  return *std::min_element(least, least + 8);
}

/// The wall that a ray from within meets is the nearest of all planes.
void fill_room(const SolidView& room, Samples& samples) {
  const int n = samples.padded();
  for (int i = 0; i < n; ++i) {
    samples.w[i] = 0.0F;
    samples.surface[i] = room.first_surface;
  }
  for (std::size_t p = 0; p < static_cast<std::size_t>(room.planes); ++p) {
    const TileLinear f(room.plane[p], samples);
    const float reach = 0.5F * kTile;
    if (f.c + reach * (std::abs(f.x) + std::abs(f.y)) < 0.0F) continue;
    const std::int32_t surface = room.first_surface + room.plane_face[p];
    for (int i = 0; i < n; ++i) {
      const float w = f.at(samples.dx[i], samples.dy[i]);
      const bool nearer = w > samples.w[i];
      samples.w[i] = nearer ? w : samples.w[i];
      samples.surface[i] = nearer ? surface : samples.surface[i];
    }
  }
}

/// A ray enters a convex solid through the last of the planes that face it and leaves it through
/// the first of the others: least w of the former against greatest w of the latter.
template <int kFront, int kPlanes>
void draw_planes(const SolidView& solid, Samples& samples) {
  TileLinear plane[kPlanes];
  std::int32_t face[kFront];
  for (std::size_t p = 0; p < kPlanes; ++p) plane[p] = TileLinear(solid.plane[p], samples);
  for (std::size_t p = 0; p < kFront; ++p) face[p] = solid.first_surface + solid.plane_face[p];
  const int n = samples.padded();
  for (int i = 0; i < n; ++i) {
    const float dx = samples.dx[i], dy = samples.dy[i];
    float enter = plane[0].at(dx, dy);
    std::int32_t surface = face[0];
    for (int p = 1; p < kFront; ++p) {
      const float w = plane[p].at(dx, dy);
      surface = w < enter ? face[p] : surface;
      enter = w < enter ? w : enter;
    }
    float leave = 0.0F;
    for (int p = kFront; p < kPlanes; ++p) {
      const float w = plane[p].at(dx, dy);
      leave = w > leave ? w : leave;
    }
    leave = samples.w[i] > leave ? samples.w[i] : leave;  // and nearer than what is there
    const bool hit = enter > leave;
    samples.w[i] = hit ? enter : samples.w[i];
    samples.surface[i] = hit ? surface : samples.surface[i];
  }
}

void draw_box(const SolidView& solid, Samples& samples) {
  switch (solid.front) {
    case 1:
      draw_planes<1, 6>(solid, samples);
      break;
    case 2:
      draw_planes<2, 6>(solid, samples);
      break;
    case 3:
      draw_planes<3, 6>(solid, samples);
      break;
    default:
      break;
  }
}

/// Ellipsoids, balls and cones: whatever is nearest. All belong to one surface.
void draw_quadrics(const SolidView& solid, Samples& samples) {
  const int n = samples.padded();
  const std::int32_t surface = solid.first_surface;
  for (std::size_t k = 0; k < static_cast<std::size_t>(solid.quadrics); ++k) {
    const QuadricView& q = solid.quadric[k];
    const TileQuadratic D(q.D, samples);
    const TileLinear b(q.b, samples), axis(q.clipped ? q.axis : Linear(Linear::Zero()), samples);
    const auto lower = static_cast<float>(q.lower), upper = static_cast<float>(q.upper);
    const float open = q.clipped ? 0.0F : -1.0F;  // lets every w > 0 pass the test for the ends
    for (int i = 0; i < n; ++i) {
      const float dx = samples.dx[i], dy = samples.dy[i];
      const float d = D.at(dx, dy);
      const float w = b.at(dx, dy) + std::sqrt(d > 0.0F ? d : 0.0F);
      const float h = axis.at(dx, dy);
      const float over = h - w * lower, under = w * upper - h;
      const float within = over < under ? over : under;
      const bool hit = (d >= 0.0F) & (w > samples.w[i]) & (within >= open * w);
      samples.w[i] = hit ? w : samples.w[i];
      samples.surface[i] = hit ? surface : samples.surface[i];
    }
  }
}

/// The infinite cylinder cut by two caps, at most one of which faces the camera. A camera right
/// above, within the infinite cylinder, sees nothing of it: the scene has no such place.
void draw_cylinder(const SolidView& solid, Samples& samples) {
  if (solid.quadrics == 0) return;
  const QuadricView& q = solid.quadric[0];
  const TileQuadratic D(q.D, samples);
  const TileLinear b(q.b, samples);
  TileLinear cap[2];
  for (std::size_t p = 0; p < 2; ++p) cap[p] = TileLinear(solid.plane[p], samples);
  const bool cap_seen = solid.front == 1;
  const std::int32_t side_surface = solid.first_surface;
  const std::int32_t cap_surface = solid.first_surface + solid.plane_face[0];
  const int n = samples.padded();
  for (int i = 0; i < n; ++i) {
    const float dx = samples.dx[i], dy = samples.dy[i];
    const float d = D.at(dx, dy), root = std::sqrt(d > 0.0F ? d : 0.0F), middle = b.at(dx, dy);
    const float first = cap[0].at(dx, dy), second = cap[1].at(dx, dy);
    float enter = middle + root, leave = middle - root;
    std::int32_t surface = side_surface;
    const bool by_cap = cap_seen & (first < enter);
    surface = by_cap ? cap_surface : surface;
    enter = by_cap ? first : enter;
    leave = second > leave ? second : leave;
    leave = (!cap_seen & (first > leave)) ? first : leave;
    leave = samples.w[i] > leave ? samples.w[i] : leave;
    const bool hit = (d >= 0.0F) & (enter > leave);
    samples.w[i] = hit ? enter : samples.w[i];
    samples.surface[i] = hit ? surface : samples.surface[i];
  }
}

}  // namespace
}  // namespace dynslam::dataset::scene
