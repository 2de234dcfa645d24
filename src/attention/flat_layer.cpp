#include "attention/flat_layer.hpp"

#include <algorithm>
#include <optional>
#include <utility>

#include "dynslam/attention/dfc.hpp"
#include "dynslam/attention/ghost.hpp"
#include "dynslam/core/errors.hpp"

namespace dynslam::attention::detail {
namespace {

constexpr const char* kOperator = "operator of dynslam";

/// Writes and reads have the same shape: `visit(archive, weights)` goes through all members.
class Writer {
 public:
  explicit Writer(FlatLayer& out) : out_(out) {}
  static constexpr bool kReads = false;

  void number(int& value) { out_.layout.push_back(value); }
  void array(std::vector<float>& values, std::size_t /*size*/) {
    out_.values.insert(out_.values.end(), values.begin(), values.end());
  }

 private:
  FlatLayer& out_;
};

class Reader {
 public:
  Reader(Span<const std::int64_t> layout, Span<const float> values)
      : layout_(layout), values_(values) {}
  static constexpr bool kReads = true;

  void number(int& value) {
    require(at_ < layout_.size(), kOperator, "layout.size()", layout_.size(), "more");
    const std::int64_t stored = layout_[at_++];
    require(stored >= 0 && stored <= (1 << 20), kOperator, "layout", stored, "0..1048576");
    value = static_cast<int>(stored);
  }
  void array(std::vector<float>& values, std::size_t size) {
    require(size <= values_.size() - used_, kOperator, "weights.size()", values_.size(), "more");
    const Span<const float> part = values_.subspan(used_, size);
    values.assign(part.begin(), part.end());
    used_ += size;
  }
  void finish() const {
    require(at_ == layout_.size(), kOperator, "layout.size()", layout_.size(), at_);
    require(used_ == values_.size(), kOperator, "weights.size()", values_.size(), used_);
  }

 private:
  Span<const std::int64_t> layout_;
  Span<const float> values_;
  std::size_t at_ = 0;
  std::size_t used_ = 0;
};

template <typename Archive>
void visit(Archive& archive, bool& flag) {
  int value = flag ? 1 : 0;
  archive.number(value);
  flag = value != 0;
}

template <typename Archive>
void visit(Archive& archive, Activation& activation) {
  int value = static_cast<int>(activation);
  archive.number(value);
  require(value <= static_cast<int>(Activation::kSilu), kOperator, "activation", value, "0..2");
  activation = static_cast<Activation>(value);
}

template <typename Archive>
void visit_array(Archive& archive, std::vector<float>& values, std::size_t size) {
  bool present = !values.empty();
  visit(archive, present);
  if (present) archive.array(values, size);
}

template <typename Archive>
void visit(Archive& archive, Convolution& c) {
  archive.number(c.out_channels);
  archive.number(c.group_channels);
  archive.number(c.kernel_height);
  archive.number(c.kernel_width);
  // 2^20 each at most, so that the product is checked before it overflows.
  const auto channels =
      static_cast<std::size_t>(c.out_channels) * static_cast<std::size_t>(c.group_channels);
  const std::size_t taps = static_cast<std::size_t>(std::min(c.kernel_height, 1024)) *
                           static_cast<std::size_t>(std::min(c.kernel_width, 1024));
  archive.array(c.weight, channels * taps);
  visit_array(archive, c.bias, static_cast<std::size_t>(c.out_channels));
}

template <typename Archive, typename Part>
void visit_optional(Archive& archive, std::optional<Part>& part) {
  bool present = part.has_value();
  visit(archive, present);
  if (!present) return;
  if (!part) part.emplace();
  visit(archive, *part);
}

template <typename Archive>
void visit(Archive& archive, DfcWeights& w) {
  visit(archive, w.pointwise);
  visit(archive, w.horizontal);
  visit(archive, w.vertical);
}

template <typename Archive>
void visit(Archive& archive, GhostModuleWeights& w) {
  visit(archive, w.primary);
  visit(archive, w.cheap);
  archive.number(w.out_channels);
  visit(archive, w.activation);
}

template <typename Archive>
void visit(Archive& archive, GhostBottleneckWeights& w) {
  visit(archive, w.expand);
  visit_optional(archive, w.attention);
  visit_optional(archive, w.downsample);
  visit(archive, w.project);
  visit_optional(archive, w.shortcut_depthwise);
  visit_optional(archive, w.shortcut_pointwise);
  visit(archive, w.shortcut);
  archive.number(w.stride);
}

template <typename Archive>
void visit(Archive& archive, GhostC3Weights& w) {
  visit(archive, w.cv1);
  visit(archive, w.cv2);
  visit(archive, w.cv3);
  int count = static_cast<int>(w.bottlenecks.size());
  archive.number(count);
  for (int i = 0; i < count; ++i) {
    if constexpr (Archive::kReads) w.bottlenecks.emplace_back();
    visit(archive, w.bottlenecks[static_cast<std::size_t>(i)]);
  }
  visit(archive, w.activation);
}

struct CbamNode {
  CbamWeights weights;
  int order = 0;
  int height = 0;
  int width = 0;
};

template <typename Archive>
void visit(Archive& archive, CbamNode& node) {
  CbamWeights& w = node.weights;
  archive.number(w.channels);
  archive.number(w.reduced);
  const auto channels = static_cast<std::size_t>(w.channels);
  const auto reduced = static_cast<std::size_t>(w.reduced);
  archive.array(w.hidden_weight, channels * reduced);
  visit_array(archive, w.hidden_bias, reduced);
  archive.array(w.output_weight, channels * reduced);
  visit_array(archive, w.output_bias, channels);
  visit(archive, w.spatial);
  archive.number(node.order);
  archive.number(node.height);
  archive.number(node.width);
}

template <typename Weights>
FlatLayer written(Weights weights) {
  FlatLayer flat;
  Writer writer(flat);
  visit(writer, weights);
  return flat;
}

template <typename Weights>
Weights read_back(Span<const std::int64_t> layout, Span<const float> values) {
  Weights weights;
  Reader reader(layout, values);
  visit(reader, weights);
  reader.finish();
  return weights;
}

template <typename Layer>
class OneInput : public AnyLayer {
 public:
  explicit OneInput(Layer layer) : layer_(std::move(layer)) {}
  int in_channels() const override { return layer_.in_channels(); }
  int out_channels() const override { return layer_.out_channels(); }
  std::size_t workspace_size(int height, int width, int tasks) const override {
    return layer_.workspace_size(height, width, tasks);
  }
  void run(const TensorBatch<const float>* inputs, TensorBatch<float> output, Workspace& workspace,
           Executor executor) const override {
    layer_.run(inputs[0], output, workspace, executor);
  }

