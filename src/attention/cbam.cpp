#include "dynslam/attention/cbam.hpp"

#include <algorithm>
#include <cstring>
#include <limits>

#include "attention/blocks.hpp"
#include "attention/cbam_kernels.hpp"
#include "attention/checks.hpp"

namespace dynslam::attention {

using detail::Arena;
using detail::Extent;
using detail::Pixels;

namespace {

// A band of rows stays in the second-level cache between its two readings: 1.5 MiB of 2 on recent
// server cores; with less the second reading comes from further away.
constexpr std::size_t kBandBytes = std::size_t{3} << 19;
// Maps larger than the caches that follow are written past them.
constexpr std::size_t kStreamBytes = std::size_t{8} << 20;

struct Layer {
  CbamWeights weights;
  CbamOrder order;

  struct Buffers {
    float* mean = nullptr;     // a value a channel
    float* largest = nullptr;  // a value a channel
    float* gates = nullptr;    // a value a channel
    float* hidden = nullptr;
    float* padded = nullptr;   // two maps [max; mean] with zeros around
    float* spatial = nullptr;  // gates of all pixels
    float* bands = nullptr;    // a task's two rows of pooled pixels
  };

  int pad() const { return (weights.spatial.kernel_width - 1) / 2; }
  std::size_t pitch(Extent extent) const {
    return detail::padded_pitch(weights.spatial.kernel_width, extent.width);
  }
  std::size_t padded_size(Extent extent) const {
    return static_cast<std::size_t>(extent.height + 2 * pad()) * pitch(extent) + detail::kRowSlack;
  }
  /// Rows that are pooled at once.
  int band(Extent extent) const {
    const std::size_t row_bytes = static_cast<std::size_t>(weights.channels) *
                                  static_cast<std::size_t>(extent.width) * sizeof(float);
    const auto rows = static_cast<int>(std::min<std::size_t>(kBandBytes / row_bytes, 4096));
    return std::clamp(rows - pad(), 1, extent.height);
  }
  std::size_t band_size(Extent extent) const {
    return static_cast<std::size_t>(band(extent)) * static_cast<std::size_t>(extent.width) +
           detail::kRowSlack;
  }

  Buffers take(Arena& arena, Extent extent, int tasks) const {
    const auto channels = static_cast<std::size_t>(weights.channels);
    Buffers buffers;
    buffers.mean = arena.take(channels);
    buffers.largest = arena.take(channels);
    buffers.gates = arena.take(channels);
    buffers.hidden = arena.take(static_cast<std::size_t>(weights.reduced));
    if (order == CbamOrder::kChannelOnly || order == CbamOrder::kNone) return buffers;
    buffers.padded = arena.take(2 * padded_size(extent));
    buffers.spatial = arena.take(extent.pixels());
    buffers.bands =
        arena.take(static_cast<std::size_t>(std::max(1, tasks)) * 2 * band_size(extent));
    return buffers;
  }

  detail::Perceptron perceptron() const {
    detail::Perceptron p;
    p.channels = weights.channels;
    p.reduced = weights.reduced;
    p.hidden_weight = weights.hidden_weight.data();
    p.hidden_bias = weights.hidden_bias.empty() ? nullptr : weights.hidden_bias.data();
    p.output_weight = weights.output_weight.data();
    p.output_bias = weights.output_bias.empty() ? nullptr : weights.output_bias.data();
    return p;
  }
};

/// One image on its way through the layer.
class Pass {
 public:
  Pass(const Layer& layer, const Layer::Buffers& buffers, const float* input, Extent extent,
       float* output, const Executor& executor)
      : layer_(layer),
        buffers_(buffers),
        input_(input),
        extent_(extent),
        output_(output),
        executor_(executor),
        band_(layer.band(extent)),
        stream_(output != input && static_cast<std::size_t>(layer.weights.channels) *
                                           extent.pixels() * sizeof(float) >=
                                       kStreamBytes) {}

  void run() {
    switch (layer_.order) {
      case CbamOrder::kChannelFirst:
        pool_planes();
        make_channel_gates();
        spatial_bands(buffers_.gates, true);
        break;
      case CbamOrder::kSpatialFirst:
        spatial_first();
        break;
      case CbamOrder::kChannelOnly:
        pool_planes();
        make_channel_gates();
        apply_planes(buffers_.gates, nullptr);
        break;
      case CbamOrder::kSpatialOnly:
        spatial_bands(nullptr, true);
        break;
      case CbamOrder::kNone:
        if (output_ != input_) std::memcpy(output_, input_, size() * sizeof(float));
        break;
    }
  }

