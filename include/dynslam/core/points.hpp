// Points as columns of a matrix, bound without a copy.
#pragma once

#include <cassert>
#include <cstddef>
#include <type_traits>

#include <Eigen/Core>

#include "dynslam/core/span.hpp"

namespace dynslam {

/// Read-only view of points as the columns of a 2 x N (3 x N) matrix with any
/// column stride.
///
/// The outer stride is free, so a std::vector<Eigen::Vector2d>, an array of
/// structs or a block of a matrix bind without a copy (use `as_points`). Never
/// kept after the call.
template <typename Scalar, int Dim>
using PointsRef =
    Eigen::Ref<const Eigen::Matrix<Scalar, Dim, Eigen::Dynamic>, 0, Eigen::OuterStride<>>;

using Points2f = PointsRef<float, 2>;
using Points2d = PointsRef<double, 2>;
using Points3f = PointsRef<float, 3>;
using Points3d = PointsRef<double, 3>;

/// Map behind `as_points`.
template <typename Scalar, int Dim>
using PointsMap =
    Eigen::Map<const Eigen::Matrix<Scalar, Dim, Eigen::Dynamic>, 0, Eigen::OuterStride<>>;

namespace detail {

/// Scalar and dimension of a point type that is nothing but `Dim` scalars
/// (cv::Point2f, Eigen::Vector3d, struct {float x, y;}).
template <typename Scalar, typename Point>
inline constexpr int kPointDim = static_cast<int>(sizeof(Point) / sizeof(Scalar));

}  // namespace detail

/// Binds an array of points as columns, without a copy:
/// `as_points<float>(field(kps, &KeyPoint::pt))`.
///
/// `Point` must be a trivially copyable type of `Dim` scalars and nothing else.
/// The stride must be a multiple of the scalar's size. O(1).
template <typename Scalar, typename Point>
auto as_points(StridedSpan<Point> points) {
  constexpr int dim = detail::kPointDim<Scalar, Point>;
  static_assert(sizeof(Point) == dim * sizeof(Scalar), "a point must be made of scalars only");
  assert(points.stride_bytes() % static_cast<std::ptrdiff_t>(sizeof(Scalar)) == 0);
  return PointsMap<Scalar, dim>(
      reinterpret_cast<const Scalar*>(points.data()), dim, static_cast<Eigen::Index>(points.size()),
      Eigen::OuterStride<>(points.stride_bytes() / static_cast<std::ptrdiff_t>(sizeof(Scalar))));
}

template <typename Scalar, typename Container>
auto as_points(const Container& points) {
  Span span(points);
  using Point = std::remove_pointer_t<decltype(span.data())>;
  return as_points<Scalar>(StridedSpan<Point>(span));
}

}  // namespace dynslam
