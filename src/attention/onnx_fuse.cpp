#include "dynslam/attention/onnx_fuse.hpp"

#include <algorithm>
#include <optional>
#include <set>
#include <utility>

#include "dynslam/core/files.hpp"

#include "attention/flat_layer.hpp"
#include "attention/onnx_graph.hpp"
#include "attention/onnx_match.hpp"

namespace dynslam::attention {
namespace {

using onnx::GraphIndex;
using onnx::Matcher;
using onnx::Model;
using onnx::Node;

/// A layer found.
struct Found {
  std::string op;
  detail::FlatLayer flat;
  std::vector<std::string> inputs;
  std::vector<int> used;
};

std::optional<Found> match(const GraphIndex& graph, const std::string& op,
                           const std::string& value) {
  Matcher matcher(graph);
  Found found;
  found.op = op;
  std::string input;
  std::string features;
  if (op == "GhostC3") {
    GhostC3Weights weights;
    if (!matcher.ghost_c3(value, weights, input)) return std::nullopt;
    found.flat = detail::flatten(weights);
  } else if (op == "GhostBottleneck") {
    GhostBottleneckWeights weights;
    if (!matcher.ghost_bottleneck(value, weights, input)) return std::nullopt;
    found.flat = detail::flatten(weights);
  } else if (op == "GhostModule") {
    GhostModuleWeights weights;
    if (!matcher.ghost_module(value, weights, input)) return std::nullopt;
    found.flat = detail::flatten(weights);
  } else if (op == "Dfc") {
    DfcWeights weights;
    if (!matcher.dfc(value, weights, input, features)) return std::nullopt;
    found.flat = detail::flatten(weights);
  } else {
    CbamWeights weights;
    CbamOrder order = CbamOrder::kNone;
    int height = 0;
    int width = 0;
    if (!matcher.cbam(value, weights, order, height, width, input)) return std::nullopt;
    found.flat = detail::flatten(weights, order, height, width);
  }
  found.inputs = {input};
  if (!features.empty()) found.inputs.push_back(features);
  found.used = matcher.used();
  return found;
}

/// Whether a node only works out shapes or constants.
bool is_shape_node(const Node& node) {
  static const std::set<std::string> ops = {
      "Constant", "ConstantOfShape", "Shape", "Slice", "Gather",    "Concat",  "Cast",
      "Squeeze",  "Unsqueeze",       "Add",   "Mul",   "Transpose", "Reshape", "Identity"};
  return ops.count(node.op) > 0;
}

class Fuser {
 public:
  Fuser(const Model& model, const GraphIndex& graph)
      : model_(model), graph_(graph), removed_(model.nodes.size(), false) {}

  OnnxFusion run() {
    result_.nodes_before = static_cast<int>(model_.nodes.size());
    const auto branches = [](const Node& node) { return node.has_subgraph; };
    // A graph inside a node may use any value from outside without saying so.
    if (std::none_of(model_.nodes.begin(), model_.nodes.end(), branches)) {
      for (const std::string& op : detail::operator_names()) replace_all(op);
    }
    if (result_.total() == 0) {
      result_.bytes = model_.bytes;
      result_.nodes_after = result_.nodes_before;
      return result_;
    }
    write();
    return result_;
  }

 private:
  int& count_of(const std::string& op) {
    if (op == "GhostC3") return result_.ghost_c3;
    if (op == "GhostBottleneck") return result_.ghost_bottleneck;
    if (op == "GhostModule") return result_.ghost_module;
    if (op == "Dfc") return result_.dfc;
    return result_.cbam;
  }

  void replace_all(const std::string& op) {
    // From the end, so that of layers that contain one another the outer is found.
    for (std::size_t i = model_.nodes.size(); i-- > 0;) {
      const Node& root = model_.nodes[i];
      if (removed_[i] || root.outputs.size() != 1) continue;
      std::optional<Found> found = match(graph_, op, root.outputs[0]);
      if (!found) continue;
      const std::set<int> used(found->used.begin(), found->used.end());
      const bool taken = std::any_of(used.begin(), used.end(),
                                     [&](int n) { return removed_[static_cast<std::size_t>(n)]; });
      if (taken) continue;
      const std::set<int> helpers = helpers_of(used, found->inputs);
      if (!is_closed(static_cast<int>(i), used, helpers)) continue;
      for (const int n : used) removed_[static_cast<std::size_t>(n)] = true;
      for (const int n : helpers) removed_[static_cast<std::size_t>(n)] = true;
      const std::string name = fresh_name(op, count_of(op)++);
      found->inputs.push_back(name + ".weights");
      replacements_[static_cast<int>(i)] =
          onnx::encode_node(name, op, found->inputs, root.outputs[0], found->flat.layout);
      initializers_.push_back(onnx::encode_initializer(name + ".weights", found->flat.values));
    }
  }

