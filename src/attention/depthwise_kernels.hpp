// Depthwise convolutions, one channel at a time, raw pointers only.
#pragma once

#include <cstddef>

#include "dynslam/attention/weights.hpp"

namespace dynslam::attention::detail {

/// Floats behind the end of a row that kernels may read.
inline constexpr std::size_t kRowSlack = 16;

/// One channel of a depthwise K x K convolution, padded by (K - 1) / 2 zeros.
struct DepthwisePlane {
  const float* weight = nullptr;  ///< kernel x kernel
  float bias = 0.0F;
  int kernel = 3;
  int stride = 1;
  Activation activation = Activation::kNone;
  const float* input = nullptr;  ///< height x width
  int height = 0;
  int width = 0;
  const float* add = nullptr;  ///< added to the result (after the activation), or null
  float* output = nullptr;
  float* scratch = nullptr;  ///< depthwise_scratch(kernel, height, width) floats
};

inline std::size_t padded_pitch(int kernel, int width) {
  return static_cast<std::size_t>(width) + static_cast<std::size_t>(kernel) + 2 * kRowSlack;
}
inline std::size_t depthwise_scratch(int kernel, int height, int width) {
  return (static_cast<std::size_t>(height) + static_cast<std::size_t>(kernel)) *
             padded_pitch(kernel, width) +
         2 * kRowSlack;
}

void depthwise(const DepthwisePlane& plane);

/// One channel of DFC attention behind its 1x1 convolution:
/// output = features * upsample(sigmoid(vertical(horizontal(map)))).
struct DfcPlane {
  const float* map = nullptr;  ///< map_height x map_width
  int map_height = 0;
  int map_width = 0;
  const float* horizontal = nullptr;  ///< kernel values
  const float* vertical = nullptr;    ///< kernel values
  float horizontal_bias = 0.0F;
  float vertical_bias = 0.0F;
  int horizontal_kernel = 5;
  int vertical_kernel = 5;
  const float* features = nullptr;  ///< height x width
  float* output = nullptr;          ///< height x width; may be `features`
  int height = 0;
  int width = 0;
  float* scratch = nullptr;  ///< dfc_scratch(...) floats
};

inline std::size_t dfc_scratch(int horizontal_kernel, int vertical_kernel, int map_height,
                               int map_width, int width) {
  // Rows with zeros between them, twice, the second time with rows of zeros above and below.
  const std::size_t pitch =
      static_cast<std::size_t>(map_width) + static_cast<std::size_t>(horizontal_kernel);
  return (2 * static_cast<std::size_t>(map_height) + static_cast<std::size_t>(vertical_kernel) +
          2) *
             pitch +
         static_cast<std::size_t>(width) + 8 * kRowSlack;
}

void dfc_plane(const DfcPlane& plane);

/// out[i] = a[i] + b[i].
void add(const float* a, const float* b, float* out, std::size_t count);

/// out[c][y][x] += up(coarse)[c][y][x], the nearest, for one plane.
void add_upsampled(const float* coarse, int coarse_height, int coarse_width, float* out, int height,
                   int width);

/// Place i of an axis of `size`, taken from the nearest of `source_size`: in float, as PyTorch's
/// and ONNX's "asymmetric, floor" do.
inline int nearest_source(int i, int size, int source_size) {
  const float scale = static_cast<float>(source_size) / static_cast<float>(size);
  const int source = static_cast<int>(static_cast<float>(i) * scale);
  return source < source_size ? source : source_size - 1;
}

}  // namespace dynslam::attention::detail
