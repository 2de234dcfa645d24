// What channel and spatial attention do to a map, raw pointers only.
#pragma once

#include <cstddef>

namespace dynslam::attention::detail {

/// Sum and largest of `count` values. The largest is unspecified if one is NaN: the sum says so.
void pool_values(const float* values, std::size_t count, float* sum, float* largest);

/// gates[c] = sigmoid(W1 (relu(W0 mean + b0) + relu(W0 largest + b0)) + 2 b1).
struct Perceptron {
  int channels = 0;
  int reduced = 0;
  const float* hidden_weight = nullptr;  ///< reduced x channels
  const float* hidden_bias = nullptr;    ///< reduced, or null
  const float* output_weight = nullptr;  ///< channels x reduced
  const float* output_bias = nullptr;    ///< channels, or null
};
void channel_gates(const Perceptron& perceptron, const float* mean, const float* largest,
                   float* hidden, float* gates);

/// `count` neighbouring pixels of every channel of a CHW map.
struct Pixels {
  const float* input = nullptr;  ///< first of the pixels, in channel 0
  std::size_t plane = 0;         ///< floats from channel to channel
  int channels = 0;
  std::size_t count = 0;
};

/// largest[p] = max_c x[c][p] g[c], mean[p] = mean_c x[c][p] g[c]; g is 1 if `gates` is null.
void pool_channels(const Pixels& pixels, const float* gates, float* largest, float* mean);

/// One row of sigmoid(conv([max; mean]) + bias) from two padded maps.
struct SpatialRow {
  const float* largest = nullptr;  ///< top left of the window of the row's first pixel
  const float* mean = nullptr;
  std::size_t pitch = 0;
  const float* weight = nullptr;  ///< 2 x kernel x kernel
  float bias = 0.0F;
  int kernel = 7;
  int width = 0;
};
void spatial_gates(const SpatialRow& row, float* gates);

/// sums[c] += sum_p x[c][p] s[p], largest[c] = max(largest[c], x[c][p] s[p]), for the channels
/// [first, last).
void pool_gated(const Pixels& pixels, const float* spatial, int first, int last, float* sums,
                float* largest);

/// out[c][p] = x[c][p] g[c] s[p] (or without one of them, if null). With `stream` past the caches.
void apply_gates(const Pixels& pixels, const float* gates, const float* spatial, bool stream,
                 float* output);

}  // namespace dynslam::attention::detail