 protected:
  Layer layer_;
};

class BottleneckLayer final : public OneInput<GhostBottleneck> {
 public:
  using OneInput::OneInput;
  int stride() const override { return layer_.stride(); }
};

class DfcLayer final : public AnyLayer {
 public:
  explicit DfcLayer(DfcAttention layer) : layer_(std::move(layer)) {}
  int inputs() const override { return 2; }
  int in_channels() const override { return layer_.in_channels(); }
  int out_channels() const override { return layer_.out_channels(); }
  std::size_t workspace_size(int height, int width, int tasks) const override {
    return layer_.workspace_size(height, width, tasks);
  }
  void run(const TensorBatch<const float>* inputs, TensorBatch<float> output, Workspace& workspace,
           Executor executor) const override {
    layer_.run(inputs[0], inputs[1], output, workspace, executor);
  }

 private:
  DfcAttention layer_;
};

class CbamLayer final : public AnyLayer {
 public:
  explicit CbamLayer(const CbamNode& node)
      : layer_(node.weights, static_cast<CbamOrder>(node.order)),
        height_(node.height),
        width_(node.width) {}
  int in_channels() const override { return layer_.channels(); }
  int out_channels() const override { return layer_.channels(); }
  std::size_t workspace_size(int height, int width, int tasks) const override {
    return layer_.workspace_size(height, width, tasks);
  }
  void run(const TensorBatch<const float>* inputs, TensorBatch<float> output, Workspace& workspace,
           Executor executor) const override {
    // The pooling of the graph had a window of this size, which is global for no other.
    const bool fits = height_ == 0 || (inputs[0].height == height_ && inputs[0].width == width_);
    require(fits, "Cbam", "input",
            std::to_string(inputs[0].height) + "x" + std::to_string(inputs[0].width),
            std::to_string(height_) + "x" + std::to_string(width_) + ", as in the fused graph");
    layer_.run(inputs[0], output, workspace, executor);
  }

 private:
  Cbam layer_;
  int height_;
  int width_;
};

}  // namespace

FlatLayer flatten(const DfcWeights& weights) { return written(weights); }
FlatLayer flatten(const GhostModuleWeights& weights) { return written(weights); }
FlatLayer flatten(const GhostBottleneckWeights& weights) { return written(weights); }
FlatLayer flatten(const GhostC3Weights& weights) { return written(weights); }
FlatLayer flatten(const CbamWeights& weights, CbamOrder order, int height, int width) {
  return written(CbamNode{weights, static_cast<int>(order), height, width});
}

const std::vector<std::string>& operator_names() {
  static const std::vector<std::string> names = {"GhostC3", "GhostBottleneck", "GhostModule", "Dfc",
                                                 "Cbam"};
  return names;
}

std::unique_ptr<AnyLayer> make_layer(const std::string& op, Span<const std::int64_t> layout,
                                     Span<const float> values) {
  if (op == "GhostC3") {
    return std::make_unique<OneInput<GhostC3>>(GhostC3(read_back<GhostC3Weights>(layout, values)));
  }
  if (op == "GhostBottleneck") {
    return std::make_unique<BottleneckLayer>(
        GhostBottleneck(read_back<GhostBottleneckWeights>(layout, values)));
  }
  if (op == "GhostModule") {
    return std::make_unique<OneInput<GhostModule>>(
        GhostModule(read_back<GhostModuleWeights>(layout, values)));
  }
  if (op == "Dfc") {
    return std::make_unique<DfcLayer>(DfcAttention(read_back<DfcWeights>(layout, values)));
  }
  if (op == "Cbam") {
    const auto node = read_back<CbamNode>(layout, values);
    require(node.order <= static_cast<int>(CbamOrder::kNone), kOperator, "order", node.order,
            "0..4");
    return std::make_unique<CbamLayer>(node);
  }
  throw_invalid_argument(kOperator, "name", op,
                         "GhostC3, GhostBottleneck, GhostModule, Dfc or Cbam");
}

}  // namespace dynslam::attention::detail
