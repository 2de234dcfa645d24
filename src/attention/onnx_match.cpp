// The pieces that all layers share, and the Ghost family. onnx_match_cbam.cpp holds CBAM.
#include "attention/onnx_match.hpp"

#include <algorithm>
#include <utility>

#include "dynslam/core/errors.hpp"

namespace dynslam::attention::onnx {
namespace {

using Ints = std::vector<std::int64_t>;

std::int64_t integer_of(const Node& node, const char* name, std::int64_t otherwise) {
  const Attribute* attribute = attribute_of(node, name);
  return attribute == nullptr ? otherwise : attribute->integer;
}

std::string text_of(const Node& node, const char* name, const char* otherwise) {
  const Attribute* attribute = attribute_of(node, name);
  return attribute == nullptr ? otherwise : attribute->text;
}

/// Whether an attribute is absent or these integers.
bool is_or_absent(const Node& node, const char* name, const Ints& wanted) {
  const Attribute* attribute = attribute_of(node, name);
  return attribute == nullptr || attribute->integers == wanted;
}

bool is_exactly(const Node& node, const char* name, const Ints& wanted) {
  const Attribute* attribute = attribute_of(node, name);
  return attribute != nullptr && attribute->integers == wanted;
}

bool pads_itself(const Node& node) { return text_of(node, "auto_pad", "NOTSET") != "NOTSET"; }

bool fits(const Convolution& weights) {
  try {
    weights.validate("fuse_onnx", "convolution");
    return true;
  } catch (const InvalidArgument&) {
    return false;
  }
}

template <typename Weights>
bool fits(const Weights& weights) {
  try {
    weights.validate("fuse_onnx");
    return true;
  } catch (const InvalidArgument&) {
    return false;
  }
}

}  // namespace

GraphIndex::GraphIndex(const Model& model, const std::string& name) : model_(model) {
  for (std::size_t i = 0; i < model.nodes.size(); ++i) {
    const Node& node = model.nodes[i];
    names_.insert(node.name);
    for (const std::string& value : node.outputs) {
      if (value.empty()) continue;
      names_.insert(value);
      if (!producers_.emplace(value, static_cast<int>(i)).second) {
        throw_io_error(name, "two nodes make the value \"" + value + "\"");
      }
    }
    for (const std::string& value : node.inputs) {
      names_.insert(value);
      consumers_[value].push_back(static_cast<int>(i));
    }
  }
  outputs_.insert(model.outputs.begin(), model.outputs.end());
}

int GraphIndex::producer(const std::string& value) const {
  const auto found = producers_.find(value);
  return found == producers_.end() ? -1 : found->second;
}

const std::vector<int>& GraphIndex::consumers(const std::string& value) const {
  static const std::vector<int> none;
  const auto found = consumers_.find(value);
  return found == consumers_.end() ? none : found->second;
}

const Node* Matcher::made_by(const std::string& value, const char* op) {
  const int index = graph_.producer(value);
  if (index < 0) return nullptr;
  const Node& node = graph_.node(index);
  const bool own = node.domain.empty() || node.domain == "ai.onnx";
  if (!own || node.op != op || node.inputs.empty() || node.outputs[0] != value) return nullptr;
  used_.push_back(index);
  return &node;
}

bool Matcher::constant(const std::string& value, Tensor& tensor) const {
  const auto found = graph_.model().constants.find(value);
  return found != graph_.model().constants.end() && read_tensor(found->second, tensor);
}

bool Matcher::constant_ints(const Node& node, const char* attribute, std::size_t input,
                            Ints& values) const {
  if (const Attribute* found = attribute_of(node, attribute)) {
    values = found->integers;
    return true;
  }
  Tensor tensor;
  if (node.inputs.size() <= input || !constant(node.inputs[input], tensor)) return false;
  values = tensor.ints;
  return !values.empty();
}

std::string Matcher::skip(std::string value, std::initializer_list<const char*> ops) {
  for (std::size_t steps = 0; steps < graph_.model().nodes.size(); ++steps) {
    const Node* node = nullptr;
    for (const char* op : ops) {
      if (node == nullptr) node = made_by(value, op);
    }
    if (node == nullptr) break;
    value = node->inputs[0];
  }
  return value;
}

Activation Matcher::activation(const std::string& value, std::string& input) {
  if (const Node* relu = made_by(value, "Relu")) {
    input = relu->inputs[0];
    return Activation::kRelu;
  }
  const std::size_t before = used_.size();
  const Node* product = made_by(value, "Mul");
  if (product != nullptr && product->inputs.size() == 2) {
    for (const std::size_t i : {0U, 1U}) {
      const Node* gate = made_by(product->inputs[i], "Sigmoid");
      if (gate != nullptr && gate->inputs[0] == product->inputs[1 - i]) {
        input = gate->inputs[0];
        return Activation::kSilu;
      }
    }
  }
  used_.resize(before);
  input = value;
  return Activation::kNone;
}

bool Matcher::convolution_weights(const Node& node, MatchedConvolution& out) const {
  Tensor weight;
  if (node.inputs.size() < 2 || !constant(node.inputs[1], weight) || weight.shape.size() != 4 ||
      weight.floats.empty()) {
    return false;
  }
  for (const std::int64_t size : weight.shape) {
    if (size < 1 || size > (1 << 20)) return false;
  }
  Convolution& c = out.weights;
  c.out_channels = static_cast<int>(weight.shape[0]);
  c.group_channels = static_cast<int>(weight.shape[1]);
  c.kernel_height = static_cast<int>(weight.shape[2]);
  c.kernel_width = static_cast<int>(weight.shape[3]);
  c.weight = std::move(weight.floats);
  c.bias.clear();
  if (node.inputs.size() > 2 && !node.inputs[2].empty()) {
    Tensor bias;
    if (!constant(node.inputs[2], bias)) return false;
    c.bias = std::move(bias.floats);
    if (c.bias.empty()) return false;
  }
  return true;
}

bool Matcher::fold(const Node& norm, MatchedConvolution& out) const {
  Tensor parts[4];
  for (std::size_t i = 0; i < 4; ++i) {
    if (norm.inputs.size() != 5 || !constant(norm.inputs[i + 1], parts[i])) return false;
  }
  const Attribute* epsilon = attribute_of(norm, "epsilon");
  if (integer_of(norm, "training_mode", 0) != 0) return false;
  try {
    out.weights = fold_batch_norm(
        std::move(out.weights), {parts[0].floats, parts[1].floats, parts[2].floats, parts[3].floats,
                                 epsilon == nullptr ? 1e-5F : epsilon->number});
    return true;
  } catch (const InvalidArgument&) {
    return false;
  }
}

bool Matcher::convolution(const std::string& value, MatchedConvolution& out) {
  const Node* norm = made_by(value, "BatchNormalization");
  const Node* node = made_by(norm == nullptr ? value : norm->inputs[0], "Conv");
  if (node == nullptr || pads_itself(*node) || !convolution_weights(*node, out)) return false;
  const std::int64_t pad_y = (out.weights.kernel_height - 1) / 2;
  const std::int64_t pad_x = (out.weights.kernel_width - 1) / 2;
  const bool padded = is_exactly(*node, "pads", {pad_y, pad_x, pad_y, pad_x}) ||
                      (pad_y == 0 && pad_x == 0 && attribute_of(*node, "pads") == nullptr);
  if (!padded || !is_or_absent(*node, "dilations", {1, 1})) return false;
  if (is_or_absent(*node, "strides", {1, 1})) {
    out.stride = 1;
  } else if (is_exactly(*node, "strides", {2, 2})) {
    out.stride = 2;
  } else {
    return false;
  }
  out.groups = static_cast<int>(integer_of(*node, "group", 1));
  out.input = node->inputs[0];
  if (!fits(out.weights)) return false;
  return norm == nullptr || fold(*norm, out);
}

bool Matcher::activated(const std::string& value, MatchedConvolution& out, Activation& function) {
  std::string before;
  function = activation(value, before);
  return convolution(before, out);
}

bool Matcher::ghost_module(const std::string& value, GhostModuleWeights& weights,
                           std::string& input) {
  std::string joined = value;
  std::int64_t kept = 0;
  if (const Node* slice = made_by(value, "Slice")) {
    Ints starts, ends, axes, steps;
    if (!constant_ints(*slice, "starts", 1, starts) || !constant_ints(*slice, "ends", 2, ends) ||
        !constant_ints(*slice, "axes", 3, axes)) {
      return false;
    }
    const bool stepped = constant_ints(*slice, "steps", 4, steps) && steps != Ints{1};
    if (starts != Ints{0} || axes != Ints{1} || ends.size() != 1 || ends[0] < 1 || stepped) {
      return false;
    }
    kept = ends[0];
    joined = slice->inputs[0];
  }
  const Node* concat = made_by(joined, "Concat");
  if (concat == nullptr || concat->inputs.size() != 2 || integer_of(*concat, "axis", 0) != 1) {
    return false;
  }
  return ghost_halves(concat->inputs[0], concat->inputs[1], kept, weights, input);
}

bool Matcher::ghost_halves(const std::string& upper, const std::string& lower, std::int64_t kept,
                           GhostModuleWeights& weights, std::string& input) {
  MatchedConvolution primary, cheap;
  Activation first = Activation::kNone;
  Activation second = Activation::kNone;
  if (!activated(lower, cheap, second) || cheap.input != upper ||
      !activated(upper, primary, first) || first != second) {
    return false;
  }
  if (!primary.pointwise() || !cheap.depthwise() || !cheap.square() || cheap.stride != 1) {
    return false;
  }
  const std::int64_t all = 2 * std::int64_t{primary.weights.out_channels};
  weights.out_channels = static_cast<int>(kept == 0 ? all : std::min(kept, all));
  weights.primary = std::move(primary.weights);
  weights.cheap = std::move(cheap.weights);
  weights.activation = first;
  input = primary.input;
  return fits(weights);
}

bool Matcher::pooled2(const std::string& value, std::string& input) {
  const Node* pool = made_by(value, "AveragePool");
  if (pool == nullptr || pads_itself(*pool) || integer_of(*pool, "ceil_mode", 0) != 0 ||
      !is_exactly(*pool, "kernel_shape", {2, 2}) || !is_exactly(*pool, "strides", {2, 2}) ||
      !is_or_absent(*pool, "pads", {0, 0, 0, 0})) {
    return false;
  }
  input = pool->inputs[0];
  // PyTorch exports the padding of a pooling even where it is nothing.
  const std::size_t before = used_.size();
  const Node* pad = made_by(input, "Pad");
  Ints pads;
  if (pad != nullptr && constant_ints(*pad, "pads", 1, pads) &&
      std::all_of(pads.begin(), pads.end(), [](std::int64_t p) { return p == 0; })) {
    input = pad->inputs[0];
  } else {
    used_.resize(before);
  }
  return true;
}

bool Matcher::upsampled(const std::string& value, std::string& input) {
  const Node* node = made_by(value, "Resize");
  if (node != nullptr) {
    const bool floor =
        text_of(*node, "coordinate_transformation_mode", "half_pixel") == "asymmetric" &&
        text_of(*node, "nearest_mode", "round_prefer_floor") == "floor";
    // Before version 11 there was one way only, this one.
    if (!floor && node->inputs.size() != 2) return false;
  } else {
    node = made_by(value, "Upsample");
  }
  if (node == nullptr || text_of(*node, "mode", "nearest") != "nearest") return false;
  input = node->inputs[0];
  if (node->inputs.size() == 4 && !node->inputs[3].empty()) return true;
  // By a factor, which has to be the pooling's.
  Tensor scales;
  const std::size_t at = node->inputs.size() == 2 ? 1 : 2;
  return node->inputs.size() > at && constant(node->inputs[at], scales) &&
         scales.floats == std::vector<float>{1.0F, 1.0F, 2.0F, 2.0F};
}

bool Matcher::dfc_map(const std::string& value, DfcWeights& weights, std::string& input) {
  std::string at;
  if (!upsampled(value, at)) return false;
  const Node* gate = made_by(at, "Sigmoid");
  if (gate == nullptr) return false;
  MatchedConvolution vertical, horizontal, pointwise;
  if (!convolution(gate->inputs[0], vertical) || !convolution(vertical.input, horizontal) ||
      !convolution(horizontal.input, pointwise) || !pooled2(pointwise.input, input)) {
    return false;
  }
  if (!vertical.depthwise() || !horizontal.depthwise() || !pointwise.pointwise() ||
      vertical.stride != 1 || horizontal.stride != 1) {
    return false;
  }
  weights.pointwise = std::move(pointwise.weights);
  weights.horizontal = std::move(horizontal.weights);
  weights.vertical = std::move(vertical.weights);
  return fits(weights);
}

bool Matcher::dfc(const std::string& value, DfcWeights& weights, std::string& input,
                  std::string& features) {
  const Node* product = made_by(value, "Mul");
  if (product == nullptr || product->inputs.size() != 2) return false;
  const std::size_t before = used_.size();
  for (const std::size_t i : {1U, 0U}) {
    features = product->inputs[1 - i];
    if (dfc_map(product->inputs[i], weights, input)) return true;
    used_.resize(before);
  }
  return false;
}

/// From what the second Ghost module sees back to the input.
bool Matcher::expanded(const std::string& value, GhostBottleneckWeights& weights,
                       std::string& input) {
  std::string at = value;
  std::size_t before = used_.size();
  MatchedConvolution strided;
  if (convolution(value, strided) && strided.depthwise() && strided.square() &&
      strided.stride == 2) {
    at = strided.input;
    weights.downsample = std::move(strided.weights);
    weights.stride = 2;
  } else {
    used_.resize(before);
  }
  before = used_.size();
  DfcWeights attention;
  std::string seen;
  std::string features;
  if (dfc(at, attention, seen, features) && ghost_module(features, weights.expand, input) &&
      input == seen) {
    weights.attention = std::move(attention);
    return true;
  }
  used_.resize(before);
  return ghost_module(at, weights.expand, input);
}

bool Matcher::shortcut(const std::string& value, const std::string& input,
                       GhostBottleneckWeights& weights) {
  weights.shortcut = true;
  if (value == input) return true;
  MatchedConvolution pointwise;
  if (!convolution(value, pointwise) || !pointwise.pointwise()) return false;
  weights.shortcut_pointwise = std::move(pointwise.weights);
  if (pointwise.input == input) return true;
  MatchedConvolution depthwise;
  if (!convolution(pointwise.input, depthwise) || !depthwise.depthwise() || !depthwise.square() ||
      depthwise.stride != weights.stride || depthwise.input != input) {
    return false;
  }
  weights.shortcut_depthwise = std::move(depthwise.weights);
  return true;
}

/// A bottleneck whose second module is `weights.project`, which sees `inner`.
bool Matcher::before_project(const std::string& inner, const std::string* added,
                             GhostBottleneckWeights& weights, std::string& input) {
  if (weights.project.activation != Activation::kNone || !expanded(inner, weights, input)) {
    return false;
  }
  weights.shortcut = false;
  return (added == nullptr || shortcut(*added, input, weights)) && fits(weights);
}

bool Matcher::ghost_bottleneck(const std::string& value, GhostBottleneckWeights& weights,
                               std::string& input) {
  const auto from = [&](const std::string& projected, const std::string* added) {
    weights = GhostBottleneckWeights();
    std::string inner;
    return ghost_module(projected, weights.project, inner) &&
           before_project(inner, added, weights, input);
  };
  const Node* sum = made_by(value, "Add");
  if (sum == nullptr) return from(value, nullptr);
  if (sum->inputs.size() != 2) return false;
  const std::size_t before = used_.size();
  for (const std::size_t i : {0U, 1U}) {
    if (from(sum->inputs[i], &sum->inputs[1 - i])) return true;
    used_.resize(before);
  }
  return false;
}

bool Matcher::ghost_c3(const std::string& value, GhostC3Weights& weights, std::string& input) {
  MatchedConvolution cv1, cv2, cv3;
  Activation act1 = Activation::kNone;
  Activation act2 = Activation::kNone;
  Activation act3 = Activation::kNone;
  if (!activated(value, cv3, act3) || !cv3.pointwise()) return false;
  const Node* concat = made_by(cv3.input, "Concat");
  if (concat == nullptr || concat->inputs.size() < 2 || concat->inputs.size() > 3 ||
      integer_of(*concat, "axis", 0) != 1 || !activated(concat->inputs.back(), cv2, act2) ||
      !cv2.pointwise()) {
    return false;
  }
  weights = GhostC3Weights();
  std::string at = concat->inputs[0];
  if (concat->inputs.size() == 3) {
    // Without a shortcut the last module's halves are joined here, which exporters do in one.
    GhostBottleneckWeights last;
    std::string inner;
    if (!ghost_halves(concat->inputs[0], concat->inputs[1], 0, last.project, inner) ||
        !before_project(inner, nullptr, last, at)) {
      return false;
    }
    weights.bottlenecks.push_back(std::move(last));
  }
  while (weights.bottlenecks.size() < graph_.model().nodes.size()) {
    const std::size_t before = used_.size();
    if (activated(at, cv1, act1) && cv1.pointwise()) break;
    used_.resize(before);
    GhostBottleneckWeights bottleneck;
    std::string next;
    if (!ghost_bottleneck(at, bottleneck, next)) return false;
    if (bottleneck.shortcut_depthwise || bottleneck.shortcut_pointwise) return false;
    weights.bottlenecks.insert(weights.bottlenecks.begin(), std::move(bottleneck));
    at = next;
  }
  if (weights.bottlenecks.empty() || cv1.input.empty() || cv1.input != cv2.input || act1 != act2 ||
      act2 != act3) {
    return false;
  }
  weights.cv1 = std::move(cv1.weights);
  weights.cv2 = std::move(cv2.weights);
  weights.cv3 = std::move(cv3.weights);
  weights.activation = act1;
  input = cv2.input;
  return fits(weights);
}

}  // namespace dynslam::attention::onnx