 private:
  std::size_t channels() const { return static_cast<std::size_t>(layer_.weights.channels); }
  std::size_t size() const { return channels() * extent_.pixels(); }
  std::size_t width() const { return static_cast<std::size_t>(extent_.width); }
  int bands() const { return (extent_.height + band_ - 1) / band_; }

  Pixels pixels(int first_row, int last_row) const {
    Pixels p;
    p.input = input_ + static_cast<std::size_t>(first_row) * width();
    p.plane = extent_.pixels();
    p.channels = layer_.weights.channels;
    p.count = static_cast<std::size_t>(last_row - first_row) * width();
    return p;
  }

  void pool_planes() {
    const float scale = 1.0F / static_cast<float>(extent_.pixels());
    detail::split(executor_, channels(), 1, [&](std::size_t begin, std::size_t end, std::size_t) {
      for (std::size_t c = begin; c < end; ++c) {
        detail::pool_values(input_ + c * extent_.pixels(), extent_.pixels(), buffers_.mean + c,
                            buffers_.largest + c);
        buffers_.mean[c] *= scale;
      }
    });
  }

  void make_channel_gates() {
    detail::channel_gates(layer_.perceptron(), buffers_.mean, buffers_.largest, buffers_.hidden,
                          buffers_.gates);
  }

  /// Pools channels over the rows [first, last) into the padded maps, `last - first` <= band.
  void pool_rows(const float* gates, int first, int last, std::size_t task) {
    float* largest = buffers_.bands + task * 2 * layer_.band_size(extent_);
    float* mean = largest + layer_.band_size(extent_);
    detail::pool_channels(pixels(first, last), gates, largest, mean);
    const std::size_t pitch = layer_.pitch(extent_);
    const auto pad = static_cast<std::size_t>(layer_.pad());
    for (int y = first; y < last; ++y) {
      const std::size_t from = static_cast<std::size_t>(y - first) * width();
      const std::size_t to = (static_cast<std::size_t>(y) + pad) * pitch + pad;
      std::memcpy(buffers_.padded + to, largest + from, width() * sizeof(float));
      std::memcpy(buffers_.padded + layer_.padded_size(extent_) + to, mean + from,
                  width() * sizeof(float));
    }
  }

  void gate_rows(int first, int last) {
    detail::SpatialRow row;
    row.pitch = layer_.pitch(extent_);
    row.weight = layer_.weights.spatial.weight.data();
    row.bias = layer_.weights.spatial.bias.empty() ? 0.0F : layer_.weights.spatial.bias[0];
    row.kernel = layer_.weights.spatial.kernel_width;
    row.width = extent_.width;
    for (int y = first; y < last; ++y) {
      row.largest = buffers_.padded + static_cast<std::size_t>(y) * row.pitch;
      row.mean = row.largest + layer_.padded_size(extent_);
      detail::spatial_gates(row, buffers_.spatial + static_cast<std::size_t>(y) * width());
    }
  }

  void apply_rows(const float* gates, int first, int last) {
    const std::size_t at = static_cast<std::size_t>(first) * width();
    detail::apply_gates(pixels(first, last), gates, buffers_.spatial + at, stream_, output_ + at);
  }

  void pool_gated_rows(int first, int last, std::size_t first_channel, std::size_t last_channel) {
    detail::pool_gated(pixels(first, last),
                       buffers_.spatial + static_cast<std::size_t>(first) * width(),
                       static_cast<int>(first_channel), static_cast<int>(last_channel),
                       buffers_.mean, buffers_.largest);
  }

  void apply_planes(const float* gates, const float* spatial) {
    detail::split(executor_, channels(), 1, [&](std::size_t begin, std::size_t end, std::size_t) {
      Pixels p = pixels(0, extent_.height);
      p.input += begin * p.plane;
      p.channels = static_cast<int>(end - begin);
      detail::apply_gates(p, gates + begin, spatial, stream_, output_ + begin * p.plane);
    });
  }

