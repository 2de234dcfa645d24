// A fundamental matrix from a few hundred mostly right matches, in tens of microseconds.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>

#include <Eigen/Core>

#include "dynslam/core/span.hpp"
#include "dynslam/matching/detail/lanes.hpp"
#include "dynslam/matching/workspace.hpp"

namespace dynslam::matching::detail {

using Matrix3d = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Vector9d = Eigen::Matrix<double, 9, 1>;
using Matrix9d = Eigen::Matrix<double, 9, 9>;

/// Matches in coordinates that are shifted and scaled (by the same factor in both images), arrays
/// padded to a multiple of four with weight 0.
struct FitPoints {
  FitPoints(std::size_t capacity, Workspace& workspace)
      : x1(workspace.take<float>(capacity + 4)),
        y1(workspace.take<float>(capacity + 4)),
        x2(workspace.take<float>(capacity + 4)),
        y2(workspace.take<float>(capacity + 4)),
        weight(workspace.take<float>(capacity + 4)) {}

  void push(float a, float b, float c, float d, float w) {
    x1[size] = a;
    y1[size] = b;
    x2[size] = c;
    y2[size] = d;
    weight[size] = w;
    ++size;
  }

  void pad() {
    for (std::size_t i = size; i < size + 4; ++i) x1[i] = y1[i] = x2[i] = y2[i] = weight[i] = 0.0F;
  }

