// The operations that layers are made of, as plain loops; see reference.hpp.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "dynslam/attention/weights.hpp"
#include "dynslam/core/tensor_view.hpp"

namespace dynslam::attention::reference {

/// A feature map that owns its values (CHW).
struct Map {
  int channels = 0;
  int height = 0;
  int width = 0;
  std::vector<float> values;

  Map() = default;
  Map(int c, int h, int w)
      : channels(c),
        height(h),
        width(w),
        values(static_cast<std::size_t>(c) * static_cast<std::size_t>(h) *
               static_cast<std::size_t>(w)) {}
  explicit Map(TensorView<const float> view) : Map(view.channels, view.height, view.width) {
    values.assign(view.data, view.data + view.size());
  }

  float& operator()(int c, int y, int x) { return values[index(c, y, x)]; }
  float operator()(int c, int y, int x) const { return values[index(c, y, x)]; }
  TensorView<const float> view() const { return {values.data(), channels, height, width}; }

 private:
  std::size_t index(int c, int y, int x) const {
    return (static_cast<std::size_t>(c) * static_cast<std::size_t>(height) +
            static_cast<std::size_t>(y)) *
               static_cast<std::size_t>(width) +
           static_cast<std::size_t>(x);
  }
};

inline float sigmoid(float x) {
  return static_cast<float>(1.0 / (1.0 + std::exp(-static_cast<double>(x))));
}

inline float activate(float x, Activation activation) {
  if (activation == Activation::kRelu) return x < 0.0F ? 0.0F : x;
  if (activation == Activation::kSilu) return x * sigmoid(x);
  return x;
}

/// Convolution padded by zeros to (K - 1) / 2 on each side; depthwise where a kernel sees one
/// channel. y[o,h,w] = act(b[o] + sum_{i,u,v} w[o,i,u,v] x[i, s h + u - p, s w + v - p]).
inline Map convolve(const Map& x, const Convolution& conv, int stride = 1,
                    Activation activation = Activation::kNone) {
  const int pad_y = (conv.kernel_height - 1) / 2;
  const int pad_x = (conv.kernel_width - 1) / 2;
  const bool depthwise = conv.group_channels == 1 && x.channels != 1;
  Map y(conv.out_channels, (x.height - 1) / stride + 1, (x.width - 1) / stride + 1);
  for (int o = 0; o < y.channels; ++o) {
    for (int h = 0; h < y.height; ++h) {
      for (int w = 0; w < y.width; ++w) {
        double sum = conv.bias.empty() ? 0.0 : conv.bias[static_cast<std::size_t>(o)];
        std::size_t k = static_cast<std::size_t>(o) *
                        (conv.weight.size() / static_cast<std::size_t>(y.channels));
        for (int i = 0; i < conv.group_channels; ++i) {
          for (int u = 0; u < conv.kernel_height; ++u) {
            for (int v = 0; v < conv.kernel_width; ++v, ++k) {
              const int row = stride * h + u - pad_y;
              const int column = stride * w + v - pad_x;
              if (row < 0 || row >= x.height || column < 0 || column >= x.width) continue;
              sum += static_cast<double>(conv.weight[k]) * x(depthwise ? o : i, row, column);
            }
          }
        }
        y(o, h, w) = activate(static_cast<float>(sum), activation);
      }
    }
  }
  return y;
}

/// Mean over 2x2 with stride 2; a last odd row or column is left out.
inline Map average_pool2(const Map& x) {
  Map y(x.channels, x.height / 2, x.width / 2);
  for (int c = 0; c < y.channels; ++c) {
    for (int h = 0; h < y.height; ++h) {
      for (int w = 0; w < y.width; ++w) {
        y(c, h, w) = 0.25F * (x(c, 2 * h, 2 * w) + x(c, 2 * h, 2 * w + 1) + x(c, 2 * h + 1, 2 * w) +
                              x(c, 2 * h + 1, 2 * w + 1));
      }
    }
  }
  return y;
}

/// Place i of an axis of `size`, taken from the nearest of `source_size`, in float as PyTorch does.
inline int nearest_source(int i, int size, int source_size) {
  const float scale = static_cast<float>(source_size) / static_cast<float>(size);
  const int source = static_cast<int>(static_cast<float>(i) * scale);
  return source < source_size ? source : source_size - 1;
}

inline Map upsample_nearest(const Map& x, int height, int width) {
  Map y(x.channels, height, width);
  for (int c = 0; c < y.channels; ++c) {
    for (int h = 0; h < height; ++h) {
      for (int w = 0; w < width; ++w) {
        y(c, h, w) = x(c, nearest_source(h, height, x.height), nearest_source(w, width, x.width));
      }
    }
  }
  return y;
}

}  // namespace dynslam::attention::reference
