#include "dynslam/attention/mixed_fpn.hpp"

#include <algorithm>
#include <string>
#include <vector>

#include "attention/blocks.hpp"
#include "attention/checks.hpp"

namespace dynslam::attention {

using detail::Arena;
using detail::Extent;

namespace {

Extent extent_of(const TensorBatch<const float>& view) { return {view.height, view.width}; }

std::string indexed(const char* name, std::size_t index) {
  return std::string(name) + "[" + std::to_string(index) + "]";
}

}  // namespace

struct MixedAttentionFpn::Impl {
  struct Level {
    detail::PackedWeights lateral;
    Cbam attention;
    detail::PackedWeights smooth;
  };
  std::vector<Level> levels;
  int channels = 0;

  struct Scratch {
    float* merged[16] = {};
    float* panels = nullptr;
    float* inner = nullptr;
    std::size_t inner_size = 0;
  };

  std::size_t total(Span<const TensorBatch<const float>> inputs, int tasks) const {
    Arena arena;
    Scratch scratch;
    take(arena, inputs, tasks, scratch);
    return arena.total();
  }

  void take(Arena& arena, Span<const TensorBatch<const float>> inputs, int tasks,
            Scratch& scratch) const {
    std::size_t panel = 0;
    for (std::size_t n = 0; n < levels.size(); ++n) {
      const Extent extent = extent_of(inputs[n]);
      scratch.merged[n] = arena.take(static_cast<std::size_t>(channels) * extent.pixels());
      panel = std::max(
          {panel, detail::panel_size(levels[n].lateral), detail::panel_size(levels[n].smooth)});
      scratch.inner_size = std::max(scratch.inner_size, levels[n].attention.workspace_size(
                                                            extent.height, extent.width, tasks));
    }
    scratch.panels = arena.take(static_cast<std::size_t>(std::max(1, tasks)) * panel);
    scratch.inner = arena.take(scratch.inner_size);
  }

  /// W_n, with the coarser level added, into scratch.merged[n].
  void merge(std::size_t n, const TensorBatch<const float>& input, const Extent* coarser, int image,
             const Scratch& scratch, const Executor& executor) const {
    const Level& level = levels[n];
    const Extent extent = extent_of(input);
    detail::Product product;
    product.weights = &level.lateral;
    product.input = input.image(image).data;
    product.height = extent.height;
    product.width = extent.width;
    product.output = scratch.merged[n];
    product.output_stride = extent.pixels();
    detail::multiply_all(product, extent, scratch.panels, executor);
    const TensorBatch<float> map(scratch.merged[n], 1, channels, extent.height, extent.width);
    Workspace inner(Span<float>(scratch.inner, scratch.inner_size));
    level.attention.run(map, map, inner, executor);
    if (coarser == nullptr) return;
    detail::split(executor, static_cast<std::size_t>(channels), 1,
                  [&](std::size_t begin, std::size_t end, std::size_t) {
                    for (std::size_t c = begin; c < end; ++c) {
                      detail::add_upsampled(scratch.merged[n + 1] + c * coarser->pixels(),
                                            coarser->height, coarser->width,
                                            scratch.merged[n] + c * extent.pixels(), extent.height,
                                            extent.width);
                    }
                  });
  }

