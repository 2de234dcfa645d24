// DFC attention (decoupled fully connected), GhostNetV2's.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "dynslam/attention/executor.hpp"
#include "dynslam/attention/tensor_batch.hpp"
#include "dynslam/attention/weights.hpp"
#include "dynslam/attention/workspace.hpp"

namespace dynslam::attention {

/// DFC attention as published and deployed:
///
///     map    = sigmoid( Kx1( 1xK( 1x1( pool2(input) ) ) ) )     C x floor(H/2) x floor(W/2)
///     output = features * nearest_upsample(map)                 C x H x W
///
/// pool2 is the mean over 2x2 with stride 2; a last odd row or column is left out, as in PyTorch.
/// The depthwise convolutions pad by zeros, normalization is folded in, and the upsampling takes
/// map[floor(y h / H)], computed in float as PyTorch and ONNX do. Everything behind the 1x1 works
/// on one channel at a time: no intermediate larger than the half-resolution map is written.
///
/// Immutable and cheap to copy; one object may be used by many threads at once, each with its own
/// Workspace. Results depend on the vector instructions of the machine in the last bits (sums are
/// fused where the machine can), not on the executor. NaN in the input or features gives NaN
/// wherever the equations carry it.
///
/// Source: Tang et al., "GhostNetV2: Enhance Cheap Operation with Long-Range Attention", 2022.
class DfcAttention {
 public:
  /// Throws InvalidArgument if the weights do not fit together.
  explicit DfcAttention(const DfcWeights& weights);

  int in_channels() const;
  int out_channels() const;

  /// Floats that `run` needs in its workspace for maps of this size, cut into `tasks`.
  std::size_t workspace_size(int height, int width, int tasks = 1) const;

  /// output = features * attention(input). `input` is in_channels() x H x W, the others
  /// out_channels() x H x W with H, W >= 2; all have the same batch size.
  ///
  /// `output` may be the same view as `features` or, with equal channels, as `input`; any other
  /// overlap throws. Throws InvalidArgument for empty or mismatched views; outputs are then
  /// untouched. O(batch H W (C_in C / 4 + K C / 2)); allocates only if an owned workspace has to
  /// grow.
  void run(TensorBatch<const float> input, TensorBatch<const float> features,
           TensorBatch<float> output, Workspace& workspace, Executor executor = {}) const;

 private:
  struct Impl;
  std::shared_ptr<const Impl> impl_;
};

/// DFC attention in its general form, kernels as long as the map:
///
///     a'[c,h,w] = sum_h' FH[c,h,h',w] z[c,h',w]
///     a [c,h,w] = sum_w' FW[c,h,w,w'] a'[c,h,w']
///
/// without pooling, normalization or sigmoid: what the paper derives the deployed form from.
/// Thread-safety, NaN and determinism as DfcAttention.
class FullDfcAttention {
 public:
  /// Throws InvalidArgument if an array has not the length that the sizes ask for.
  explicit FullDfcAttention(FullDfcWeights weights);

  int channels() const;
  int height() const;
  int width() const;
  std::size_t workspace_size(int tasks = 1) const;

  /// a from z, both channels() x height() x width(). `output` may be the same view as `input`; any
  /// other overlap throws InvalidArgument, as do other shapes. O(batch C H W (H + W)).
  void run(TensorBatch<const float> input, TensorBatch<float> output, Workspace& workspace,
           Executor executor = {}) const;

 private:
  std::shared_ptr<const FullDfcWeights> weights_;
};

}  // namespace dynslam::attention
