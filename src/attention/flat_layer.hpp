// A layer as two arrays, which is how it stands in an ONNX node: `layout` holds the sizes and
// switches, `values` the weights, in the order in which the structs of weights.hpp name them.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "dynslam/attention/cbam.hpp"
#include "dynslam/attention/executor.hpp"
#include "dynslam/attention/tensor_batch.hpp"
#include "dynslam/attention/weights.hpp"
#include "dynslam/attention/workspace.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam::attention::detail {

struct FlatLayer {
  std::vector<std::int64_t> layout;
  std::vector<float> values;
};

FlatLayer flatten(const DfcWeights& weights);
FlatLayer flatten(const GhostModuleWeights& weights);
FlatLayer flatten(const GhostBottleneckWeights& weights);
FlatLayer flatten(const GhostC3Weights& weights);
/// `height` and `width`: the only size of map that the layer was made for, or 0 for any.
FlatLayer flatten(const CbamWeights& weights, CbamOrder order, int height, int width);

/// Names of the operators of the domain "dynslam".
const std::vector<std::string>& operator_names();

/// A layer read back, whichever it is.
class AnyLayer {
 public:
  virtual ~AnyLayer() = default;
  /// Tensors it takes: 2 for Dfc (input and features), else 1.
  virtual int inputs() const { return 1; }
  virtual int in_channels() const = 0;
  virtual int out_channels() const = 0;
  virtual int stride() const { return 1; }
  virtual std::size_t workspace_size(int height, int width, int tasks) const = 0;
  virtual void run(const TensorBatch<const float>* inputs, TensorBatch<float> output,
                   Workspace& workspace, Executor executor) const = 0;
};

/// Throws InvalidArgument if there is no such operator or the arrays do not hold one.
std::unique_ptr<AnyLayer> make_layer(const std::string& op, Span<const std::int64_t> layout,
                                     Span<const float> values);

}  // namespace dynslam::attention::detail
