#include "scene_trace.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "scene_trace_kernels.hpp"

namespace dynslam::dataset::scene {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr float kEverywhere = 1e9F;

/// Extent of an ellipsoid with middle c and shape matrix M = A diag(r^2) A^T (a ball: r^2 I) in
/// normalized image coordinates along axis 0 or 1. Only for one wholly in front of the camera.
/// From the dual conic M - c c^T.
void bound_quadric(const Vector3d& c, const Matrix3d& M, int axis, double* low, double* high) {
  const double a = M(2, 2) - c.z() * c.z();
  const double b = M(axis, 2) - c[axis] * c.z();
  const double d = M(axis, axis) - c[axis] * c[axis];
  const double root = std::sqrt(std::max(0.0, b * b - a * d));
  *low = (b + root) / a;  // a < 0
  *high = (b - root) / a;
}

void widen(SolidView& view, const PinholeCamera& camera, double x0, double y0, double x1, double y1,
           double nearest_z) {
  constexpr float kMargin = 1.0F;
  view.x0 = std::min(view.x0, static_cast<float>(camera.fx * x0 + camera.cx) - kMargin);
  view.y0 = std::min(view.y0, static_cast<float>(camera.fy * y0 + camera.cy) - kMargin);
  view.x1 = std::max(view.x1, static_cast<float>(camera.fx * x1 + camera.cx) + kMargin);
  view.y1 = std::max(view.y1, static_cast<float>(camera.fy * y1 + camera.cy) + kMargin);
  view.nearest_w = std::max(view.nearest_w, static_cast<float>(1.0001 / nearest_z));
}

void nowhere(SolidView& view) {
  view.x0 = view.y0 = kEverywhere;
  view.x1 = view.y1 = -kEverywhere;
  view.nearest_w = 0.0F;
}

void everywhere(SolidView& view) {
  view.x0 = view.y0 = -kEverywhere;
  view.x1 = view.y1 = kEverywhere;
  view.nearest_w = kEverywhere;
}

/// False if the ellipsoid is behind the camera.
bool bound_ellipsoid(SolidView& view, const PinholeCamera& camera, const Vector3d& c,
                     const Matrix3d& M) {
  const double reach = std::sqrt(M(2, 2));
  if (c.z() + reach <= kMinDepth) return false;
  if (c.z() - reach <= 0.01) {
    everywhere(view);
    return true;
  }
  double x0, x1, y0, y1;
  bound_quadric(c, M, 0, &x0, &x1);
  bound_quadric(c, M, 1, &y0, &y1);
  widen(view, camera, x0, y0, x1, y1, c.z() - reach);
  return true;
}

/// The quadric X^T P X + 2 g.X + k <= 0 in camera coordinates: with X = d / w it is
/// k w^2 + 2 (g.d) w + d^T P d <= 0. False if the camera is inside.
bool make_quadric(QuadricView& q, const Matrix3d& P, const Vector3d& g, double k,
                  const Matrix3d& K_inverse) {
  if (!(k > 1e-12)) return false;
  const Matrix3d D = (g * g.transpose() - k * P) / (k * k);
  q.D = K_inverse.transpose() * D * K_inverse;
  q.b = K_inverse.transpose() * (-g / k);
  return true;
}

}  // namespace

View::View(const World& world, const PinholeCamera& camera, const RigidTransform& T_world_cam,
           const BodyPoses& T_world_body, bool movers)
    : camera_(camera) {
  K_inverse_ << 1.0 / camera.fx, 0.0, -camera.cx / camera.fx,  //
      0.0, 1.0 / camera.fy, -camera.cy / camera.fy,            //
      0.0, 0.0, 1.0;
  const RigidTransform T_cam_world = T_world_cam.inverse();
  for (std::size_t body = 0; body < kBodies; ++body) {
    T_cam_body_[body] = body == 0 ? T_cam_world : T_cam_world * T_world_body[body];
  }
  for (const Solid& solid : world.solids) {
    if (solid.body == 0 || movers) add(solid);
  }
  std::stable_sort(solids_.begin(), solids_.end(), [](const SolidView& a, const SolidView& b) {
    return a.nearest_w > b.nearest_w;
  });
}

