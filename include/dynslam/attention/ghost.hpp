// Ghost module, GhostNetV2 bottleneck and the C3 block made of them.
#pragma once

#include <cstddef>
#include <memory>

#include "dynslam/attention/executor.hpp"
#include "dynslam/attention/tensor_batch.hpp"
#include "dynslam/attention/weights.hpp"
#include "dynslam/attention/workspace.hpp"

namespace dynslam::attention {

// All three layers are immutable, cheap to copy and may be used by many threads at once, each with
// its own Workspace. Results depend on the vector instructions of the machine in the last bits, not
// on the executor. NaN propagates as the equations carry it. Empty or mismatched views throw
// InvalidArgument and leave the output untouched; calls allocate only if an owned workspace has to
// grow.

/// Ghost module: half of the channels by a 1x1 convolution, the other half by a depthwise one.
///
///     p = act(primary(x)),  g = act(cheap(p)),  y = [p; g] cut to out_channels
///
/// Source: Han et al., "GhostNet", CVPR 2020.
class GhostModule {
 public:
  /// Throws InvalidArgument if the weights do not fit together.
  explicit GhostModule(const GhostModuleWeights& weights);

  int in_channels() const;
  int out_channels() const;
  std::size_t workspace_size(int height, int width, int tasks = 1) const;

  /// in_channels() x H x W to out_channels() x H x W. `output` must not overlap `input` (throws).
  void run(TensorBatch<const float> input, TensorBatch<float> output, Workspace& workspace,
           Executor executor = {}) const;

 private:
  struct Impl;
  std::shared_ptr<const Impl> impl_;
};

/// GhostNetV2 bottleneck:
///
///     e = expand(x) * dfc(x),  d = downsample(e) (stride 2) or e,  y = project(d) + shortcut(x)
///
/// Source: Tang et al., "GhostNetV2", 2022. Departure: no squeeze-and-excitation, which
/// P-Static's blocks do not have.
class GhostBottleneck {
 public:
  /// Throws InvalidArgument if the weights do not fit together.
  explicit GhostBottleneck(const GhostBottleneckWeights& weights);

  int in_channels() const;
  int out_channels() const;
  int stride() const;
  /// Rows (columns) of the output for so many of the input: (n - 1) / stride + 1.
  int output_size(int size) const;
  std::size_t workspace_size(int height, int width, int tasks = 1) const;

  /// in_channels() x H x W to out_channels() x output_size(H) x output_size(W); H, W >= 2 where
  /// there is an attention. `output` must not overlap `input` (throws).
  void run(TensorBatch<const float> input, TensorBatch<float> output, Workspace& workspace,
           Executor executor = {}) const;

 private:
  struct Impl;
  std::shared_ptr<const Impl> impl_;
};

/// GhostV2C3, P-Static's replacement for YOLOv5's C3:
///
///     a = act(cv1(x)),  b = act(cv2(x)),  a = bottleneck_i(a) ...,  y = act(cv3([a; b]))
///
/// cv1 and cv2 are one matrix product, the branches are joined without a copy, and activations,
/// shortcuts and the attention's product are applied where their operand is computed.
///
/// Source: P-Static (LOP 2024) with the C3 of YOLOv5 6.0 and GhostNetV2's bottleneck.
class GhostC3 {
 public:
  /// Throws InvalidArgument if the weights do not fit together or a bottleneck has a stride.
  explicit GhostC3(const GhostC3Weights& weights);

  int in_channels() const;
  int out_channels() const;
  std::size_t workspace_size(int height, int width, int tasks = 1) const;

  /// in_channels() x H x W to out_channels() x H x W; H, W >= 2 where there is an attention.
  /// `output` may be the same view as `input`; any other overlap throws.
  void run(TensorBatch<const float> input, TensorBatch<float> output, Workspace& workspace,
           Executor executor = {}) const;

 private:
  struct Impl;
  std::shared_ptr<const Impl> impl_;
};

}  // namespace dynslam::attention
