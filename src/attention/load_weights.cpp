// Layers from the tensors of a file: names and shapes are checked here, whether layers fit together
// by their own `validate`.
#include <limits>
#include <string>

#include "dynslam/attention/safetensors.hpp"
#include "dynslam/core/errors.hpp"

namespace dynslam::attention {
namespace {

constexpr const char* kLoad = "load";

std::string shape_text(const std::vector<std::int64_t>& shape) {
  std::string text;
  for (const std::int64_t size : shape) text += (text.empty() ? "" : "x") + std::to_string(size);
  return text.empty() ? "a single number" : text;
}

const NamedTensor& tensor(const SafeTensors& file, const std::string& name,
                          std::size_t dimensions) {
  const NamedTensor& found = file.at(name);
  if (found.shape.size() != dimensions || found.values.empty()) {
    throw_io_error(file.name(), "tensor \"" + name + "\": has the shape " +
                                    shape_text(found.shape) + ", expected " +
                                    std::to_string(dimensions) + " dimensions, none of them 0");
  }
  return found;
}

std::vector<float> vector_of(const SafeTensors& file, const std::string& name, std::size_t size) {
  const NamedTensor& found = tensor(file, name, 1);
  if (found.values.size() != size) {
    throw_io_error(file.name(), "tensor \"" + name + "\": has " +
                                    std::to_string(found.values.size()) + " values, expected " +
                                    std::to_string(size));
  }
  return {found.values.begin(), found.values.end()};
}

/// What does not fit together comes from the file.
template <typename Weights>
Weights checked(const SafeTensors& file, const std::string& prefix, Weights weights) {
  try {
    weights.validate(kLoad);
  } catch (const InvalidArgument& error) {
    throw_io_error(file.name(), "layer \"" + prefix + "\": " + error.what());
  }
  return weights;
}

bool has_convolution(const SafeTensors& file, const std::string& prefix) {
  return file.contains(prefix + "conv.weight");
}

}  // namespace

Convolution load_convolution(const SafeTensors& file, const std::string& prefix, float epsilon) {
  const NamedTensor& weight = tensor(file, prefix + "conv.weight", 4);
  Convolution convolution;
  convolution.out_channels = static_cast<int>(weight.shape[0]);
  convolution.group_channels = static_cast<int>(weight.shape[1]);
  convolution.kernel_height = static_cast<int>(weight.shape[2]);
  convolution.kernel_width = static_cast<int>(weight.shape[3]);
  convolution.weight.assign(weight.values.begin(), weight.values.end());
  const auto channels = static_cast<std::size_t>(convolution.out_channels);
  if (file.contains(prefix + "conv.bias")) {
    convolution.bias = vector_of(file, prefix + "conv.bias", channels);
  }
  try {
    convolution.validate(kLoad, prefix + "conv");
    if (!file.contains(prefix + "bn.weight")) return convolution;
    const auto gamma = vector_of(file, prefix + "bn.weight", channels);
    const auto beta = vector_of(file, prefix + "bn.bias", channels);
    const auto mean = vector_of(file, prefix + "bn.running_mean", channels);
    const auto variance = vector_of(file, prefix + "bn.running_var", channels);
    return fold_batch_norm(std::move(convolution), {gamma, beta, mean, variance, epsilon});
  } catch (const InvalidArgument& error) {
    throw_io_error(file.name(), "layer \"" + prefix + "\": " + error.what());
  }
}

DfcWeights load_dfc(const SafeTensors& file, const std::string& prefix, float epsilon) {
  return checked(file, prefix,
                 DfcWeights{load_convolution(file, prefix + "pointwise.", epsilon),
                            load_convolution(file, prefix + "horizontal.", epsilon),
                            load_convolution(file, prefix + "vertical.", epsilon)});
}

GhostModuleWeights load_ghost_module(const SafeTensors& file, const std::string& prefix,
                                     Activation activation, int out_channels, float epsilon) {
  GhostModuleWeights weights;
  weights.primary = load_convolution(file, prefix + "primary.", epsilon);
  weights.cheap = load_convolution(file, prefix + "cheap.", epsilon);
  weights.out_channels = out_channels > 0 ? out_channels : 2 * weights.primary.out_channels;
  weights.activation = activation;
  return checked(file, prefix, std::move(weights));
}

GhostBottleneckWeights load_ghost_bottleneck(const SafeTensors& file, const std::string& prefix,
                                             Activation activation, bool shortcut, float epsilon) {
  GhostBottleneckWeights weights;
  // How many channels a module keeps shows in what follows it: the attention or the module behind.
  weights.expand.primary = load_convolution(file, prefix + "expand.primary.", epsilon);
  weights.expand.cheap = load_convolution(file, prefix + "expand.cheap.", epsilon);
  weights.expand.activation = activation;
  if (has_convolution(file, prefix + "attention.pointwise.")) {
    weights.attention = load_dfc(file, prefix + "attention.", epsilon);
  }
  if (has_convolution(file, prefix + "downsample.")) {
    weights.downsample = load_convolution(file, prefix + "downsample.", epsilon);
    weights.stride = 2;
  }
  weights.project.primary = load_convolution(file, prefix + "project.primary.", epsilon);
  weights.project.cheap = load_convolution(file, prefix + "project.cheap.", epsilon);
  weights.project.activation = Activation::kNone;
  weights.expand.out_channels = weights.project.primary.group_channels;
  weights.shortcut = shortcut;
  weights.project.out_channels = 2 * weights.project.primary.out_channels;
  if (shortcut) weights.project.out_channels = weights.in_channels();
  if (has_convolution(file, prefix + "shortcut_depthwise.")) {
    weights.shortcut_depthwise = load_convolution(file, prefix + "shortcut_depthwise.", epsilon);
  }
  if (has_convolution(file, prefix + "shortcut_pointwise.")) {
    weights.shortcut_pointwise = load_convolution(file, prefix + "shortcut_pointwise.", epsilon);
    weights.project.out_channels = weights.shortcut_pointwise->out_channels;
  }
  return checked(file, prefix, std::move(weights));
}

GhostC3Weights load_ghost_c3(const SafeTensors& file, const std::string& prefix,
                             Activation ghost_activation, bool shortcut, float epsilon) {
  GhostC3Weights weights;
  weights.cv1 = load_convolution(file, prefix + "cv1.", epsilon);
  weights.cv2 = load_convolution(file, prefix + "cv2.", epsilon);
  weights.cv3 = load_convolution(file, prefix + "cv3.", epsilon);
  for (int i = 0;; ++i) {
    const std::string inner = prefix + "m." + std::to_string(i) + ".";
    if (!has_convolution(file, inner + "expand.primary.")) break;
    GhostBottleneckWeights bottleneck =
        load_ghost_bottleneck(file, inner, ghost_activation, shortcut, epsilon);
    // In a block the output is as wide as the input, of which the file says nothing without a
    // shortcut.
    bottleneck.project.out_channels = weights.cv1.out_channels;
    weights.bottlenecks.push_back(std::move(bottleneck));
  }
  return checked(file, prefix, std::move(weights));
}

CbamWeights load_cbam(const SafeTensors& file, const std::string& prefix, float epsilon) {
  CbamWeights weights;
  const NamedTensor& hidden = tensor(file, prefix + "channel.fc0.weight", 2);
  const NamedTensor& output = tensor(file, prefix + "channel.fc1.weight", 2);
  weights.reduced = static_cast<int>(hidden.shape[0]);
  weights.channels = static_cast<int>(hidden.shape[1]);
  if (output.shape[0] != hidden.shape[1] || output.shape[1] != hidden.shape[0]) {
    throw_io_error(file.name(), "tensor \"" + prefix + "channel.fc1.weight\": has the shape " +
                                    shape_text(output.shape) + ", that of fc0 transposed is " +
                                    shape_text({hidden.shape[1], hidden.shape[0]}));
  }
  weights.hidden_weight.assign(hidden.values.begin(), hidden.values.end());
  weights.output_weight.assign(output.values.begin(), output.values.end());
  if (file.contains(prefix + "channel.fc0.bias")) {
    weights.hidden_bias =
        vector_of(file, prefix + "channel.fc0.bias", static_cast<std::size_t>(weights.reduced));
  }
  if (file.contains(prefix + "channel.fc1.bias")) {
    weights.output_bias =
        vector_of(file, prefix + "channel.fc1.bias", static_cast<std::size_t>(weights.channels));
  }
  weights.spatial = load_convolution(file, prefix + "space.spatial.", epsilon);
  return checked(file, prefix, std::move(weights));
}

FpnLevelWeights load_fpn_level(const SafeTensors& file, const std::string& prefix) {
  return checked(file, prefix,
                 FpnLevelWeights{load_convolution(file, prefix + "lateral."),
                                 load_cbam(file, prefix + "attention."),
                                 load_convolution(file, prefix + "smooth.")});
}

}  // namespace dynslam::attention