  std::string fresh_name(const std::string& op, int number) const {
    std::string name = "dynslam/" + op + "_" + std::to_string(number);
    while (graph_.is_name(name) || graph_.is_name(name + ".weights")) name += "_";
    return name;
  }

  /// Nodes that only serve the nodes of a layer: its constants and what works out its shapes.
  std::set<int> helpers_of(const std::set<int>& used,
                           const std::vector<std::string>& layer_inputs) const {
    const std::set<std::string> data(layer_inputs.begin(), layer_inputs.end());
    std::set<int> helpers;
    std::vector<int> open(used.begin(), used.end());
    while (!open.empty()) {
      const Node& node = graph_.node(open.back());
      open.pop_back();
      for (const std::string& input : node.inputs) {
        const int maker = graph_.producer(input);
        if (maker < 0 || data.count(input) > 0 || used.count(maker) > 0 ||
            helpers.count(maker) > 0 || !is_shape_node(graph_.node(maker))) {
          continue;
        }
        helpers.insert(maker);
        open.push_back(maker);
      }
    }
    // Those that serve others too stay.
    for (bool changed = true; changed;) {
      changed = false;
      for (auto it = helpers.begin(); it != helpers.end();) {
        const bool serves_others = leaves(*it, used, helpers);
        changed = changed || serves_others;
        it = serves_others ? helpers.erase(it) : std::next(it);
      }
    }
    return helpers;
  }

  /// Whether a value of the node is used outside of both sets or is an output of the graph.
  bool leaves(int index, const std::set<int>& used, const std::set<int>& helpers) const {
    for (const std::string& value : graph_.node(index).outputs) {
      if (graph_.is_output(value)) return true;
      for (const int consumer : graph_.consumers(value)) {
        if (used.count(consumer) == 0 && helpers.count(consumer) == 0) return true;
      }
    }
    return false;
  }

  bool is_closed(int root, const std::set<int>& used, const std::set<int>& helpers) const {
    return std::none_of(used.begin(), used.end(),
                        [&](int n) { return n != root && leaves(n, used, helpers); });
  }

  void write() {
    std::vector<std::string> nodes;
    std::set<std::string> still_used(model_.outputs.begin(), model_.outputs.end());
    for (std::size_t i = 0; i < model_.nodes.size(); ++i) {
      const auto replacement = replacements_.find(static_cast<int>(i));
      if (replacement != replacements_.end()) {
        nodes.push_back(replacement->second);
      } else if (!removed_[i]) {
        nodes.push_back(model_.nodes[i].encoded);
        still_used.insert(model_.nodes[i].inputs.begin(), model_.nodes[i].inputs.end());
      }
    }
    std::vector<std::string> unused;
    for (const auto& [name, tensor] : model_.constants) {
      // Only what the layers consumed: unused weights that were there before stay.
      const std::vector<int>& consumers = graph_.consumers(name);
      if (graph_.producer(name) < 0 && !consumers.empty() && still_used.count(name) == 0) {
        unused.push_back(name);
      }
    }
    result_.nodes_after = static_cast<int>(nodes.size());
    result_.bytes = onnx::encode_model(model_, nodes, initializers_, unused);
  }

  const Model& model_;
  const GraphIndex& graph_;
  std::vector<bool> removed_;
  std::map<int, std::string> replacements_;
  std::vector<std::string> initializers_;
  OnnxFusion result_;
};

}  // namespace

OnnxFusion fuse_onnx(Span<const std::uint8_t> bytes, const std::string& name) {
  Model model;
  onnx::read_model(bytes, name, model);
  const GraphIndex graph(model, name);
  return Fuser(model, graph).run();
}

OnnxFusion fuse_onnx_file(const std::string& input, const std::string& output) {
  const std::string bytes = read_file(input);
  OnnxFusion fusion = fuse_onnx(as_bytes(bytes), input);
  write_file_atomically(output, fusion.bytes);
  return fusion;
}

}  // namespace dynslam::attention