void View::add(const Solid& solid) {
  const RigidTransform T_cam_solid = T_cam_body(solid.body) * solid.T_body_solid;
  SolidView view;
  view.shape = solid.shape;
  view.first_surface = solid.first_surface;
  view.body = solid.body;
  if (solid.shape == Shape::kRoom) {
    everywhere(view);
    add_planes(view, solid, T_cam_solid);
    room_ = view;
    return;
  }
  nowhere(view);
  const bool has_planes = solid.shape == Shape::kBox || solid.shape == Shape::kCylinder;
  if (has_planes) {
    if (!bound_box(view, solid, T_cam_solid)) return;
    add_planes(view, solid, T_cam_solid);
  }
  if (solid.shape != Shape::kBox && !add_quadrics(view, solid, T_cam_solid)) return;
  if (solid.shape == Shape::kBox && view.front == 0) return;  // the camera is inside
  if (view.x1 < 0.0F || view.y1 < 0.0F || view.x0 > static_cast<float>(camera_.width) ||
      view.y0 > static_cast<float>(camera_.height)) {
    return;
  }
  solids_.push_back(view);
}

void View::add_planes(SolidView& view, const Solid& solid, const RigidTransform& T) const {
  const bool caps_only = solid.shape == Shape::kCylinder;
  const Vector3d size = caps_only ? Vector3d(0, 0, solid.size.z()) : solid.size;
  const Vector3d eye = -(T.R.transpose() * T.t);  // the camera in the solid's coordinates
  for (const bool front : {true, false}) {
    for (int face = caps_only ? 4 : 0; face < 6; ++face) {
      const int axis = face / 2;
      const double sign = face % 2 == 0 ? 1.0 : -1.0;
      double distance = sign * eye[axis] - size[axis];  // of the camera, outwards
      if ((distance > 0.0) != front) continue;
      if (std::abs(distance) < 1e-9) distance = front ? 1e-9 : -1e-9;
      const auto p = static_cast<std::size_t>(view.planes++);
      view.plane[p] = in_pixels(-sign / distance * T.R.col(axis));
      view.plane_face[p] = caps_only ? face - 3 : face;
      if (front) ++view.front;
    }
  }
}

bool View::bound_box(SolidView& view, const Solid& solid, const RigidTransform& T) const {
  const Vector3d half = solid.shape == Shape::kCylinder
                            ? Vector3d(solid.size.x(), solid.size.x(), solid.size.z())
                            : solid.size;
  double nearest = std::numeric_limits<double>::infinity(), farthest = -nearest;
  double x0 = nearest, y0 = nearest, x1 = -nearest, y1 = -nearest;
  for (int corner = 0; corner < 8; ++corner) {
    const Vector3d sign((corner & 1) != 0 ? 1 : -1, (corner & 2) != 0 ? 1 : -1,
                        (corner & 4) != 0 ? 1 : -1);
    const Vector3d X = T * half.cwiseProduct(sign);
    nearest = std::min(nearest, X.z());
    farthest = std::max(farthest, X.z());
    const double x = X.x() / X.z(), y = X.y() / X.z();
    x0 = std::min(x0, x), x1 = std::max(x1, x), y0 = std::min(y0, y), y1 = std::max(y1, y);
  }
  if (farthest <= kMinDepth) return false;
  if (nearest <= 0.01) {
    everywhere(view);
  } else {
    widen(view, camera_, x0, y0, x1, y1, nearest);
  }
  return true;
}