  /// The spatial attention of input * gates, band by band: a band is read a second time while it is
  /// still in the cache. With `apply` the output is written, without it the gated values pooled.
  void spatial_bands(const float* gates, bool apply) {
    std::fill(buffers_.padded, buffers_.padded + 2 * layer_.padded_size(extent_), 0.0F);
    if (executor_.tasks() > 1) {
      spatial_bands_in_parallel(gates, apply);
      return;
    }
    int pooled = 0;
    for (int first = 0; first < extent_.height; first += band_) {
      const int last = std::min(extent_.height, first + band_);
      const int wanted = std::min(extent_.height, last + layer_.pad());
      for (int next = 0; pooled < wanted; pooled = next) {
        next = std::min(pooled + band_, wanted);
        pool_rows(gates, pooled, next, 0);
      }
      gate_rows(first, last);
      if (apply) {
        apply_rows(gates, first, last);
      } else {
        pool_gated_rows(first, last, 0, channels());
      }
    }
  }

  void spatial_bands_in_parallel(const float* gates, bool apply) {
    const auto count = static_cast<std::size_t>(bands());
    const auto last_of = [&](std::size_t b) {
      return std::min(extent_.height, (static_cast<int>(b) + 1) * band_);
    };
    detail::split(executor_, count, 1, [&](std::size_t begin, std::size_t end, std::size_t task) {
      for (std::size_t b = begin; b < end; ++b) {
        pool_rows(gates, static_cast<int>(b) * band_, last_of(b), task);
      }
    });
    detail::split(executor_, count, 1, [&](std::size_t begin, std::size_t end, std::size_t) {
      for (std::size_t b = begin; b < end; ++b) {
        gate_rows(static_cast<int>(b) * band_, last_of(b));
        if (apply) apply_rows(gates, static_cast<int>(b) * band_, last_of(b));
      }
    });
    if (apply) return;
    // In the order of the bands for every channel, as in one thread.
    detail::split(executor_, channels(), 1, [&](std::size_t begin, std::size_t end, std::size_t) {
      for (std::size_t b = 0; b < count; ++b) {
        pool_gated_rows(static_cast<int>(b) * band_, last_of(b), begin, end);
      }
    });
  }

  void spatial_first() {
    std::fill(buffers_.mean, buffers_.mean + channels(), 0.0F);
    std::fill(buffers_.largest, buffers_.largest + channels(),
              -std::numeric_limits<float>::infinity());
    spatial_bands(nullptr, false);
    const float scale = 1.0F / static_cast<float>(extent_.pixels());
    for (std::size_t c = 0; c < channels(); ++c) buffers_.mean[c] *= scale;
    make_channel_gates();
    apply_planes(buffers_.gates, buffers_.spatial);
  }

  const Layer& layer_;
  const Layer::Buffers& buffers_;
  const float* input_;
  Extent extent_;
  float* output_;
  const Executor& executor_;
  int band_;
  bool stream_;
};

}  // namespace

struct Cbam::Impl {
  Layer layer;
};

Cbam::Cbam(const CbamWeights& weights, CbamOrder order) {
  weights.validate("Cbam");
  impl_ = std::make_shared<const Impl>(Impl{Layer{weights, order}});
}

int Cbam::channels() const { return impl_->layer.weights.channels; }
CbamOrder Cbam::order() const { return impl_->layer.order; }

std::size_t Cbam::workspace_size(int height, int width, int tasks) const {
  Arena arena;
  impl_->layer.take(arena, {height, width}, tasks);
  return arena.total();
}

void Cbam::run(TensorBatch<const float> input, TensorBatch<float> output, Workspace& workspace,
               Executor executor) const {
  constexpr const char* kFunction = "Cbam::run";
  detail::require_channels(input, channels(), kFunction, "input");
  detail::require_shape(output, input.batch, channels(), input.height, input.width, kFunction,
                        "output");
  detail::require_apart(input, output, true, kFunction);
  const Extent extent = {input.height, input.width};
  Arena arena(workspace, workspace_size(input.height, input.width, executor.tasks()));
  const Layer::Buffers buffers = impl_->layer.take(arena, extent, executor.tasks());
  for (int n = 0; n < input.batch; ++n) {
    Pass(impl_->layer, buffers, input.image(n).data, extent, output.image(n).data, executor).run();
  }
}

}  // namespace dynslam::attention
