// Weights from a safetensors file.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "dynslam/attention/weights.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam::attention {

/// A tensor of a file; the values belong to the SafeTensors it came from.
struct NamedTensor {
  std::vector<std::int64_t> shape;
  Span<const float> values;
};

/// The float tensors of a safetensors file: 8 bytes header length (little endian), a JSON header,
/// the values. Nothing is taken on trust: the header's length, the JSON, every shape (products
/// that overflow included), every pair of offsets, gaps and overlaps are checked before use.
class SafeTensors {
 public:
  /// Reads a file. Throws IoError naming the file and the tensor if it cannot be read, is cut
  /// short, has offsets that overlap, leave a gap or lie outside, a dtype other than F32, F16 or
  /// BF16 (the last two are widened), or a name twice. Memory: about three times the file.
  static SafeTensors read(const std::string& path);

  /// The same from memory; `name` stands for the path in errors. Copies what it needs.
  static SafeTensors parse(Span<const std::uint8_t> bytes, const std::string& name);

  /// Whether there is such a tensor.
  bool contains(std::string_view name) const;

  /// Throws IoError if there is none of this name.
  const NamedTensor& at(std::string_view name) const;

  const std::map<std::string, NamedTensor, std::less<>>& tensors() const { return tensors_; }
  const std::map<std::string, std::string>& metadata() const { return metadata_; }
  /// The file's name, for messages.
  const std::string& name() const { return name_; }

 private:
  std::string name_;
  std::vector<float> storage_;
  std::map<std::string, NamedTensor, std::less<>> tensors_;
  std::map<std::string, std::string> metadata_;
};

// Layers by the names that the modules of tests/attention/layers.py give their weights, below
// `prefix` ("" or ending in a dot): a convolution is `<name>.conv.weight` with optional
// `<name>.conv.bias`, and its normalization `<name>.bn.{weight,bias,running_mean,running_var}`
// with `epsilon`, folded in. All throw IoError naming file and tensor if one is missing or has a
// shape that the layer cannot have.

Convolution load_convolution(const SafeTensors& file, const std::string& prefix,
                             float epsilon = 1e-5F);
DfcWeights load_dfc(const SafeTensors& file, const std::string& prefix, float epsilon = 1e-5F);
/// `out_channels` 0: all that the weights give.
GhostModuleWeights load_ghost_module(const SafeTensors& file, const std::string& prefix,
                                     Activation activation, int out_channels = 0,
                                     float epsilon = 1e-5F);
/// `activation` is that of the first Ghost module; the second has none.
GhostBottleneckWeights load_ghost_bottleneck(const SafeTensors& file, const std::string& prefix,
                                             Activation activation = Activation::kRelu,
                                             bool shortcut = true, float epsilon = 1e-5F);
GhostC3Weights load_ghost_c3(const SafeTensors& file, const std::string& prefix,
                             Activation ghost_activation = Activation::kRelu, bool shortcut = true,
                             float epsilon = 1e-5F);
CbamWeights load_cbam(const SafeTensors& file, const std::string& prefix, float epsilon = 1e-5F);
FpnLevelWeights load_fpn_level(const SafeTensors& file, const std::string& prefix);

}  // namespace dynslam::attention