  Span<float> x1, y1, x2, y2, weight;
  std::size_t size = 0;
};

/// Epipolar quantities of four matches under F: e = q' F p, lines F p and F' q.
struct Epipolar4 {
  Epipolar4(const float* f, const FitPoints& points, std::size_t i) {
    const auto x1 = load(&points.x1[0] + i);
    const auto y1 = load(&points.y1[0] + i);
    const auto x2 = load(&points.x2[0] + i);
    const auto y2 = load(&points.y2[0] + i);
    l0 = f[0] * x1 + f[1] * y1 + f[2];
    l1 = f[3] * x1 + f[4] * y1 + f[5];
    m0 = f[0] * x2 + f[3] * y2 + f[6];
    m1 = f[1] * x2 + f[4] * y2 + f[7];
    e = x2 * l0 + y2 * l1 + (f[6] * x1 + f[7] * y1 + f[8]);
    g2 = l0 * l0 + l1 * l1;
    g1 = m0 * m0 + m1 * m1;
  }
  Float4 l0, l1, m0, m1, e;
  Float4 g1, g2;  // squared gradient in the first and in the second image
};

struct FloatF {
  explicit FloatF(const Matrix3d& f) {
    for (int i = 0; i < 9; ++i) v[i] = static_cast<float>(f.data()[i]);
  }
  float v[9];
};

/// Sum of min(r^2 / limit^2, 1), r the Sampson distance: smaller is better, weights' sum is worst.
inline float truncated_cost(const Matrix3d& f, const FitPoints& points, float limit) {
  const FloatF values(f);
  const float scale = 1.0F / (limit * limit);
  Float4 sum = Float4::Zero();
  for (std::size_t i = 0; i < points.size; i += 4) {
    const Epipolar4 at(values.v, points, i);
    const Float4 r2 = at.e * at.e * scale / (at.g1 + at.g2 + 1e-20F);
    sum += load(&points.weight[0] + i) * r2.min(1.0F);
  }
  return sum.sum();
}

/// F (not made singular) through eight matches, by elimination with column pivots. False if they do
/// not determine one. About 300 ns.
inline bool fit_eight(const FitPoints& points, const std::size_t (&index)[8], Matrix3d& f) {
  double a[8][9];
  int column[9] = {0, 1, 2, 3, 4, 5, 6, 7, 8};
  for (int r = 0; r < 8; ++r) {
    const double x1 = points.x1[index[r]], y1 = points.y1[index[r]];
    const double x2 = points.x2[index[r]], y2 = points.y2[index[r]];
    const double row[9] = {x2 * x1, x2 * y1, x2, y2 * x1, y2 * y1, y2, x1, y1, 1.0};
    std::copy(row, row + 9, a[r]);
  }
  for (int k = 0; k < 8; ++k) {
    int pivot = k;
    for (int j = k + 1; j < 9; ++j) {
      if (std::abs(a[k][j]) > std::abs(a[k][pivot])) pivot = j;
    }
    if (!(std::abs(a[k][pivot]) > 1e-9)) return false;
    if (pivot != k) {
      for (auto& row : a) std::swap(row[pivot], row[k]);
      std::swap(column[pivot], column[k]);
    }
    const double inverse = 1.0 / a[k][k];
    for (int r = k + 1; r < 8; ++r) {
      const double factor = a[r][k] * inverse;
      for (int j = k + 1; j < 9; ++j) a[r][j] -= factor * a[k][j];
    }
  }
  double x[9];
  x[8] = 1.0;
  for (int k = 7; k >= 0; --k) {
    double sum = a[k][8];
    for (int j = k + 1; j < 8; ++j) sum += a[k][j] * x[j];
    x[k] = -sum / a[k][k];
  }
  for (int k = 0; k < 9; ++k) f.data()[column[k]] = x[k];
  const double norm = f.norm();
  if (!(norm > 0.0 && norm < 1e12)) return false;
  f /= norm;
  return true;
}

/// Solves A x = b in place for a symmetric positive definite A (lower triangle read).
inline void solve_spd(Matrix9d& a, Vector9d& b) {
  for (int j = 0; j < 9; ++j) {
    double d = a(j, j);
    for (int k = 0; k < j; ++k) d -= a(j, k) * a(j, k);
    a(j, j) = d > 0.0 ? std::sqrt(d) : 1e150;  // a direction without information does not move
    const double inverse = 1.0 / a(j, j);
    for (int i = j + 1; i < 9; ++i) {
      double s = a(i, j);
      for (int k = 0; k < j; ++k) s -= a(i, k) * a(j, k);
      a(i, j) = s * inverse;
    }
  }
  for (int i = 0; i < 9; ++i) {
    for (int k = 0; k < i; ++k) b[i] -= a(i, k) * b[k];
    b[i] /= a(i, i);
  }
  for (int i = 8; i >= 0; --i) {
    for (int k = i + 1; k < 9; ++k) b[i] -= a(k, i) * b[k];
    b[i] /= a(i, i);
  }
}

/// Cofactors of F: the gradient of its determinant.
inline Vector9d cofactors(const Matrix3d& f) {
  Vector9d c;
  c << f(1, 1) * f(2, 2) - f(1, 2) * f(2, 1), f(1, 2) * f(2, 0) - f(1, 0) * f(2, 2),
      f(1, 0) * f(2, 1) - f(1, 1) * f(2, 0), f(2, 1) * f(0, 2) - f(2, 2) * f(0, 1),
      f(2, 2) * f(0, 0) - f(2, 0) * f(0, 2), f(2, 0) * f(0, 1) - f(2, 1) * f(0, 0),
      f(0, 1) * f(1, 2) - f(0, 2) * f(1, 1), f(0, 2) * f(1, 0) - f(0, 0) * f(1, 2),
      f(0, 0) * f(1, 1) - f(0, 1) * f(1, 0);
  return c;
}

/// One Gauss-Newton step on the Sampson distances, each weighted by the point's weight and by the
/// Geman-McClure kernel 1 / (1 + r^2/limit^2)^2. The full derivative is used (that of the gradient
/// in the denominator too: without it the fixed point is biased and measurably worse). Unit norm
/// and zero determinant are kept to first order by two heavily weighted rows.
inline void refine(Matrix3d& f, const FitPoints& points, float limit) {
  const FloatF values(f);
  const float scale = 1.0F / (limit * limit);
  Float4 a[45];
  Float4 b[9];
  for (Float4& x : a) x.setZero();
  for (Float4& x : b) x.setZero();
  for (std::size_t i = 0; i < points.size; i += 4) {
    const Epipolar4 at(values.v, points, i);
    const auto x1 = load(&points.x1[0] + i);
    const auto y1 = load(&points.y1[0] + i);
    const auto x2 = load(&points.x2[0] + i);
    const auto y2 = load(&points.y2[0] + i);
    const Float4 inverse = 1.0F / (at.g1 + at.g2 + 1e-12F);
    const Float4 h = -at.e * inverse;
    const Float4 kernel = 1.0F / (1.0F - at.e * h * scale);
    const Float4 w = load(&points.weight[0] + i) * kernel * kernel * inverse;
    const Float4 u0 = x2 + h * at.l0, u1 = y2 + h * at.l1;
    const Float4 v0 = h * at.m0, v1 = h * at.m1;
    const Float4 j[9] = {u0 * x1 + v0 * x2, u0 * y1 + v1 * x2, u0,
                         u1 * x1 + v0 * y2, u1 * y1 + v1 * y2, u1,
                         x1 + v0,           y1 + v1,           Float4::Ones()};
    Float4* product = a;
    for (int r = 0; r < 9; ++r) {
      const Float4 wj = w * j[r];
      for (int s = r; s < 9; ++s) *product++ += wj * j[s];
      b[r] -= wj * at.e;
    }
  }
  Matrix9d normal;
  Vector9d step;
  const Float4* product = a;
  for (int r = 0; r < 9; ++r) {
    for (int s = r; s < 9; ++s) normal(s, r) = normal(r, s) = (product++)->cast<double>().sum();
    step[r] = b[r].cast<double>().sum();
  }
  const double heavy = normal.trace();
  if (!(heavy > 0.0 && heavy < 1e30)) return;
  const Eigen::Map<const Vector9d> unit(f.data());
  Vector9d gradient = cofactors(f);
  const double length = gradient.norm();
  const double determinant = gradient.head<3>().dot(unit.head<3>());
  normal += heavy * unit * unit.transpose();
  if (length > 1e-9) {
    gradient /= length;
    normal += heavy * gradient * gradient.transpose();
    step -= heavy * (determinant / length) * gradient;
  }
  normal.diagonal().array() += 1e-9 * heavy;
  solve_spd(normal, step);
  const double norm = step.norm();
  if (!(norm < 1e6)) return;
  Eigen::Map<Vector9d>(f.data()) += step * std::min(1.0, 0.3 / norm);
  f /= f.norm();
}

}  // namespace dynslam::matching::detail
