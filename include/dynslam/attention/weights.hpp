// What the layers have learned, as plain arrays.
#pragma once

#include <cstddef>
#include <optional>
#include <string_view>
#include <vector>

#include "dynslam/core/span.hpp"

namespace dynslam::attention {

/// The function behind a convolution.
enum class Activation {
  kNone,
  kRelu,  ///< max(x, 0); NaN stays NaN
  kSilu,  ///< x sigmoid(x)
};

/// A convolution with whatever normalization follows it folded in. `weight` is laid out
/// out_channels x group_channels x kernel_height x kernel_width, PyTorch's layout.
struct Convolution {
  int out_channels = 0;
  /// Input channels that one output channel sees: all of them, or 1 if depthwise.
  int group_channels = 0;
  int kernel_height = 1;
  int kernel_width = 1;
  std::vector<float> weight;
  /// out_channels values, or empty for none.
  std::vector<float> bias;

  /// Throws InvalidArgument naming `function` and `name` if a size is not positive or an array has
  /// another length than the sizes say.
  void validate(std::string_view function, std::string_view name) const;
};

/// Batch normalization as it is applied after training; all four arrays have one entry a channel.
struct BatchNorm {
  Span<const float> gamma;
  Span<const float> beta;
  Span<const float> mean;
  Span<const float> variance;
  /// Added to the variance, > 0. PyTorch 1e-5, YOLOv5 1e-3.
  float epsilon = 1e-5F;
};

/// The convolution that does what `convolution` followed by `norm` does:
/// w' = w gamma / sqrt(var + eps), b' = (b - mean) gamma / sqrt(var + eps) + beta, computed in
/// double. Throws InvalidArgument if a length differs from the number of output channels, epsilon
/// is not positive or var + eps is not.
Convolution fold_batch_norm(Convolution convolution, const BatchNorm& norm);

/// DFC attention, deployed form: 1x1 (C_in to C), then depthwise 1xK and Kx1, K odd.
struct DfcWeights {
  Convolution pointwise;
  Convolution horizontal;  ///< depthwise, kernel 1 x K
  Convolution vertical;    ///< depthwise, kernel K x 1

  void validate(std::string_view function) const;
};

/// Weights of the general form, for maps of one size only. Either both matrices are shared along
/// the other axis, `vertical` C x H x H and `horizontal` C x W x W, or neither is, `vertical`
/// C x H x H x W (c, h, h', w) and `horizontal` C x H x W x W (c, h, w, w').
struct FullDfcWeights {
  int channels = 0;
  int height = 0;
  int width = 0;
  bool shared = true;
  std::vector<float> vertical;
  std::vector<float> horizontal;

  void validate(std::string_view function) const;
};

/// Ghost module: `primary` (1x1) makes P channels, `cheap` (depthwise KxK, K odd, on the primary
/// ones) up to P more; the first `out_channels` of both together are kept, P <= out_channels <= 2P.
struct GhostModuleWeights {
  Convolution primary;
  Convolution cheap;
  int out_channels = 0;
  Activation activation = Activation::kRelu;

  void validate(std::string_view function) const;
};

/// GhostNetV2 bottleneck. With stride 2 `downsample` is there; where the shortcut is not the
/// identity, `shortcut_depthwise` and `shortcut_pointwise` are.
struct GhostBottleneckWeights {
  GhostModuleWeights expand;
  /// The attention over `expand`'s output; none: GhostNetV1's bottleneck.
  std::optional<DfcWeights> attention;
  /// Depthwise KxK, K odd, of stride `stride`, on expand.out_channels channels.
  std::optional<Convolution> downsample;
  GhostModuleWeights project;
  std::optional<Convolution> shortcut_depthwise;  ///< on the input, of stride `stride`
  std::optional<Convolution> shortcut_pointwise;  ///< 1x1 behind it
  /// Whether the (possibly transformed) input is added; off for YOLOv5's neck.
  bool shortcut = true;
  /// 1 or 2.
  int stride = 1;

  int in_channels() const { return expand.primary.group_channels; }
  int out_channels() const { return project.out_channels; }
  void validate(std::string_view function) const;
};

/// YOLOv5's C3 block with GhostNetV2 bottlenecks: cv1 and cv2 (1x1) on the input, the bottlenecks
/// on cv1's branch, cv3 (1x1) on both branches together (cv1's first).
struct GhostC3Weights {
  Convolution cv1;
  Convolution cv2;
  Convolution cv3;
  std::vector<GhostBottleneckWeights> bottlenecks;
  /// Behind cv1, cv2 and cv3; YOLOv5: SiLU.
  Activation activation = Activation::kSilu;

  int in_channels() const { return cv1.group_channels; }
  int out_channels() const { return cv3.out_channels; }
  void validate(std::string_view function) const;
};

/// CBAM: the two-layer perceptron of the channel attention (the matrices by rows) and the
/// convolution over [max; mean] of the spatial one.
struct CbamWeights {
  int channels = 0;
  /// Width of the hidden layer, 1..channels; CBAM: channels / 16.
  int reduced = 0;
  std::vector<float> hidden_weight;  ///< reduced x channels
  std::vector<float> hidden_bias;    ///< reduced, or empty
  std::vector<float> output_weight;  ///< channels x reduced
  std::vector<float> output_bias;    ///< channels, or empty
  /// 1 x 2 x K x K, K odd (7 in the papers).
  Convolution spatial;

  void validate(std::string_view function) const;
};

/// One level of the mixed-attention feature pyramid.
struct FpnLevelWeights {
  Convolution lateral;    ///< 1x1 to the pyramid's channels
  CbamWeights attention;  ///< over the pyramid's channels
  Convolution smooth;     ///< 3x3 against aliasing

  void validate(std::string_view function) const;
};

}  // namespace dynslam::attention
