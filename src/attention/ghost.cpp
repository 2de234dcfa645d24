#include "dynslam/attention/ghost.hpp"

#include <utility>
#include <vector>

#include "attention/blocks.hpp"
#include "attention/checks.hpp"

namespace dynslam::attention {

using detail::Arena;
using detail::Extent;

namespace {

void require_poolable(const TensorBatch<const float>& input, bool pooled, const char* function) {
  require(!pooled || (input.height >= 2 && input.width >= 2), function, "input",
          detail::shape_text(input),
          "a height and width of at least 2, which the attention halves");
}

/// Both convolutions of a C3 block's input as one.
Convolution joined(const Convolution& a, const Convolution& b) {
  Convolution both = a;
  both.out_channels += b.out_channels;
  both.weight.insert(both.weight.end(), b.weight.begin(), b.weight.end());
  both.bias.resize(static_cast<std::size_t>(a.out_channels), 0.0F);
  both.bias.insert(both.bias.end(), b.bias.begin(), b.bias.end());
  both.bias.resize(static_cast<std::size_t>(both.out_channels), 0.0F);
  return both;
}

}  // namespace

struct GhostModule::Impl {
  detail::PackedGhost ghost;

  struct Buffers {
    float* panels = nullptr;
    float* scratch = nullptr;
    std::size_t scratch_size = 0;
  };
  Buffers take(Arena& arena, Extent extent, int tasks) const {
    const auto pieces = static_cast<std::size_t>(std::max(1, tasks));
    Buffers buffers;
    buffers.panels = arena.take(pieces * detail::panel_size(ghost.primary));
    buffers.scratch_size = detail::depthwise_scratch(ghost.cheap.convolution.kernel_width,
                                                     extent.height, extent.width);
    buffers.scratch = arena.take(pieces * buffers.scratch_size);
    return buffers;
  }
};

GhostModule::GhostModule(const GhostModuleWeights& weights) {
  weights.validate("GhostModule");
  impl_ = std::make_shared<const Impl>(Impl{detail::PackedGhost(weights)});
}

int GhostModule::in_channels() const { return impl_->ghost.in_channels(); }
int GhostModule::out_channels() const { return impl_->ghost.out_channels; }

std::size_t GhostModule::workspace_size(int height, int width, int tasks) const {
  Arena arena;
  impl_->take(arena, {height, width}, tasks);
  return arena.total();
}

void GhostModule::run(TensorBatch<const float> input, TensorBatch<float> output,
                      Workspace& workspace, Executor executor) const {
  constexpr const char* kFunction = "GhostModule::run";
  detail::require_channels(input, in_channels(), kFunction, "input");
  detail::require_shape(output, input.batch, out_channels(), input.height, input.width, kFunction,
                        "output");
  detail::require_apart(input, output, false, kFunction);
  Arena arena(workspace, workspace_size(input.height, input.width, executor.tasks()));
  detail::GhostStep step;
  step.ghost = &impl_->ghost;
  step.extent = {input.height, input.width};
  const Impl::Buffers buffers = impl_->take(arena, step.extent, executor.tasks());
  step.panels = buffers.panels;
  step.scratch = buffers.scratch;
  step.scratch_size = buffers.scratch_size;
  for (int n = 0; n < input.batch; ++n) {
    step.input = input.image(n).data;
    step.output = output.image(n).data;
    step.primary = step.output;
    detail::run_ghost(step, executor);
  }
}

struct GhostBottleneck::Impl {
  detail::PackedBottleneck bottleneck;
};

GhostBottleneck::GhostBottleneck(const GhostBottleneckWeights& weights) {
  weights.validate("GhostBottleneck");
  impl_ = std::make_shared<const Impl>(Impl{detail::PackedBottleneck(weights)});
}

int GhostBottleneck::in_channels() const { return impl_->bottleneck.expand.in_channels(); }
int GhostBottleneck::out_channels() const { return impl_->bottleneck.project.out_channels; }
int GhostBottleneck::stride() const { return impl_->bottleneck.stride; }
int GhostBottleneck::output_size(int size) const { return (size - 1) / stride() + 1; }

std::size_t GhostBottleneck::workspace_size(int height, int width, int tasks) const {
  Arena arena;
  impl_->bottleneck.take(arena, {height, width}, tasks);
  return arena.total();
}

void GhostBottleneck::run(TensorBatch<const float> input, TensorBatch<float> output,
                          Workspace& workspace, Executor executor) const {
  constexpr const char* kFunction = "GhostBottleneck::run";
  const detail::PackedBottleneck& bottleneck = impl_->bottleneck;
  detail::require_channels(input, in_channels(), kFunction, "input");
  require_poolable(input, bottleneck.attention.has_value(), kFunction);
  detail::require_shape(output, input.batch, out_channels(), output_size(input.height),
                        output_size(input.width), kFunction, "output");
  detail::require_apart(input, output, false, kFunction);
  const Extent extent = {input.height, input.width};
  Arena arena(workspace, workspace_size(input.height, input.width, executor.tasks()));
  const auto buffers = bottleneck.take(arena, extent, executor.tasks());
  for (int n = 0; n < input.batch; ++n) {
    bottleneck.run(input.image(n).data, extent, output.image(n).data, buffers, executor);
  }
}

struct GhostC3::Impl {
  detail::PackedWeights entry;  ///< cv1 and cv2
  detail::PackedWeights exit;   ///< cv3
  Activation activation;
  std::vector<detail::PackedBottleneck> bottlenecks;
  bool attention = false;

