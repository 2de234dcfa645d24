// View of an image (or of any matrix stored by rows) that somebody else owns.
#pragma once

#include <cassert>
#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace dynslam {

/// `width` x `height` pixels of type T, rows `stride_bytes` apart.
///
/// Pixel (x, y) is column x, row y; its centre has the image coordinates (x,
/// y). A descriptor matrix is an ImageView as well: a row a descriptor, `width`
/// bytes long. Trivially copyable; pass by value; never outlives the pixels.
template <typename T>
struct ImageView {
  using element_type = T;
  using Byte = std::conditional_t<std::is_const_v<T>, const unsigned char, unsigned char>;

  T* data = nullptr;
  int width = 0;
  int height = 0;
  std::ptrdiff_t stride_bytes = 0;

  constexpr ImageView() = default;
  /// Rows without gaps.
  constexpr ImageView(T* data_, int width_, int height_)
      : ImageView(data_, width_, height_, static_cast<std::ptrdiff_t>(sizeof(T)) * width_) {}
  constexpr ImageView(T* data_, int width_, int height_, std::ptrdiff_t stride_bytes_)
      : data(data_), width(width_), height(height_), stride_bytes(stride_bytes_) {}

  /// A view of mutable pixels reads as a view of const ones.
  template <typename U,
            typename = std::enable_if_t<std::is_same_v<const U, T> && !std::is_const_v<U>>>
  constexpr ImageView(ImageView<U> other)
      : ImageView(other.data, other.width, other.height, other.stride_bytes) {}

  constexpr bool empty() const { return data == nullptr || width <= 0 || height <= 0; }

  T* row(int y) const {
    assert(y >= 0 && y < height);
    return reinterpret_cast<T*>(reinterpret_cast<Byte*>(data) + y * stride_bytes);
  }
  T& operator()(int x, int y) const {
    assert(x >= 0 && x < width);
    return row(y)[x];
  }
  constexpr bool contains(int x, int y) const {
    return x >= 0 && y >= 0 && x < width && y < height;
  }

  template <typename U>
  constexpr bool same_size(const ImageView<U>& other) const {
    return width == other.width && height == other.height;
  }
};

/// Grey image, 0..255.
using GrayView = ImageView<const std::uint8_t>;

/// Hard mask of what moves: 0 static, 255 dynamic (docs/concepts.md).
using MaskView = ImageView<const std::uint8_t>;

/// One binary descriptor a row (32 bytes wide for ORB).
using DescriptorsView = ImageView<const std::uint8_t>;

}  // namespace dynslam
