#include "scene_world.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace dynslam::dataset::scene {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Part of a ray, with the surface through which it enters and the one through which it leaves.
struct Interval {
  double enter = -kInfinity, leave = kInfinity;
  int enter_face = -1, leave_face = -1;

  void clip(double from, int from_face, double to, int to_face) {
    if (from > enter) enter = from, enter_face = from_face;
    if (to < leave) leave = to, leave_face = to_face;
  }
  bool empty() const { return !(enter <= leave); }
};

/// Clips with |o + s d| <= half, faces `positive` at +half and positive + 1 at -half.
void clip_slab(Interval& interval, double o, double d, double half, int positive) {
  if (d == 0.0) {
    if (std::abs(o) > half) interval.leave = -kInfinity;
    return;
  }
  const double to_positive = (half - o) / d, to_negative = (-half - o) / d;
  if (d > 0.0) {
    interval.clip(to_negative, positive + 1, to_positive, positive);
  } else {
    interval.clip(to_positive, positive, to_negative, positive + 1);
  }
}

/// Clips with a s^2 + 2 b s + c <= 0, a > 0.
void clip_quadratic(Interval& interval, double a, double b, double c, int face) {
  const double discriminant = b * b - a * c;
  if (!(discriminant >= 0.0) || !(a > 0.0)) {
    if (!(c <= 0.0)) interval.leave = -kInfinity;
    return;
  }
  const double root = std::sqrt(discriminant);
  interval.clip((-b - root) / a, face, (-b + root) / a, face);
}

void clip_ball(Interval& interval, const Eigen::Vector3d& o, const Eigen::Vector3d& d, double z,
               double radius) {
  const Eigen::Vector3d q = o - Eigen::Vector3d(0.0, 0.0, z);
  clip_quadratic(interval, d.squaredNorm(), q.dot(d), q.squaredNorm() - radius * radius, 0);
}

/// Nearest point with s > 0 of the lateral surface of the cone that touches both balls of a limb.
double meet_cone(const Eigen::Vector3d& o, const Eigen::Vector3d& d, const Eigen::Vector3d& size) {
  // Along the axis h = -z the radius is (r0 - k h) / c, k and c the sine and cosine of the slope.
  const double k = (size.x() - size.y()) / size.z(), c2 = 1.0 - k * k;
  const double ho = -o.z(), hd = -d.z(), ro = size.x() - k * ho, rd = -k * hd;
  const double a = d.x() * d.x() + d.y() * d.y() - rd * rd / c2;
  const double b = o.x() * d.x() + o.y() * d.y() - ro * rd / c2;
  const double c = o.x() * o.x() + o.y() * o.y() - ro * ro / c2;
  const double discriminant = b * b - a * c;
  if (!(discriminant >= 0.0) || a == 0.0) return kInfinity;
  const double root = std::sqrt(discriminant);
  double nearest = kInfinity;
  for (const double s : {(-b - root) / a, (-b + root) / a}) {
    const double h = ho + s * hd;
    if (s > 0.0 && s < nearest && h >= size.x() * k && h <= size.z() + size.y() * k) nearest = s;
  }
  return nearest;
}

Hit intersect_limb(const Eigen::Vector3d& o, const Eigen::Vector3d& d,
                   const Eigen::Vector3d& size) {
  double nearest = meet_cone(o, d, size);
  for (const auto& [z, radius] : {std::pair(0.0, size.x()), std::pair(-size.z(), size.y())}) {
    Interval ball;
    clip_ball(ball, o, d, z, radius);
    if (!ball.empty() && ball.enter > 0.0) nearest = std::min(nearest, ball.enter);
  }
  return {nearest, nearest < kInfinity ? 0 : -1};
}

}  // namespace

int World::add_solid(Shape shape, int body, const RigidTransform& T_body_solid,
                     const Eigen::Vector3d& size, const Surface& look) {
  Solid solid;
  solid.shape = shape;
  solid.body = body;
  solid.T_body_solid = T_body_solid;
  solid.size = size;
  solid.first_surface = static_cast<int>(surfaces.size());
  const int index = static_cast<int>(solids.size());
  for (int i = 0; i < surfaces_of(shape); ++i) {
    surfaces.push_back(look);
    surfaces.back().solid = index;
  }
  solids.push_back(solid);
  return index;
}

Ball ball_around(const Solid& solid) {
  const Eigen::Vector3d& size = solid.size;
  switch (solid.shape) {
    case Shape::kRoom:
      break;
    case Shape::kBox:
      return {Eigen::Vector3d::Zero(), size.norm()};
    case Shape::kCylinder:
      return {Eigen::Vector3d::Zero(), std::hypot(size.x(), size.z())};
    case Shape::kEllipsoid:
      return {Eigen::Vector3d::Zero(), size.maxCoeff()};
    case Shape::kLimb:
      return {{0.0, 0.0, -0.5 * size.z()}, 0.5 * size.z() + std::max(size.x(), size.y())};
  }
  return {Eigen::Vector3d::Zero(), kInfinity};
}

Hit intersect(const Solid& solid, const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
  const Eigen::Vector3d &o = origin, &d = direction, &size = solid.size;
  if (solid.shape == Shape::kLimb) {
    Hit hit = intersect_limb(o, d, size);
    if (hit.surface == 0) hit.surface = solid.first_surface;
    return hit;
  }
  Interval inside;
  switch (solid.shape) {
    case Shape::kRoom:
    case Shape::kBox:
      for (int axis = 0; axis < 3; ++axis)
        clip_slab(inside, o[axis], d[axis], size[axis], 2 * axis);
      break;
    case Shape::kCylinder:
      clip_quadratic(inside, d.head<2>().squaredNorm(), o.head<2>().dot(d.head<2>()),
                     o.head<2>().squaredNorm() - size.x() * size.x(), 0);
      clip_slab(inside, o.z(), d.z(), size.z(), 1);
      break;
    case Shape::kEllipsoid: {
      const Eigen::Vector3d os = o.cwiseQuotient(size), ds = d.cwiseQuotient(size);
      clip_quadratic(inside, ds.squaredNorm(), os.dot(ds), os.squaredNorm() - 1.0, 0);
      break;
    }
    case Shape::kLimb:
      break;
  }
  if (inside.empty()) return {};
  if (solid.shape == Shape::kRoom) return {inside.leave, solid.first_surface + inside.leave_face};
  if (!(inside.enter > 0.0) || inside.enter_face < 0) return {};
  return {inside.enter, solid.first_surface + inside.enter_face};
}

}  // namespace dynslam::dataset::scene