  struct Buffers {
    float* branches = nullptr;
    float* panels = nullptr;
    Arena rest;  ///< what the bottlenecks share
  };
  Buffers take(Arena& arena, Extent extent, int tasks) const {
    const auto pieces = static_cast<std::size_t>(std::max(1, tasks));
    Buffers buffers;
    buffers.branches = arena.take(static_cast<std::size_t>(exit.depth) * extent.pixels());
    buffers.panels =
        arena.take(pieces * std::max(detail::panel_size(entry), detail::panel_size(exit)));
    buffers.rest = arena;
    return buffers;
  }
  std::size_t total(Extent extent, int tasks) const {
    Arena arena;
    take(arena, extent, tasks);
    std::size_t most = arena.total();
    for (const detail::PackedBottleneck& bottleneck : bottlenecks) {
      Arena rest = arena;
      bottleneck.take(rest, extent, tasks);
      most = std::max(most, rest.total());
    }
    return most;
  }
  void run(const float* input, Extent extent, float* output, const Buffers& buffers,
           const Executor& executor) const {
    detail::Product product;
    product.weights = &entry;
    product.activation = activation;
    product.input = input;
    product.height = extent.height;
    product.width = extent.width;
    product.output = buffers.branches;
    product.output_stride = extent.pixels();
    detail::multiply_all(product, extent, buffers.panels, executor);
    for (const detail::PackedBottleneck& bottleneck : bottlenecks) {
      Arena rest = buffers.rest;
      const auto inner = bottleneck.take(rest, extent, executor.tasks());
      bottleneck.run(buffers.branches, extent, buffers.branches, inner, executor);
    }
    product.weights = &exit;
    product.input = buffers.branches;
    product.output = output;
    detail::multiply_all(product, extent, buffers.panels, executor);
  }
};

GhostC3::GhostC3(const GhostC3Weights& weights) {
  weights.validate("GhostC3");
  auto impl = std::make_shared<Impl>();
  impl->entry = detail::pack(joined(weights.cv1, weights.cv2));
  impl->exit = detail::pack(weights.cv3);
  impl->activation = weights.activation;
  for (const GhostBottleneckWeights& bottleneck : weights.bottlenecks) {
    // A bottleneck in a block runs in place, which a transformed shortcut would not allow.
    require(
        !bottleneck.shortcut || (!bottleneck.shortcut_depthwise && !bottleneck.shortcut_pointwise),
        "GhostC3", "weights.bottlenecks.shortcut", "a convolution", "the identity or none");
    impl->bottlenecks.emplace_back(bottleneck);
    impl->attention = impl->attention || bottleneck.attention.has_value();
  }
  impl_ = std::move(impl);
}

int GhostC3::in_channels() const { return impl_->entry.depth; }
int GhostC3::out_channels() const { return impl_->exit.rows; }

std::size_t GhostC3::workspace_size(int height, int width, int tasks) const {
  return impl_->total({height, width}, tasks);
}

void GhostC3::run(TensorBatch<const float> input, TensorBatch<float> output, Workspace& workspace,
                  Executor executor) const {
  constexpr const char* kFunction = "GhostC3::run";
  detail::require_channels(input, in_channels(), kFunction, "input");
  require_poolable(input, impl_->attention, kFunction);
  detail::require_shape(output, input.batch, out_channels(), input.height, input.width, kFunction,
                        "output");
  detail::require_apart(input, output, true, kFunction);
  const Extent extent = {input.height, input.width};
  Arena arena(workspace, workspace_size(input.height, input.width, executor.tasks()));
  const Impl::Buffers buffers = impl_->take(arena, extent, executor.tasks());
  for (int n = 0; n < input.batch; ++n) {
    impl_->run(input.image(n).data, extent, output.image(n).data, buffers, executor);
  }
}

}  // namespace dynslam::attention
