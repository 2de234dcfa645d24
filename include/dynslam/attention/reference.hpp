// The layers as plain loops, to be read beside their equations. The compiled layers are tested
// against these; sums are taken in double. Allocates freely and is in no hurry.
//
// Nothing here checks its arguments except what the loops need: the compiled layers do.
#pragma once

#include <cstddef>
#include <limits>
#include <vector>

#include "dynslam/attention/cbam.hpp"
#include "dynslam/attention/reference_operations.hpp"
#include "dynslam/attention/weights.hpp"

namespace dynslam::attention::reference {

/// features * upsample(sigmoid(Kx1(1xK(1x1(pool2(input)))))).
inline Map dfc(const Map& input, const Map& features, const DfcWeights& weights) {
  Map map = convolve(average_pool2(input), weights.pointwise);
  map = convolve(convolve(map, weights.horizontal), weights.vertical);
  for (float& a : map.values) a = sigmoid(a);
  Map y = upsample_nearest(map, features.height, features.width);
  for (std::size_t i = 0; i < y.values.size(); ++i) y.values[i] *= features.values[i];
  return y;
}

/// a' = FH z along columns, a = FW a' along rows.
inline Map full_dfc(const Map& z, const FullDfcWeights& weights) {
  const int height = z.height;
  const int width = z.width;
  const auto at = [](const std::vector<float>& values, int a, int na, int b, int nb, int c, int nc,
                     int d) {
    const std::size_t row =
        (static_cast<std::size_t>(a) * static_cast<std::size_t>(na) + static_cast<std::size_t>(b)) *
            static_cast<std::size_t>(nb) +
        static_cast<std::size_t>(c);
    return static_cast<double>(
        values[row * static_cast<std::size_t>(nc) + static_cast<std::size_t>(d)]);
  };
  Map vertical(z.channels, height, width);
  Map y = vertical;
  for (int c = 0; c < z.channels; ++c) {
    for (int h = 0; h < height; ++h) {
      for (int w = 0; w < width; ++w) {
        double sum = 0.0;
        for (int k = 0; k < height; ++k) {
          sum += (weights.shared ? at(weights.vertical, 0, 1, c, height, h, height, k)
                                 : at(weights.vertical, c, height, h, height, k, width, w)) *
                 z(c, k, w);
        }
        vertical(c, h, w) = static_cast<float>(sum);
      }
    }
    for (int h = 0; h < height; ++h) {
      for (int w = 0; w < width; ++w) {
        double sum = 0.0;
        for (int k = 0; k < width; ++k) {
          sum += (weights.shared ? at(weights.horizontal, 0, 1, c, width, w, width, k)
                                 : at(weights.horizontal, c, height, h, width, w, width, k)) *
                 vertical(c, h, k);
        }
        y(c, h, w) = static_cast<float>(sum);
      }
    }
  }
  return y;
}

/// [primary; cheap(primary)], the first out_channels of them.
inline Map ghost_module(const Map& x, const GhostModuleWeights& weights) {
  const Map primary = convolve(x, weights.primary, 1, weights.activation);
  const Map cheap = convolve(primary, weights.cheap, 1, weights.activation);
  Map y(weights.out_channels, x.height, x.width);
  for (std::size_t i = 0; i < y.values.size(); ++i) {
    const std::size_t split = primary.values.size();
    y.values[i] = i < split ? primary.values[i] : cheap.values[i - split];
  }
  return y;
}

inline Map ghost_bottleneck(const Map& x, const GhostBottleneckWeights& weights) {
  Map y = ghost_module(x, weights.expand);
  if (weights.attention) y = dfc(x, y, *weights.attention);
  if (weights.downsample) y = convolve(y, *weights.downsample, weights.stride);
  y = ghost_module(y, weights.project);
  if (!weights.shortcut) return y;
  Map shortcut = x;
  if (weights.shortcut_depthwise) {
    shortcut = convolve(shortcut, *weights.shortcut_depthwise, weights.stride);
  }
  if (weights.shortcut_pointwise) shortcut = convolve(shortcut, *weights.shortcut_pointwise);
  for (std::size_t i = 0; i < y.values.size(); ++i) y.values[i] += shortcut.values[i];
  return y;
}

inline Map ghost_c3(const Map& x, const GhostC3Weights& weights) {
  Map a = convolve(x, weights.cv1, 1, weights.activation);
  for (const GhostBottleneckWeights& bottleneck : weights.bottlenecks) {
    a = ghost_bottleneck(a, bottleneck);
  }
  const Map b = convolve(x, weights.cv2, 1, weights.activation);
  Map both(a.channels + b.channels, a.height, a.width);
  for (std::size_t i = 0; i < both.values.size(); ++i) {
    both.values[i] = i < a.values.size() ? a.values[i] : b.values[i - a.values.size()];
  }
  return convolve(both, weights.cv3, 1, weights.activation);
}

/// x * sigmoid(mlp(mean_hw x) + mlp(max_hw x)).
inline Map channel_attention(const Map& x, const CbamWeights& weights) {
  const auto plane = static_cast<std::size_t>(x.height) * static_cast<std::size_t>(x.width);
  const auto channels = static_cast<std::size_t>(x.channels);
  const auto reduced = static_cast<std::size_t>(weights.reduced);
  std::vector<double> logits(channels, 0.0);
  for (const bool use_max : {false, true}) {
    std::vector<double> pooled(channels, 0.0);
    for (std::size_t c = 0; c < channels; ++c) {
      const float* at = &x.values[c * plane];
      double sum = 0.0;
      double largest = -std::numeric_limits<double>::infinity();
      for (std::size_t i = 0; i < plane; ++i) {
        sum += at[i];
        largest = at[i] > largest ? at[i] : largest;
      }
      pooled[c] = use_max ? largest : sum / static_cast<double>(plane);
    }
    for (std::size_t r = 0; r < reduced; ++r) {
      double hidden = weights.hidden_bias.empty() ? 0.0 : weights.hidden_bias[r];
      for (std::size_t c = 0; c < channels; ++c) {
        hidden += weights.hidden_weight[r * channels + c] * pooled[c];
      }
      hidden = hidden < 0.0 ? 0.0 : hidden;
      for (std::size_t c = 0; c < channels; ++c) {
        logits[c] += weights.output_weight[c * reduced + r] * hidden;
      }
    }
    for (std::size_t c = 0; c < channels && !weights.output_bias.empty(); ++c) {
      logits[c] += weights.output_bias[c];
    }
  }
  Map y = x;
  for (std::size_t i = 0; i < y.values.size(); ++i) {
    y.values[i] *= sigmoid(static_cast<float>(logits[i / plane]));
  }
  return y;
}

/// x * sigmoid(conv([max_c x; mean_c x])).
inline Map spatial_attention(const Map& x, const CbamWeights& weights) {
  Map pooled(2, x.height, x.width);
  for (int h = 0; h < x.height; ++h) {
    for (int w = 0; w < x.width; ++w) {
      float largest = -std::numeric_limits<float>::infinity();
      double sum = 0.0;
      for (int c = 0; c < x.channels; ++c) {
        largest = x(c, h, w) > largest ? x(c, h, w) : largest;
        sum += x(c, h, w);
      }
      pooled(0, h, w) = largest;
      pooled(1, h, w) = static_cast<float>(sum / x.channels);
    }
  }
  const Map logits = convolve(pooled, weights.spatial);
  Map y = x;
  for (std::size_t i = 0; i < y.values.size(); ++i) {
    y.values[i] *= sigmoid(logits.values[i % logits.values.size()]);
  }
  return y;
}

inline Map cbam(const Map& x, const CbamWeights& weights, CbamOrder order) {
  switch (order) {
    case CbamOrder::kChannelFirst:
      return spatial_attention(channel_attention(x, weights), weights);
    case CbamOrder::kSpatialFirst:
      return channel_attention(spatial_attention(x, weights), weights);
    case CbamOrder::kChannelOnly:
      return channel_attention(x, weights);
    case CbamOrder::kSpatialOnly:
      return spatial_attention(x, weights);
    case CbamOrder::kNone:
      break;
  }
  return x;
}

/// P_0 ... P_{L-1} and P6 for the maps of the backbone, finest first.
inline std::vector<Map> mixed_fpn(const std::vector<Map>& inputs,
                                  const std::vector<FpnLevelWeights>& levels,
                                  CbamOrder order = CbamOrder::kSpatialFirst) {
  std::vector<Map> outputs(inputs.size());
  Map coarser;
  for (std::size_t n = inputs.size(); n-- > 0;) {
    Map merged = cbam(convolve(inputs[n], levels[n].lateral), levels[n].attention, order);
    if (n + 1 < inputs.size()) {
      const Map up = upsample_nearest(coarser, merged.height, merged.width);
      for (std::size_t i = 0; i < up.values.size(); ++i) merged.values[i] += up.values[i];
    }
    outputs[n] = convolve(merged, levels[n].smooth);
    coarser = merged;
  }
  const Map& last = outputs.back();
  Map p6(last.channels, (last.height + 1) / 2, (last.width + 1) / 2);
  for (int c = 0; c < p6.channels; ++c) {
    for (int h = 0; h < p6.height; ++h) {
      for (int w = 0; w < p6.width; ++w) p6(c, h, w) = last(c, 2 * h, 2 * w);
    }
  }
  outputs.push_back(p6);
  return outputs;
}

}  // namespace dynslam::attention::reference