bool View::add_quadrics(SolidView& view, const Solid& solid, const RigidTransform& T) const {
  const Vector3d& size = solid.size;
  const auto next = [&]() -> QuadricView& {
    return view.quadric[static_cast<std::size_t>(view.quadrics)];
  };
  if (solid.shape == Shape::kEllipsoid) {
    const Vector3d squares = size.cwiseAbs2();
    const Matrix3d M = T.R * squares.asDiagonal() * T.R.transpose();
    const Matrix3d S = T.R * squares.cwiseInverse().asDiagonal() * T.R.transpose();
    const Vector3d Sc = S * T.t;
    if (!bound_ellipsoid(view, camera_, T.t, M)) return false;
    if (make_quadric(next(), S, -Sc, T.t.dot(Sc) - 1.0, K_inverse_)) ++view.quadrics;
    return view.quadrics > 0;
  }
  const Vector3d up = T.R.col(2);
  if (solid.shape == Shape::kCylinder) {
    const Matrix3d P = Matrix3d::Identity() - up * up.transpose();
    const Vector3d g = -(P * T.t);
    const double k = T.t.dot(P * T.t) - size.x() * size.x();
    if (make_quadric(next(), P, g, k, K_inverse_)) ++view.quadrics;
    return true;  // the caps remain if the camera is in the infinite cylinder
  }
  // Limb: two balls and the cone that touches both.
  bool seen = false;
  const Vector3d axis = -up, ends[2] = {T.t, T.t + size.z() * axis};
  const double radii[2] = {size.x(), size.y()};
  for (int end = 0; end < 2; ++end) {
    const Vector3d& c = ends[end];
    const double r2 = radii[end] * radii[end];
    if (!bound_ellipsoid(view, camera_, c, r2 * Matrix3d::Identity())) continue;
    seen = true;
    if (make_quadric(next(), Matrix3d::Identity(), -c, c.squaredNorm() - r2, K_inverse_)) {
      ++view.quadrics;
    }
  }
  if (!seen) return false;
  if (ends[0].z() - radii[0] <= 0.01 || ends[1].z() - radii[1] <= 0.01) everywhere(view);
  const double slope = (size.x() - size.y()) / size.z(), c2 = 1.0 - slope * slope;
  const Matrix3d P = Matrix3d::Identity() - axis * axis.transpose() / c2;
  const Vector3d Pp = P * T.t;
  const double lean = size.x() * slope / c2;
  QuadricView& cone = next();
  if (make_quadric(cone, P, -Pp + lean * axis,
                   T.t.dot(Pp) - 2.0 * lean * axis.dot(T.t) - size.x() * size.x() / c2,
                   K_inverse_)) {
    cone.clipped = true;
    cone.axis = in_pixels(axis);
    cone.lower = axis.dot(T.t) + size.x() * slope;
    cone.upper = axis.dot(T.t) + size.z() + size.y() * slope;
    ++view.quadrics;
  }
  return true;
}

void View::candidates(int x, int y, std::vector<int>& found) const {
  found.clear();
  const auto x0 = static_cast<float>(x) - 0.5F, y0 = static_cast<float>(y) - 0.5F;
  const float x1 = x0 + kTile, y1 = y0 + kTile;
  for (std::size_t i = 0; i < solids_.size(); ++i) {
    const SolidView& s = solids_[i];
    if (s.x1 < x0 || s.x0 > x1 || s.y1 < y0 || s.y0 > y1) continue;
    if (s.shape == Shape::kBox && misses_tile(s, x0, y0, x1, y1)) continue;
    found.push_back(static_cast<int>(i));
  }
}

void View::trace(const std::vector<int>& candidates, Samples& samples) const {
  fill_room(room_, samples);
  for (const int index : candidates) {
    const SolidView& solid = solids_[static_cast<std::size_t>(index)];
    // Nearest first: once everything is nearer than the next solid can be, the rest is hidden.
    if (solid.nearest_w < least_w(samples)) break;
    switch (solid.shape) {
      case Shape::kBox:
        draw_box(solid, samples);
        break;
      case Shape::kCylinder:
        draw_cylinder(solid, samples);
        break;
      case Shape::kEllipsoid:
      case Shape::kLimb:
        draw_quadrics(solid, samples);
        break;
      case Shape::kRoom:
        break;
    }
  }
}

void place_pixels(int x, int y, Samples& samples) {
  samples.x = x + 0.5 * (kTile - 1);
  samples.y = y + 0.5 * (kTile - 1);
  samples.count = kTilePixels;
  for (int row = 0; row < kTile; ++row) {
    for (int column = 0; column < kTile; ++column) {
      samples.dx[row * kTile + column] = static_cast<float>(column) - 0.5F * (kTile - 1);
      samples.dy[row * kTile + column] = static_cast<float>(row) - 0.5F * (kTile - 1);
    }
  }
}

}  // namespace dynslam::dataset::scene
