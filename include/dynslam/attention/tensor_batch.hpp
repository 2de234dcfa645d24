// View of a batch of feature maps that somebody else owns.
#pragma once

#include <cassert>
#include <cstddef>
#include <type_traits>

#include "dynslam/core/tensor_view.hpp"

namespace dynslam::attention {

/// `batch` feature maps of one shape, contiguous one behind the other (NCHW). Trivially copyable;
/// pass by value; never outlives the values. One TensorView reads as a batch of one.
template <typename T>
struct TensorBatch {
  using element_type = T;

  T* data = nullptr;
  int batch = 0;
  int channels = 0;
  int height = 0;
  int width = 0;

  constexpr TensorBatch() = default;
  constexpr TensorBatch(T* data_, int batch_, int channels_, int height_, int width_)
      : data(data_), batch(batch_), channels(channels_), height(height_), width(width_) {}
  constexpr TensorBatch(TensorView<T> image)
      : TensorBatch(image.data, 1, image.channels, image.height, image.width) {}

  /// A view of mutable values reads as a view of const ones.
  template <typename U,
            typename = std::enable_if_t<std::is_same_v<const U, T> && !std::is_const_v<U>>>
  constexpr TensorBatch(TensorBatch<U> other)
      : TensorBatch(other.data, other.batch, other.channels, other.height, other.width) {}
  template <typename U,
            typename = std::enable_if_t<std::is_same_v<const U, T> && !std::is_const_v<U>>>
  constexpr TensorBatch(TensorView<U> image)
      : TensorBatch(image.data, 1, image.channels, image.height, image.width) {}

  constexpr bool empty() const {
    return data == nullptr || batch <= 0 || channels <= 0 || height <= 0 || width <= 0;
  }
  constexpr std::size_t image_size() const {
    return static_cast<std::size_t>(channels) * static_cast<std::size_t>(height) *
           static_cast<std::size_t>(width);
  }
  constexpr std::size_t size() const { return static_cast<std::size_t>(batch) * image_size(); }

  TensorView<T> image(int n) const {
    assert(n >= 0 && n < batch);
    return {data + static_cast<std::size_t>(n) * image_size(), channels, height, width};
  }
};

}  // namespace dynslam::attention
