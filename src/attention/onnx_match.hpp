// Finds layers in a graph of primitive operators, backwards from the value that they compute.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "dynslam/attention/cbam.hpp"
#include "dynslam/attention/weights.hpp"

#include "attention/onnx_graph.hpp"

namespace dynslam::attention::onnx {

/// Who makes and who uses which value.
class GraphIndex {
 public:
  /// Throws IoError if two nodes make one value.
  GraphIndex(const Model& model, const std::string& name);

  const Model& model() const { return model_; }
  /// The node that makes `value`; -1 for inputs and initializers.
  int producer(const std::string& value) const;
  const std::vector<int>& consumers(const std::string& value) const;
  bool is_output(const std::string& value) const { return outputs_.count(value) > 0; }
  bool is_name(const std::string& value) const { return names_.count(value) > 0; }
  const Node& node(int index) const { return model_.nodes[static_cast<std::size_t>(index)]; }

 private:
  const Model& model_;
  std::map<std::string, int> producers_;
  std::map<std::string, std::vector<int>> consumers_;
  std::set<std::string> outputs_;
  std::set<std::string> names_;
};

/// A convolution padded to its input's size (over the stride), normalization folded in.
struct MatchedConvolution {
  Convolution weights;
  int stride = 1;
  int groups = 1;
  std::string input;

  bool dense() const { return groups == 1; }
  bool pointwise() const {
    return dense() && stride == 1 && weights.kernel_height == 1 && weights.kernel_width == 1;
  }
  bool depthwise() const { return groups == weights.out_channels && weights.group_channels == 1; }
  bool square() const {
    return weights.kernel_height == weights.kernel_width && weights.kernel_width % 2 == 1;
  }
};

/// Matches one layer. Every method takes the name of a value and says whether that value is what
/// the layer computes; nodes that were passed on the way are in `used()` then. One object, one
/// match.
class Matcher {
 public:
  explicit Matcher(const GraphIndex& graph) : graph_(graph) {}

  bool ghost_c3(const std::string& value, GhostC3Weights& weights, std::string& input);
  bool ghost_bottleneck(const std::string& value, GhostBottleneckWeights& weights,
                        std::string& input);
  bool ghost_module(const std::string& value, GhostModuleWeights& weights, std::string& input);
  bool dfc(const std::string& value, DfcWeights& weights, std::string& input,
           std::string& features);
  /// `height` and `width` as in flatten().
  bool cbam(const std::string& value, CbamWeights& weights, CbamOrder& order, int& height,
            int& width, std::string& input);

  const std::vector<int>& used() const { return used_; }

 private:
  struct Linear {
    std::vector<float> weight;
    std::vector<float> bias;
    int rows = 0;
    int columns = 0;
  };
  struct Pool {
    bool largest = false;
    int height = 0;
    int width = 0;
  };

  /// The node that makes `value`, if it is an `op` of ONNX's own domain; else null.
  const Node* made_by(const std::string& value, const char* op);
  bool constant(const std::string& value, Tensor& tensor) const;
  bool constant_ints(const Node& node, const char* attribute, std::size_t input,
                     std::vector<std::int64_t>& values) const;
  std::string skip(std::string value, std::initializer_list<const char*> ops);

  Activation activation(const std::string& value, std::string& input);
  bool convolution(const std::string& value, MatchedConvolution& out);
  bool convolution_weights(const Node& node, MatchedConvolution& out) const;
  bool fold(const Node& norm, MatchedConvolution& out) const;
  bool activated(const std::string& value, MatchedConvolution& out, Activation& function);
  bool ghost_halves(const std::string& upper, const std::string& lower, std::int64_t kept,
                    GhostModuleWeights& weights, std::string& input);
  bool before_project(const std::string& inner, const std::string* added,
                      GhostBottleneckWeights& weights, std::string& input);
  bool pooled2(const std::string& value, std::string& input);
  bool upsampled(const std::string& value, std::string& input);
  bool dfc_map(const std::string& value, DfcWeights& weights, std::string& input);
  bool expanded(const std::string& value, GhostBottleneckWeights& weights, std::string& input);
  bool shortcut(const std::string& value, const std::string& input,
                GhostBottleneckWeights& weights);
  bool linear(const std::string& value, Linear& out, std::string& input);
  bool global_pool(const std::string& value, Pool& pool, std::string& input);
  bool perceptron(const std::string& value, Linear& hidden, Linear& output, Pool& pool,
                  std::string& input);
  bool channel_attention(const std::string& value, CbamWeights& weights, int& height, int& width,
                         std::string& input);
  bool spatial_attention(const std::string& value, CbamWeights& weights, std::string& input);
  bool reduced(const std::string& value, const char* op, std::string& input);

  const GraphIndex& graph_;
  std::vector<int> used_;
};

}  // namespace dynslam::attention::onnx
