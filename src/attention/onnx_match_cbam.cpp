// CBAM in a graph of primitive operators.
#include <algorithm>
#include <utility>

#include "dynslam/core/errors.hpp"

#include "attention/onnx_match.hpp"

namespace dynslam::attention::onnx {
namespace {

using Ints = std::vector<std::int64_t>;

// What changes the shape of a vector of channels but not its values.
constexpr std::initializer_list<const char*> kShapers = {"Flatten",   "Reshape", "Squeeze",
                                                         "Unsqueeze", "Expand",  "Identity"};

bool is_zero_or_absent(const Node& node, const char* name) {
  const Attribute* attribute = attribute_of(node, name);
  if (attribute == nullptr) return true;
  return attribute->integer == 0 &&
         std::all_of(attribute->integers.begin(), attribute->integers.end(),
                     [](std::int64_t v) { return v == 0; });
}

bool is_one_or_absent(const Node& node, const char* name) {
  const Attribute* attribute = attribute_of(node, name);
  return attribute == nullptr || attribute->number == 1.0F;
}

std::vector<float> transposed(const std::vector<float>& matrix, int rows, int columns) {
  std::vector<float> out(matrix.size());
  const auto r = static_cast<std::size_t>(rows);
  const auto c = static_cast<std::size_t>(columns);
  for (std::size_t i = 0; i < r; ++i) {
    for (std::size_t j = 0; j < c; ++j) out[j * r + i] = matrix[i * c + j];
  }
  return out;
}

}  // namespace

/// A fully connected layer in any of its spellings.
bool Matcher::linear(const std::string& value, Linear& out, std::string& input) {
  const std::size_t before = used_.size();
  MatchedConvolution conv;
  if (convolution(value, conv) && conv.pointwise()) {
    out = {std::move(conv.weights.weight), std::move(conv.weights.bias), conv.weights.out_channels,
           conv.weights.group_channels};
    input = conv.input;
    return true;
  }
  used_.resize(before);
  Tensor weight;
  Tensor bias;
  bool by_rows = false;
  if (const Node* gemm = made_by(value, "Gemm")) {
    const Attribute* transposed_b = attribute_of(*gemm, "transB");
    by_rows = transposed_b != nullptr && transposed_b->integer == 1;
    if (gemm->inputs.size() < 2 || !constant(gemm->inputs[1], weight) ||
        !is_zero_or_absent(*gemm, "transA") || !is_one_or_absent(*gemm, "alpha") ||
        !is_one_or_absent(*gemm, "beta")) {
      return false;
    }
    if (gemm->inputs.size() > 2 && !constant(gemm->inputs[2], bias)) return false;
    input = gemm->inputs[0];
  } else {
    const Node* sum = made_by(value, "Add");
    std::string product = value;
    if (sum != nullptr) {
      if (sum->inputs.size() != 2) return false;
      const bool second = constant(sum->inputs[1], bias);
      if (!second && !constant(sum->inputs[0], bias)) return false;
      product = sum->inputs[second ? 0 : 1];
    }
    const Node* matmul = made_by(product, "MatMul");
    if (matmul == nullptr || matmul->inputs.size() != 2 || !constant(matmul->inputs[1], weight)) {
      return false;
    }
    input = matmul->inputs[0];
  }
  if (weight.shape.size() != 2 || weight.floats.empty()) return false;
  for (const std::int64_t size : weight.shape) {
    if (size < 1 || size > (1 << 20)) return false;
  }
  out.rows = static_cast<int>(weight.shape[by_rows ? 0 : 1]);
  out.columns = static_cast<int>(weight.shape[by_rows ? 1 : 0]);
  out.weight =
      by_rows ? std::move(weight.floats) : transposed(weight.floats, out.columns, out.rows);
  out.bias = std::move(bias.floats);
  return out.bias.empty() || out.bias.size() == static_cast<std::size_t>(out.rows);
}

bool Matcher::global_pool(const std::string& value, Pool& pool, std::string& input) {
  pool = Pool();
  const Node* node = made_by(value, "GlobalAveragePool");
  if (node == nullptr) {
    node = made_by(value, "GlobalMaxPool");
    pool.largest = node != nullptr;
  }
  if (node != nullptr) {
    input = node->inputs[0];
    return true;
  }
  for (const bool largest : {false, true}) {
    node = made_by(value, largest ? "ReduceMax" : "ReduceMean");
    if (node == nullptr) continue;
    Ints axes;
    pool.largest = largest;
    input = node->inputs[0];
    return constant_ints(*node, "axes", 1, axes) && (axes == Ints{2, 3} || axes == Ints{-2, -1});
  }
  // A window as large as the map.
  for (const bool largest : {false, true}) {
    node = made_by(value, largest ? "MaxPool" : "AveragePool");
    if (node == nullptr) continue;
    const Attribute* kernel = attribute_of(*node, "kernel_shape");
    if (kernel == nullptr || kernel->integers.size() != 2 || !is_zero_or_absent(*node, "pads") ||
        attribute_of(*node, "dilations") != nullptr || attribute_of(*node, "auto_pad") != nullptr) {
      return false;
    }
    for (const std::int64_t size : kernel->integers) {
      if (size < 1 || size > (1 << 20)) return false;
    }
    pool.largest = largest;
    pool.height = static_cast<int>(kernel->integers[0]);
    pool.width = static_cast<int>(kernel->integers[1]);
    input = node->inputs[0];
    return true;
  }
  return false;
}

bool Matcher::perceptron(const std::string& value, Linear& hidden, Linear& output, Pool& pool,
                         std::string& input) {
  std::string at;
  if (!linear(skip(value, kShapers), output, at)) return false;
  const Node* relu = made_by(skip(at, kShapers), "Relu");
  if (relu == nullptr || !linear(skip(relu->inputs[0], kShapers), hidden, at)) return false;
  return global_pool(skip(at, kShapers), pool, input);
}

bool Matcher::channel_attention(const std::string& value, CbamWeights& weights, int& height,
                                int& width, std::string& input) {
  const Node* product = made_by(value, "Mul");
  if (product == nullptr || product->inputs.size() != 2) return false;
  const std::size_t before = used_.size();
  for (const std::size_t i : {1U, 0U}) {
    used_.resize(before);
    const Node* gate = made_by(skip(product->inputs[i], kShapers), "Sigmoid");
    const Node* sum = gate == nullptr ? nullptr : made_by(skip(gate->inputs[0], kShapers), "Add");
    if (sum == nullptr || sum->inputs.size() != 2) continue;
    Linear hidden[2], output[2];
    Pool pool[2];
    std::string seen[2];
    if (!perceptron(sum->inputs[0], hidden[0], output[0], pool[0], seen[0]) ||
        !perceptron(sum->inputs[1], hidden[1], output[1], pool[1], seen[1])) {
      continue;
    }
    input = product->inputs[1 - i];
    const bool same = hidden[0].weight == hidden[1].weight && hidden[0].bias == hidden[1].bias &&
                      output[0].weight == output[1].weight && output[0].bias == output[1].bias &&
                      hidden[0].rows == hidden[1].rows && output[0].rows == output[1].rows;
    const bool sized = pool[0].height == 0 || pool[1].height == 0 ||
                       (pool[0].height == pool[1].height && pool[0].width == pool[1].width);
    if (!same || !sized || seen[0] != input || seen[1] != input ||
        pool[0].largest == pool[1].largest) {
      continue;
    }
    weights.channels = hidden[0].columns;
    weights.reduced = hidden[0].rows;
    if (output[0].rows != weights.channels || output[0].columns != weights.reduced) continue;
    weights.hidden_weight = std::move(hidden[0].weight);
    weights.hidden_bias = std::move(hidden[0].bias);
    weights.output_weight = std::move(output[0].weight);
    weights.output_bias = std::move(output[0].bias);
    height = std::max(pool[0].height, pool[1].height);
    width = std::max(pool[0].width, pool[1].width);
    return true;
  }
  return false;
}

bool Matcher::reduced(const std::string& value, const char* op, std::string& input) {
  const std::size_t before = used_.size();
  const Node* node = made_by(skip(value, {"Unsqueeze"}), op);
  Ints axes;
  if (node == nullptr || !constant_ints(*node, "axes", 1, axes) || axes != Ints{1}) {
    used_.resize(before);
    return false;
  }
  input = node->inputs[0];
  return true;
}

bool Matcher::spatial_attention(const std::string& value, CbamWeights& weights,
                                std::string& input) {
  const Node* product = made_by(value, "Mul");
  if (product == nullptr || product->inputs.size() != 2) return false;
  const std::size_t before = used_.size();
  for (const std::size_t i : {1U, 0U}) {
    used_.resize(before);
    const Node* gate = made_by(skip(product->inputs[i], {"Expand", "Identity"}), "Sigmoid");
    MatchedConvolution conv;
    if (gate == nullptr || !convolution(gate->inputs[0], conv) || !conv.dense() ||
        conv.stride != 1 || conv.weights.out_channels != 1 || conv.weights.group_channels != 2) {
      continue;
    }
    const Node* concat = made_by(conv.input, "Concat");
    const Attribute* axis = concat == nullptr ? nullptr : attribute_of(*concat, "axis");
    if (axis == nullptr || axis->integer != 1 || concat->inputs.size() != 2) continue;
    std::string of_max, of_mean;
    const bool max_first = reduced(concat->inputs[0], "ReduceMax", of_max);
    if (!reduced(concat->inputs[max_first ? 1 : 0], "ReduceMean", of_mean) ||
        (!max_first && !reduced(concat->inputs[1], "ReduceMax", of_max))) {
      continue;
    }
    input = product->inputs[1 - i];
    if (of_max != input || of_mean != input) continue;
    if (!max_first) {
      std::vector<float>& w = conv.weights.weight;
      std::rotate(w.begin(), w.begin() + static_cast<std::ptrdiff_t>(w.size() / 2), w.end());
    }
    weights.spatial = std::move(conv.weights);
    return true;
  }
  return false;
}

bool Matcher::cbam(const std::string& value, CbamWeights& weights, CbamOrder& order, int& height,
                   int& width, std::string& input) {
  std::string between;
  height = width = 0;
  if (spatial_attention(value, weights, between)) {
    order = CbamOrder::kChannelFirst;
    if (!channel_attention(between, weights, height, width, input)) return false;
  } else {
    used_.clear();
    order = CbamOrder::kSpatialFirst;
    if (!channel_attention(value, weights, height, width, between) ||
        !spatial_attention(between, weights, input)) {
      return false;
    }
  }
  try {
    weights.validate("fuse_onnx");
    return true;
  } catch (const InvalidArgument&) {
    return false;
  }
}

}  // namespace dynslam::attention::onnx
