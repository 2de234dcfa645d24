// Coordinates that somebody else owns, bound without a copy and rebindable (unlike Eigen::Ref and
// Eigen::Map, whose assignment copies elements), so that they can be members of structs of views.
#pragma once

#include <cassert>
#include <cstddef>
#include <type_traits>

#include <Eigen/Core>

#include "dynslam/core/span.hpp"

namespace dynslam::geometry {

/// `size` points of `Dim` scalars each, `stride_bytes` apart.
///
/// Binds an array of any point type that begins with nothing but `Dim` scalars (cv::Point2f,
/// Eigen::Vector3d, struct {float x, y;}), and members of structs through core's `field()`:
/// `Pixels(field(keypoints, &cv::KeyPoint::pt))`. Trivially copyable; never outlives the points.
template <typename Scalar, int Dim>
class CoordinateSpan {
 public:
  using Point = Eigen::Matrix<Scalar, Dim, 1>;

  constexpr CoordinateSpan() = default;
  CoordinateSpan(const Scalar* first, std::size_t size,
                 std::ptrdiff_t stride_bytes = Dim * sizeof(Scalar))
      : first_(first), size_(size), stride_(stride_bytes) {}

  template <typename P>
  CoordinateSpan(StridedSpan<P> points)
      : CoordinateSpan(reinterpret_cast<const Scalar*>(points.data()), points.size(),
                       points.stride_bytes()) {
    static_assert(sizeof(P) == Dim * sizeof(Scalar), "a point must be made of Dim scalars only");
  }

  /// Any contiguous container of such points (std::vector<cv::Point2f>, Span<Eigen::Vector3d>).
  template <typename Container,
            typename P = std::remove_pointer_t<decltype(std::declval<const Container&>().data())>,
            typename = std::enable_if_t<sizeof(P) == Dim * sizeof(Scalar)>>
  CoordinateSpan(const Container& points)
      : CoordinateSpan(reinterpret_cast<const Scalar*>(points.data()), points.size()) {}

  std::size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }
  const Scalar* data() const { return first_; }

  /// Point i, by value.
  Point operator[](std::size_t i) const {
    assert(i < size_);
    return Eigen::Map<const Point>(reinterpret_cast<const Scalar*>(
        reinterpret_cast<const char*>(first_) + static_cast<std::ptrdiff_t>(i) * stride_));
  }

 private:
  const Scalar* first_ = nullptr;
  std::size_t size_ = 0;
  std::ptrdiff_t stride_ = Dim * sizeof(Scalar);
};

/// Image coordinates without distortion, pixels.
using Pixels = CoordinateSpan<float, 2>;
/// Points in space, metres.
using Points = CoordinateSpan<double, 3>;

/// The features of one image. Empty arrays mean "none of this"; others have the size of `pixels`.
struct FeaturesView {
  Pixels pixels;                     ///< undistorted pixels; NaN = no such feature
  StridedSpan<const float> depths;   ///< metres along the axis; <= 0 or NaN = none; empty = mono
  StridedSpan<const float> scales;   ///< pixel noise relative to level 0 (1.2^octave); empty = 1
  StridedSpan<const float> spreads;  ///< metres between nearest and farthest depth around the
                                     ///< feature (`measure_depths`); empty = 0, no edge known

  std::size_t size() const { return pixels.size(); }
};

}  // namespace dynslam::geometry
