// The pieces that layers are made of, on raw pointers: weights packed once, work cut into tasks.
#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <vector>

#include "dynslam/attention/executor.hpp"
#include "dynslam/attention/weights.hpp"

#include "attention/arena.hpp"
#include "attention/depthwise_kernels.hpp"
#include "attention/pointwise_kernels.hpp"

namespace dynslam::attention::detail {

/// Size of a map.
struct Extent {
  int height = 0;
  int width = 0;
  std::size_t pixels() const {
    return static_cast<std::size_t>(height) * static_cast<std::size_t>(width);
  }
};

/// body(begin, end, task) over [0, count) cut into at most executor.tasks() pieces at multiples of
/// `grain`. What is computed for an element does not depend on the cut.
template <typename Body>
void split(const Executor& executor, std::size_t count, std::size_t grain, const Body& body) {
  const std::size_t grains = (count + grain - 1) / grain;
  const std::size_t tasks = std::min(grains, static_cast<std::size_t>(executor.tasks()));
  executor.run(static_cast<int>(tasks), [&](int index) {
    const auto task = static_cast<std::size_t>(index);
    const std::size_t begin = grains * task / tasks * grain;
    const std::size_t end = std::min(count, grains * (task + 1) / tasks * grain);
    body(begin, end, task);
  });
}

/// A product over all pixels of an output of `extent`; `panels` has panel_size(...) floats a task.
void multiply_all(Product product, Extent extent, float* panels, const Executor& executor);

struct PackedDfc {
  PackedWeights pointwise;
  Convolution horizontal;
  Convolution vertical;

  explicit PackedDfc(const DfcWeights& weights);
  int channels() const { return pointwise.rows; }
  DfcPlane plane(int channel) const;
  std::size_t scratch(Extent extent) const;
};

/// A depthwise convolution whose biases are never missing.
struct PackedDepthwise {
  Convolution convolution;

  explicit PackedDepthwise(const Convolution& weights);
  DepthwisePlane plane(int channel) const;
};

struct PackedGhost {
  PackedWeights primary;
  PackedDepthwise cheap;
  int out_channels;
  Activation activation;

  explicit PackedGhost(const GhostModuleWeights& weights);
  int in_channels() const { return primary.depth; }
};

/// Ghost module with what may follow it. `primary` holds primary.rows planes and may be the first
/// planes of `output` if `add` is null and there is no attention.
struct GhostStep {
  const PackedGhost* ghost = nullptr;
  const float* input = nullptr;
  Extent extent;
  float* primary = nullptr;
  float* output = nullptr;
  const float* add = nullptr;  ///< shortcut, output's shape, may be `output`; or null
  const PackedDfc* attention = nullptr;
  const float* map = nullptr;  ///< attention's map before its depthwise convolutions
  float* panels = nullptr;     ///< panel_size floats a task
  float* scratch = nullptr;    ///< `scratch_size` floats a task
  std::size_t scratch_size = 0;
};
void run_ghost(const GhostStep& step, const Executor& executor);

/// GhostNetV2 bottleneck on one image.
struct PackedBottleneck {
  PackedGhost expand;
  PackedGhost project;
  std::optional<PackedDfc> attention;
  std::optional<PackedDepthwise> downsample;
  std::optional<PackedDepthwise> shortcut_depthwise;
  std::optional<PackedWeights> shortcut_pointwise;
  bool shortcut;
  int stride;

  explicit PackedBottleneck(const GhostBottleneckWeights& weights);
  Extent output_extent(Extent extent) const {
    return {(extent.height - 1) / stride + 1, (extent.width - 1) / stride + 1};
  }

  struct Buffers {
    float* primary = nullptr;
    float* expanded = nullptr;
    float* reduced = nullptr;
    float* map = nullptr;
    float* shortcut = nullptr;
    float* thinned = nullptr;
    float* panels = nullptr;
    float* scratch = nullptr;
    std::size_t scratch_size = 0;
  };
  Buffers take(Arena& arena, Extent extent, int tasks) const;

  /// `output` may be `input` where stride is 1 and the shortcut, if any, is the identity.
  void run(const float* input, Extent extent, float* output, const Buffers& buffers,
           const Executor& executor) const;

 private:
  const float* run_shortcut(const float* input, Extent extent, const Buffers& buffers,
                            const Executor& executor) const;
};

/// Every channel of a depthwise convolution.
void depthwise_all(const PackedDepthwise& weights, int channels, const float* input, Extent extent,
                   int stride, float* output, float* scratch, std::size_t scratch_size,
                   const Executor& executor);

}  // namespace dynslam::attention::detail
