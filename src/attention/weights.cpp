#include "dynslam/attention/weights.hpp"

#include <cmath>
#include <string>

#include "dynslam/core/errors.hpp"

namespace dynslam::attention {
namespace {

std::string part(std::string_view name, std::string_view member) {
  return std::string(name) + "." + std::string(member);
}

// Sizes of a product are kept where int and size_t cannot overflow.
constexpr int kMaxSize = 1 << 20;

void require_size(int value, std::string_view function, const std::string& name) {
  require(value >= 1 && value <= kMaxSize, function, name, value, "1..1048576");
}

void require_length(std::size_t got, std::size_t expected, std::string_view function,
                    const std::string& name) {
  require(got == expected, function, name + ".size()", got, expected);
}

void require_length_or_empty(std::size_t got, std::size_t expected, std::string_view function,
                             const std::string& name) {
  if (got != 0) require_length(got, expected, function, name);
}

void require_kernel(const Convolution& c, int height, int width, std::string_view function,
                    std::string_view name) {
  require(c.kernel_height == height && c.kernel_width == width, function, part(name, "kernel"),
          std::to_string(c.kernel_height) + "x" + std::to_string(c.kernel_width),
          std::to_string(height) + "x" + std::to_string(width));
}

void require_pointwise(const Convolution& c, std::string_view function, std::string_view name) {
  c.validate(function, name);
  require_kernel(c, 1, 1, function, name);
}

/// Depthwise, square and odd, on so many channels.
void require_depthwise(const Convolution& c, int channels, std::string_view function,
                       std::string_view name) {
  c.validate(function, name);
  require(c.group_channels == 1, function, part(name, "group_channels"), c.group_channels, 1);
  require(c.out_channels == channels, function, part(name, "out_channels"), c.out_channels,
          channels);
  require_kernel(c, c.kernel_width, c.kernel_width, function, name);
  require(c.kernel_width % 2 == 1, function, part(name, "kernel_width"), c.kernel_width,
          "an odd number");
}

}  // namespace

void Convolution::validate(std::string_view function, std::string_view name) const {
  require_size(out_channels, function, part(name, "out_channels"));
  require_size(group_channels, function, part(name, "group_channels"));
  require(kernel_height >= 1 && kernel_height <= 1023, function, part(name, "kernel_height"),
          kernel_height, "1..1023");
  require(kernel_width >= 1 && kernel_width <= 1023, function, part(name, "kernel_width"),
          kernel_width, "1..1023");
  const std::size_t taps =
      static_cast<std::size_t>(kernel_height) * static_cast<std::size_t>(kernel_width);
  require_length(
      weight.size(),
      static_cast<std::size_t>(out_channels) * static_cast<std::size_t>(group_channels) * taps,
      function, part(name, "weight"));
  require_length_or_empty(bias.size(), static_cast<std::size_t>(out_channels), function,
                          part(name, "bias"));
}

Convolution fold_batch_norm(Convolution convolution, const BatchNorm& norm) {
  constexpr const char* kFunction = "fold_batch_norm";
  convolution.validate(kFunction, "convolution");
  const auto channels = static_cast<std::size_t>(convolution.out_channels);
  require_length(norm.gamma.size(), channels, kFunction, "norm.gamma");
  require_length(norm.beta.size(), channels, kFunction, "norm.beta");
  require_length(norm.mean.size(), channels, kFunction, "norm.mean");
  require_length(norm.variance.size(), channels, kFunction, "norm.variance");
  require(norm.epsilon > 0.0F, kFunction, "norm.epsilon", norm.epsilon, "a positive number");
  const std::size_t taps = convolution.weight.size() / channels;
  convolution.bias.resize(channels, 0.0F);
  for (std::size_t c = 0; c < channels; ++c) {
    const double variance = static_cast<double>(norm.variance[c]) + norm.epsilon;
    if (variance <= 0.0) {
      throw_invalid_argument(kFunction, "norm.variance", norm.variance[c],
                             "variance + epsilon above 0");
    }
    const double scale = norm.gamma[c] / std::sqrt(variance);
    for (std::size_t i = c * taps; i < (c + 1) * taps; ++i) {
      convolution.weight[i] = static_cast<float>(convolution.weight[i] * scale);
    }
    convolution.bias[c] = static_cast<float>(
        (static_cast<double>(convolution.bias[c]) - norm.mean[c]) * scale + norm.beta[c]);
  }
  return convolution;
}

void DfcWeights::validate(std::string_view function) const {
  require_pointwise(pointwise, function, "weights.pointwise");
  for (const auto& [convolution, name] :
       {std::pair(&horizontal, "weights.horizontal"), std::pair(&vertical, "weights.vertical")}) {
    convolution->validate(function, name);
    require(convolution->group_channels == 1, function, part(name, "group_channels"),
            convolution->group_channels, 1);
    require(convolution->out_channels == pointwise.out_channels, function,
            part(name, "out_channels"), convolution->out_channels, pointwise.out_channels);
    const int kernel = convolution->kernel_height * convolution->kernel_width;
    require(kernel % 2 == 1, function, part(name, "kernel"), kernel, "an odd length");
  }
  require_kernel(horizontal, 1, horizontal.kernel_width, function, "weights.horizontal");
  require_kernel(vertical, vertical.kernel_height, 1, function, "weights.vertical");
}

void FullDfcWeights::validate(std::string_view function) const {
  require_size(channels, function, "weights.channels");
  require_size(height, function, "weights.height");
  require_size(width, function, "weights.width");
  const auto c = static_cast<std::size_t>(channels);
  const auto h = static_cast<std::size_t>(height);
  const auto w = static_cast<std::size_t>(width);
  require_length(vertical.size(), c * h * h * (shared ? 1 : w), function, "weights.vertical");
  require_length(horizontal.size(), c * w * w * (shared ? 1 : h), function, "weights.horizontal");
}

void GhostModuleWeights::validate(std::string_view function) const {
  require_pointwise(primary, function, "weights.primary");
  require_depthwise(cheap, primary.out_channels, function, "weights.cheap");
  require(out_channels >= primary.out_channels && out_channels <= 2 * primary.out_channels,
          function, "weights.out_channels", out_channels,
          std::to_string(primary.out_channels) + ".." + std::to_string(2 * primary.out_channels));
}

void GhostBottleneckWeights::validate(std::string_view function) const {
  expand.validate(function);
  project.validate(function);
  require(stride == 1 || stride == 2, function, "weights.stride", stride, "1 or 2");
  require(project.primary.group_channels == expand.out_channels, function,
          "weights.project.primary.group_channels", project.primary.group_channels,
          expand.out_channels);
  if (attention) {
    attention->validate(function);
    require(attention->pointwise.group_channels == in_channels(), function,
            "weights.attention.pointwise.group_channels", attention->pointwise.group_channels,
            in_channels());
    require(attention->pointwise.out_channels == expand.out_channels, function,
            "weights.attention.pointwise.out_channels", attention->pointwise.out_channels,
            expand.out_channels);
  }
  require(downsample.has_value() || stride == 1, function, "weights.downsample", "none",
          "a convolution where stride is 2");
  if (downsample) {
    require_depthwise(*downsample, expand.out_channels, function, "weights.downsample");
  }
  if (!shortcut) return;
  const bool depthwise = shortcut_depthwise.has_value();
  if (depthwise) {
    require_depthwise(*shortcut_depthwise, in_channels(), function, "weights.shortcut_depthwise");
  }
  require(depthwise || stride == 1, function, "weights.shortcut_depthwise", "none",
          "a convolution where stride is 2");
  if (shortcut_pointwise) {
    require_pointwise(*shortcut_pointwise, function, "weights.shortcut_pointwise");
    require(shortcut_pointwise->group_channels == in_channels(), function,
            "weights.shortcut_pointwise.group_channels", shortcut_pointwise->group_channels,
            in_channels());
  }
  const int arriving = shortcut_pointwise ? shortcut_pointwise->out_channels : in_channels();
  require(arriving == out_channels(), function, "channels of the shortcut", arriving,
          out_channels());
}

void GhostC3Weights::validate(std::string_view function) const {
  require_pointwise(cv1, function, "weights.cv1");
  require_pointwise(cv2, function, "weights.cv2");
  require_pointwise(cv3, function, "weights.cv3");
  require(cv2.group_channels == cv1.group_channels, function, "weights.cv2.group_channels",
          cv2.group_channels, cv1.group_channels);
  const int joined = cv1.out_channels + cv2.out_channels;
  require(cv3.group_channels == joined, function, "weights.cv3.group_channels", cv3.group_channels,
          joined);
  for (const GhostBottleneckWeights& bottleneck : bottlenecks) {
    bottleneck.validate(function);
    require(bottleneck.stride == 1, function, "weights.bottlenecks.stride", bottleneck.stride, 1);
    require(bottleneck.in_channels() == cv1.out_channels, function,
            "weights.bottlenecks.in_channels()", bottleneck.in_channels(), cv1.out_channels);
    require(bottleneck.out_channels() == cv1.out_channels, function,
            "weights.bottlenecks.out_channels()", bottleneck.out_channels(), cv1.out_channels);
  }
}

void CbamWeights::validate(std::string_view function) const {
  require_size(channels, function, "weights.channels");
  require(reduced >= 1 && reduced <= channels, function, "weights.reduced", reduced,
          "1.." + std::to_string(channels));
  const auto c = static_cast<std::size_t>(channels);
  const auto r = static_cast<std::size_t>(reduced);
  require_length(hidden_weight.size(), c * r, function, "weights.hidden_weight");
  require_length(output_weight.size(), c * r, function, "weights.output_weight");
  require_length_or_empty(hidden_bias.size(), r, function, "weights.hidden_bias");
  require_length_or_empty(output_bias.size(), c, function, "weights.output_bias");
  spatial.validate(function, "weights.spatial");
  require(spatial.out_channels == 1, function, "weights.spatial.out_channels", spatial.out_channels,
          1);
  require(spatial.group_channels == 2, function, "weights.spatial.group_channels",
          spatial.group_channels, 2);
  require_kernel(spatial, spatial.kernel_width, spatial.kernel_width, function, "weights.spatial");
  require(spatial.kernel_width % 2 == 1, function, "weights.spatial.kernel_width",
          spatial.kernel_width, "an odd number");
}

void FpnLevelWeights::validate(std::string_view function) const {
  require_pointwise(lateral, function, "level.lateral");
  attention.validate(function);
  smooth.validate(function, "level.smooth");
  require_kernel(smooth, 3, 3, function, "level.smooth");
  const int channels = lateral.out_channels;
  require(attention.channels == channels, function, "level.attention.channels", attention.channels,
          channels);
  require(smooth.group_channels == channels && smooth.out_channels == channels, function,
          "level.smooth channels",
          std::to_string(smooth.group_channels) + " to " + std::to_string(smooth.out_channels),
          std::to_string(channels) + " to " + std::to_string(channels));
}

}  // namespace dynslam::attention
