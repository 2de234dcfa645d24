// View of a dense feature map that somebody else owns.
#pragma once

#include <cassert>
#include <cstddef>
#include <type_traits>

namespace dynslam {

/// `channels` x `height` x `width` values, contiguous in that order (CHW, the
/// layout of one image of an NCHW batch). Trivially copyable; pass by value;
/// never outlives the values.
template <typename T>
struct TensorView {
  using element_type = T;

  T* data = nullptr;
  int channels = 0;
  int height = 0;
  int width = 0;

  constexpr TensorView() = default;
  constexpr TensorView(T* data_, int channels_, int height_, int width_)
      : data(data_), channels(channels_), height(height_), width(width_) {}

  /// A view of mutable values reads as a view of const ones.
  template <typename U,
            typename = std::enable_if_t<std::is_same_v<const U, T> && !std::is_const_v<U>>>
  constexpr TensorView(TensorView<U> other)
      : TensorView(other.data, other.channels, other.height, other.width) {}

  constexpr bool empty() const {
    return data == nullptr || channels <= 0 || height <= 0 || width <= 0;
  }
  constexpr std::size_t plane_size() const {
    return static_cast<std::size_t>(height) * static_cast<std::size_t>(width);
  }
  constexpr std::size_t size() const { return static_cast<std::size_t>(channels) * plane_size(); }

  /// First value of channel c; the plane is height x width values by rows.
  T* plane(int c) const {
    assert(c >= 0 && c < channels);
    return data + static_cast<std::size_t>(c) * plane_size();
  }
  T& operator()(int c, int y, int x) const {
    assert(y >= 0 && y < height && x >= 0 && x < width);
    return plane(c)[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                    static_cast<std::size_t>(x)];
  }

  template <typename U>
  constexpr bool same_shape(const TensorView<U>& other) const {
    return channels == other.channels && height == other.height && width == other.width;
  }
};

}  // namespace dynslam
