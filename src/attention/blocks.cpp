#include "attention/blocks.hpp"

namespace dynslam::attention::detail {
namespace {

Convolution with_bias(Convolution convolution) {
  convolution.bias.resize(static_cast<std::size_t>(convolution.out_channels), 0.0F);
  return convolution;
}

std::size_t planes(int channels, Extent extent) {
  return static_cast<std::size_t>(channels) * extent.pixels();
}

Extent halved(Extent extent) { return {extent.height / 2, extent.width / 2}; }

}  // namespace

void multiply_all(Product product, Extent extent, float* panels, const Executor& executor) {
  const std::size_t size = panel_size(*product.weights);
  split(executor, extent.pixels(), kPanelPixels,
        [&](std::size_t begin, std::size_t end, std::size_t task) {
          Product part = product;
          part.begin = begin;
          part.end = end;
          part.panel = panels + task * size;
          multiply(part);
        });
}

PackedDfc::PackedDfc(const DfcWeights& weights)
    : pointwise(pack(weights.pointwise)),
      horizontal(with_bias(weights.horizontal)),
      vertical(with_bias(weights.vertical)) {}

DfcPlane PackedDfc::plane(int channel) const {
  const auto c = static_cast<std::size_t>(channel);
  DfcPlane plane;
  plane.horizontal_kernel = horizontal.kernel_width;
  plane.vertical_kernel = vertical.kernel_height;
  plane.horizontal = &horizontal.weight[c * static_cast<std::size_t>(plane.horizontal_kernel)];
  plane.vertical = &vertical.weight[c * static_cast<std::size_t>(plane.vertical_kernel)];
  plane.horizontal_bias = horizontal.bias[c];
  plane.vertical_bias = vertical.bias[c];
  return plane;
}

std::size_t PackedDfc::scratch(Extent extent) const {
  return dfc_scratch(horizontal.kernel_width, vertical.kernel_height, extent.height / 2,
                     extent.width / 2, extent.width);
}

PackedDepthwise::PackedDepthwise(const Convolution& weights) : convolution(with_bias(weights)) {}

DepthwisePlane PackedDepthwise::plane(int channel) const {
  const auto c = static_cast<std::size_t>(channel);
  const auto taps = static_cast<std::size_t>(convolution.kernel_height) *
                    static_cast<std::size_t>(convolution.kernel_width);
  DepthwisePlane plane;
  plane.weight = &convolution.weight[c * taps];
  plane.bias = convolution.bias[c];
  plane.kernel = convolution.kernel_width;
  return plane;
}

PackedGhost::PackedGhost(const GhostModuleWeights& weights)
    : primary(pack(weights.primary)),
      cheap(weights.cheap),
      out_channels(weights.out_channels),
      activation(weights.activation) {}

void run_ghost(const GhostStep& step, const Executor& executor) {
  const PackedGhost& ghost = *step.ghost;
  const std::size_t plane = step.extent.pixels();
  Product product;
  product.weights = &ghost.primary;
  product.activation = ghost.activation;
  product.input = step.input;
  product.height = step.extent.height;
  product.width = step.extent.width;
  product.output = step.primary;
  product.output_stride = plane;
  multiply_all(product, step.extent, step.panels, executor);

  const int rows = ghost.primary.rows;
  const auto finish = [&](int c, float* scratch) {
    const auto channel = static_cast<std::size_t>(c);
    float* out = step.output + channel * plane;
    const float* features = step.primary + channel * plane;
    if (c >= rows) {
      DepthwisePlane cheap = ghost.cheap.plane(c - rows);
      cheap.activation = ghost.activation;
      cheap.input = step.primary + static_cast<std::size_t>(c - rows) * plane;
      cheap.height = step.extent.height;
      cheap.width = step.extent.width;
      cheap.add = step.add == nullptr ? nullptr : step.add + channel * plane;
      cheap.output = out;
      cheap.scratch = scratch;
      depthwise(cheap);
      features = out;
    } else if (step.add != nullptr) {
      add(features, step.add + channel * plane, out, plane);
    } else if (step.attention == nullptr && features != out) {
      std::copy(features, features + plane, out);
    }
    if (step.attention == nullptr) return;
    const Extent half = halved(step.extent);
    DfcPlane gate = step.attention->plane(c);
    gate.map = step.map + channel * half.pixels();
    gate.map_height = half.height;
    gate.map_width = half.width;
    gate.features = features;
    gate.output = out;
    gate.height = step.extent.height;
    gate.width = step.extent.width;
    gate.scratch = scratch;
    dfc_plane(gate);
  };
  split(executor, static_cast<std::size_t>(ghost.out_channels), 1,
        [&](std::size_t begin, std::size_t end, std::size_t task) {
          for (std::size_t c = begin; c < end; ++c) {
            finish(static_cast<int>(c), step.scratch + task * step.scratch_size);
          }
        });
}

void depthwise_all(const PackedDepthwise& weights, int channels, const float* input, Extent extent,
                   int stride, float* output, float* scratch, std::size_t scratch_size,
                   const Executor& executor) {
  const Extent to = {(extent.height - 1) / stride + 1, (extent.width - 1) / stride + 1};
  split(executor, static_cast<std::size_t>(channels), 1,
        [&](std::size_t begin, std::size_t end, std::size_t task) {
          for (std::size_t c = begin; c < end; ++c) {
            DepthwisePlane plane = weights.plane(static_cast<int>(c));
            plane.stride = stride;
            plane.input = input + c * extent.pixels();
            plane.height = extent.height;
            plane.width = extent.width;
            plane.output = output + c * to.pixels();
            plane.scratch = scratch + task * scratch_size;
            depthwise(plane);
          }
        });
}

PackedBottleneck::PackedBottleneck(const GhostBottleneckWeights& weights)
    : expand(weights.expand),
      project(weights.project),
      shortcut(weights.shortcut),
      stride(weights.stride) {
  if (weights.attention) attention.emplace(*weights.attention);
  if (weights.downsample) downsample.emplace(*weights.downsample);
  if (weights.shortcut && weights.shortcut_depthwise) {
    shortcut_depthwise.emplace(*weights.shortcut_depthwise);
  }
  if (weights.shortcut && weights.shortcut_pointwise) {
    shortcut_pointwise = pack(*weights.shortcut_pointwise);
  }
}

PackedBottleneck::Buffers PackedBottleneck::take(Arena& arena, Extent extent, int tasks) const {
  const Extent small = output_extent(extent);
  const auto pieces = static_cast<std::size_t>(std::max(1, tasks));
  Buffers buffers;
  // The second module's primary channels may stand where the first one's stood.
  buffers.primary = arena.take(
      std::max(planes(expand.primary.rows, extent), planes(project.primary.rows, small)));
  buffers.expanded = arena.take(planes(expand.out_channels, extent));
  std::size_t panel = std::max(panel_size(expand.primary), panel_size(project.primary));
  std::size_t scratch = std::max(
      depthwise_scratch(expand.cheap.convolution.kernel_width, extent.height, extent.width),
      depthwise_scratch(project.cheap.convolution.kernel_width, small.height, small.width));
  const auto need = [&](const PackedDepthwise& depthwise) {
    scratch = std::max(scratch, depthwise_scratch(depthwise.convolution.kernel_width, extent.height,
                                                  extent.width));
  };
  if (attention) {
    buffers.map = arena.take(planes(attention->channels(), halved(extent)));
    panel = std::max(panel, panel_size(attention->pointwise));
    scratch = std::max(scratch, attention->scratch(extent));
  }
  if (downsample) {
    buffers.reduced = arena.take(planes(expand.out_channels, small));
    need(*downsample);
  }
  if (shortcut_depthwise) {
    buffers.thinned = arena.take(planes(expand.in_channels(), small));
    need(*shortcut_depthwise);
  }
  if (shortcut_pointwise) {
    buffers.shortcut = arena.take(planes(project.out_channels, small));
    panel = std::max(panel, panel_size(*shortcut_pointwise));
  }
  buffers.panels = arena.take(pieces * panel);
  buffers.scratch_size = (scratch + 15) / 16 * 16;
  buffers.scratch = arena.take(pieces * buffers.scratch_size);
  return buffers;
}

const float* PackedBottleneck::run_shortcut(const float* input, Extent extent,
                                            const Buffers& buffers,
                                            const Executor& executor) const {
  if (!shortcut) return nullptr;
  const Extent small = output_extent(extent);
  const float* from = input;
  if (shortcut_depthwise) {
    depthwise_all(*shortcut_depthwise, expand.in_channels(), from, extent, stride, buffers.thinned,
                  buffers.scratch, buffers.scratch_size, executor);
    from = buffers.thinned;
  }
  if (shortcut_pointwise) {
    Product product;
    product.weights = &*shortcut_pointwise;
    product.input = from;
    product.height = small.height;
    product.width = small.width;
    product.output = buffers.shortcut;
    product.output_stride = small.pixels();
    multiply_all(product, small, buffers.panels, executor);
    from = buffers.shortcut;
  }
  return from;
}

void PackedBottleneck::run(const float* input, Extent extent, float* output, const Buffers& buffers,
                           const Executor& executor) const {
  GhostStep step;
  step.ghost = &expand;
  step.input = input;
  step.extent = extent;
  step.primary = attention ? buffers.primary : buffers.expanded;
  step.output = buffers.expanded;
  step.panels = buffers.panels;
  step.scratch = buffers.scratch;
  step.scratch_size = buffers.scratch_size;
  if (attention) {
    const Extent half = halved(extent);
    Product product;
    product.weights = &attention->pointwise;
    product.source = Source::kPooled2;
    product.input = input;
    product.height = extent.height;
    product.width = extent.width;
    product.output = buffers.map;
    product.output_stride = half.pixels();
    multiply_all(product, half, buffers.panels, executor);
    step.attention = &*attention;
    step.map = buffers.map;
  }
  run_ghost(step, executor);

  step.input = buffers.expanded;
  step.extent = output_extent(extent);
  if (downsample) {
    depthwise_all(*downsample, expand.out_channels, buffers.expanded, extent, stride,
                  buffers.reduced, buffers.scratch, buffers.scratch_size, executor);
    step.input = buffers.reduced;
  }
  step.ghost = &project;
  step.attention = nullptr;
  step.add = run_shortcut(input, extent, buffers, executor);
  step.primary = step.add == nullptr ? output : buffers.primary;
  step.output = output;
  run_ghost(step, executor);
}

}  // namespace dynslam::attention::detail