  void smooth(std::size_t n, Extent extent, float* output, const Scratch& scratch,
              const Executor& executor) const {
    detail::Product product;
    product.weights = &levels[n].smooth;
    product.source = detail::Source::kWindow3;
    product.input = scratch.merged[n];
    product.height = extent.height;
    product.width = extent.width;
    product.output = output;
    product.output_stride = extent.pixels();
    detail::multiply_all(product, extent, scratch.panels, executor);
  }
};

MixedAttentionFpn::MixedAttentionFpn(Span<const FpnLevelWeights> levels, CbamOrder order) {
  constexpr const char* kFunction = "MixedAttentionFpn";
  require(!levels.empty() && levels.size() <= 16, kFunction, "levels.size()", levels.size(),
          "1..16");
  auto impl = std::make_shared<Impl>();
  impl->channels = levels[0].lateral.out_channels;
  for (const FpnLevelWeights& level : levels) {
    level.validate(kFunction);
    require(level.lateral.out_channels == impl->channels, kFunction, "level.lateral.out_channels",
            level.lateral.out_channels, impl->channels);
    impl->levels.push_back(
        {detail::pack(level.lateral), Cbam(level.attention, order), detail::pack(level.smooth)});
  }
  impl_ = std::move(impl);
}

int MixedAttentionFpn::levels() const { return static_cast<int>(impl_->levels.size()); }
int MixedAttentionFpn::channels() const { return impl_->channels; }
int MixedAttentionFpn::in_channels(int level) const {
  require(level >= 0 && level < levels(), "MixedAttentionFpn::in_channels", "level", level,
          "0.." + std::to_string(levels() - 1));
  return impl_->levels[static_cast<std::size_t>(level)].lateral.depth;
}

std::size_t MixedAttentionFpn::workspace_size(Span<const TensorBatch<const float>> inputs,
                                              int tasks) const {
  require(inputs.size() == impl_->levels.size(), "MixedAttentionFpn::workspace_size",
          "inputs.size()", inputs.size(), impl_->levels.size());
  return impl_->total(inputs, tasks);
}

void MixedAttentionFpn::run(Span<const TensorBatch<const float>> inputs,
                            Span<const TensorBatch<float>> outputs, Workspace& workspace,
                            Executor executor) const {
  constexpr const char* kFunction = "MixedAttentionFpn::run";
  const std::size_t count = impl_->levels.size();
  require(inputs.size() == count, kFunction, "inputs.size()", inputs.size(), count);
  require(outputs.size() == count + 1, kFunction, "outputs.size()", outputs.size(), count + 1);
  for (std::size_t n = 0; n < count; ++n) {
    const TensorBatch<const float>& input = inputs[n];
    detail::require_channels(input, in_channels(static_cast<int>(n)), kFunction,
                             indexed("inputs", n));
    require(input.batch == inputs[0].batch, kFunction, indexed("inputs", n) + ".batch", input.batch,
            inputs[0].batch);
    require(n == 0 || (input.height <= inputs[n - 1].height && input.width <= inputs[n - 1].width),
            kFunction, indexed("inputs", n), detail::shape_text(input),
            "no larger than the level before");
    detail::require_shape(outputs[n], input.batch, channels(), input.height, input.width, kFunction,
                          indexed("outputs", n));
  }
  const TensorBatch<const float>& last = inputs[count - 1];
  detail::require_shape(outputs[count], last.batch, channels(), (last.height + 1) / 2,
                        (last.width + 1) / 2, kFunction, indexed("outputs", count));
  for (std::size_t a = 0; a <= count; ++a) {
    for (std::size_t b = 0; b < count; ++b) {
      detail::require_apart(inputs[b], outputs[a], false, kFunction);
    }
    for (std::size_t b = 0; b < a; ++b) {
      detail::require_apart(outputs[b], outputs[a], false, kFunction);
    }
  }

  Arena arena(workspace, impl_->total(inputs, executor.tasks()));
  Impl::Scratch scratch;
  impl_->take(arena, inputs, executor.tasks(), scratch);
  for (int image = 0; image < last.batch; ++image) {
    for (std::size_t n = count; n-- > 0;) {
      const Extent coarser = n + 1 < count ? extent_of(inputs[n + 1]) : Extent{};
      impl_->merge(n, inputs[n], n + 1 < count ? &coarser : nullptr, image, scratch, executor);
      impl_->smooth(n, extent_of(inputs[n]), outputs[n].image(image).data, scratch, executor);
    }
    const TensorView<float> p5 = outputs[count - 1].image(image);
    const TensorView<float> p6 = outputs[count].image(image);
    for (int c = 0; c < p6.channels; ++c) {
      for (int y = 0; y < p6.height; ++y) {
        for (int x = 0; x < p6.width; ++x) p6(c, y, x) = p5(c, 2 * y, 2 * x);
      }
    }
  }
}

}  // namespace dynslam::attention
