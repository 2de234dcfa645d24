// Convolution as a matrix product, raw pointers only.
#pragma once

#include <cstddef>
#include <vector>

#include "dynslam/attention/weights.hpp"

namespace dynslam::attention::detail {

/// Output channels that stand together in packed weights.
inline constexpr int kPackedRows = 8;
/// Most pixels of a panel, three of the widest vectors.
inline constexpr std::size_t kPanelPixels = 48;

/// Weights of a 1x1 (or K x K, unrolled) convolution over all input channels, laid out for
/// `multiply`: blocks of kPackedRows output channels, in each `depth` columns.
struct PackedWeights {
  int rows = 0;
  int depth = 0;
  std::vector<float> values;
  std::vector<float> bias;
};

PackedWeights pack(const Convolution& convolution);

/// Where the matrix product finds pixel p of channel c.
enum class Source {
  kPlain,    ///< input[c][p]
  kPooled2,  ///< mean of the 2x2 pixels of the map below pixel p of the halved map
  kWindow3,  ///< depth is 9 channels: the 3x3 neighbours of pixel p, 0 outside of the map
};

struct Product {
  const PackedWeights* weights = nullptr;
  Source source = Source::kPlain;
  Activation activation = Activation::kNone;
  const float* input = nullptr;  ///< CHW, height x width planes
  int height = 0;
  int width = 0;
  float* output = nullptr;        ///< row r of the weights goes to output + r output_stride
  std::size_t output_stride = 0;  ///< in floats
  std::size_t begin = 0;          ///< pixels of the output
  std::size_t end = 0;
  float* panel = nullptr;  ///< panel_size(weights) floats
};

inline std::size_t panel_size(const PackedWeights& weights) {
  return static_cast<std::size_t>(weights.depth) * kPanelPixels;
}

/// output[r][p] = activation(bias[r] + sum_k weights[r][k] source[k][p]).
void multiply(const Product& product);

/// c (m x n) = a (m x k) b (k x n), all by rows without gaps.
void multiply_small(const float* a, const float* b, float* c, int m, int k, int n);

/// out[i][x] = sum_j a[i][j][x] b[j][x] for i < m, j < k, x < n.
void multiply_columns(const float* a, const float* b, float* out, int m, int k, int n);

}  // namespace dynslam::attention::detail
