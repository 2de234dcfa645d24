#include "dynslam/attention/dfc.hpp"

#include <utility>

#include "attention/blocks.hpp"
#include "attention/checks.hpp"

namespace dynslam::attention {

using detail::Arena;
using detail::Extent;

struct DfcAttention::Impl {
  detail::PackedDfc weights;

  struct Buffers {
    float* map = nullptr;
    float* panels = nullptr;
    float* scratch = nullptr;
    std::size_t scratch_size = 0;
  };
  Buffers take(Arena& arena, Extent extent, int tasks) const {
    const auto pieces = static_cast<std::size_t>(std::max(1, tasks));
    const Extent half = {extent.height / 2, extent.width / 2};
    Buffers buffers;
    buffers.map = arena.take(static_cast<std::size_t>(weights.channels()) * half.pixels());
    buffers.panels = arena.take(pieces * detail::panel_size(weights.pointwise));
    buffers.scratch_size = (weights.scratch(extent) + 15) / 16 * 16;
    buffers.scratch = arena.take(pieces * buffers.scratch_size);
    return buffers;
  }

  void run(const float* input, const float* features, float* output, Extent extent,
           const Buffers& buffers, const Executor& executor) const {
    const Extent half = {extent.height / 2, extent.width / 2};
    detail::Product product;
    product.weights = &weights.pointwise;
    product.source = detail::Source::kPooled2;
    product.input = input;
    product.height = extent.height;
    product.width = extent.width;
    product.output = buffers.map;
    product.output_stride = half.pixels();
    detail::multiply_all(product, half, buffers.panels, executor);
    detail::split(executor, static_cast<std::size_t>(weights.channels()), 1,
                  [&](std::size_t begin, std::size_t end, std::size_t task) {
                    for (std::size_t c = begin; c < end; ++c) {
                      detail::DfcPlane plane = weights.plane(static_cast<int>(c));
                      plane.map = buffers.map + c * half.pixels();
                      plane.map_height = half.height;
                      plane.map_width = half.width;
                      plane.features = features + c * extent.pixels();
                      plane.output = output + c * extent.pixels();
                      plane.height = extent.height;
                      plane.width = extent.width;
                      plane.scratch = buffers.scratch + task * buffers.scratch_size;
                      detail::dfc_plane(plane);
                    }
                  });
  }
};

DfcAttention::DfcAttention(const DfcWeights& weights) {
  weights.validate("DfcAttention");
  impl_ = std::make_shared<const Impl>(Impl{detail::PackedDfc(weights)});
}

int DfcAttention::in_channels() const { return impl_->weights.pointwise.depth; }
int DfcAttention::out_channels() const { return impl_->weights.channels(); }

std::size_t DfcAttention::workspace_size(int height, int width, int tasks) const {
  Arena arena;
  impl_->take(arena, {height, width}, tasks);
  return arena.total();
}

void DfcAttention::run(TensorBatch<const float> input, TensorBatch<const float> features,
                       TensorBatch<float> output, Workspace& workspace, Executor executor) const {
  constexpr const char* kFunction = "DfcAttention::run";
  detail::require_channels(input, in_channels(), kFunction, "input");
  require(input.height >= 2 && input.width >= 2, kFunction, "input", detail::shape_text(input),
          "a height and width of at least 2");
  detail::require_shape(features, input.batch, out_channels(), input.height, input.width, kFunction,
                        "features");
  detail::require_shape(output, input.batch, out_channels(), input.height, input.width, kFunction,
                        "output");
  detail::require_apart(input, output, true, kFunction);
  detail::require_apart(features, output, true, kFunction);
  const Extent extent = {input.height, input.width};
  Arena arena(workspace, workspace_size(input.height, input.width, executor.tasks()));
  const Impl::Buffers buffers = impl_->take(arena, extent, executor.tasks());
  for (int n = 0; n < input.batch; ++n) {
    impl_->run(input.image(n).data, features.image(n).data, output.image(n).data, extent, buffers,
               executor);
  }
}

FullDfcAttention::FullDfcAttention(FullDfcWeights weights) {
  weights.validate("FullDfcAttention");
  // The horizontal matrices are kept transposed, so that both products run along rows.
  const auto width = static_cast<std::size_t>(weights.width);
  const std::size_t matrices = weights.horizontal.size() / (width * width);
  for (std::size_t m = 0; m < matrices; ++m) {
    float* matrix = weights.horizontal.data() + m * width * width;
    for (std::size_t i = 0; i < width; ++i) {
      for (std::size_t j = 0; j < i; ++j) std::swap(matrix[i * width + j], matrix[j * width + i]);
    }
  }
  weights_ = std::make_shared<const FullDfcWeights>(std::move(weights));
}

int FullDfcAttention::channels() const { return weights_->channels; }
int FullDfcAttention::height() const { return weights_->height; }
int FullDfcAttention::width() const { return weights_->width; }

std::size_t FullDfcAttention::workspace_size(int tasks) const {
  Arena arena;
  const Extent extent = {height(), width()};
  arena.take(static_cast<std::size_t>(std::max(1, tasks)) * extent.pixels());
  return arena.total();
}

void FullDfcAttention::run(TensorBatch<const float> input, TensorBatch<float> output,
                           Workspace& workspace, Executor executor) const {
  constexpr const char* kFunction = "FullDfcAttention::run";
  const FullDfcWeights& weights = *weights_;
  detail::require_shape(input, input.batch, weights.channels, weights.height, weights.width,
                        kFunction, "input");
  detail::require_shape(output, input.batch, weights.channels, weights.height, weights.width,
                        kFunction, "output");
  detail::require_apart(input, output, true, kFunction);
  const int h = weights.height;
  const int w = weights.width;
  const std::size_t plane = Extent{h, w}.pixels();
  const std::size_t channels = static_cast<std::size_t>(weights.channels);
  const std::size_t vertical = weights.vertical.size() / channels;
  const std::size_t horizontal = weights.horizontal.size() / channels;
  Arena arena(workspace, workspace_size(executor.tasks()));
  float* between = arena.take(static_cast<std::size_t>(executor.tasks()) * plane);
  const auto count = static_cast<std::size_t>(input.batch) * channels;
  detail::split(executor, count, 1, [&](std::size_t begin, std::size_t end, std::size_t task) {
    float* rows = between + task * plane;
    for (std::size_t i = begin; i < end; ++i) {
      const float* fh = weights.vertical.data() + i % channels * vertical;
      const float* fw = weights.horizontal.data() + i % channels * horizontal;
      const float* z = input.data + i * plane;
      float* a = output.data + i * plane;
      if (weights.shared) {
        detail::multiply_small(fh, z, rows, h, h, w);
        detail::multiply_small(rows, fw, a, h, w, w);
        continue;
      }
      detail::multiply_columns(fh, z, rows, h, h, w);
      for (int y = 0; y < h; ++y) {
        const std::size_t at = static_cast<std::size_t>(y) * static_cast<std::size_t>(w);
        detail::multiply_small(rows + at, fw + at * static_cast<std::size_t>(w), a + at, 1, w, w);
      }
    }
  });
}

}  // namespace dynslam::attention
