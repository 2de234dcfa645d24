// As much of an ONNX file as fusing needs, read and written without a runtime. What is not
// understood is kept byte for byte.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "dynslam/core/span.hpp"

namespace dynslam::attention::onnx {

/// A constant: float or integer values, whichever the file holds.
struct Tensor {
  std::vector<std::int64_t> shape;
  std::vector<float> floats;
  std::vector<std::int64_t> ints;
};

struct Attribute {
  std::int64_t integer = 0;
  float number = 0.0F;
  std::string text;
  std::vector<std::int64_t> integers;
  std::string_view tensor;  ///< encoded TensorProto
};

struct Node {
  std::string name;
  std::string op;
  std::string domain;
  std::vector<std::string> inputs;
  std::vector<std::string> outputs;
  std::map<std::string, Attribute> attributes;
  bool has_subgraph = false;
  std::string encoded;  ///< the whole NodeProto
};

/// nullptr if the node has no such attribute.
const Attribute* attribute_of(const Node& node, const char* name);

/// A model. Views refer to `bytes`, so models are not copied.
struct Model {
  Model() = default;
  Model(const Model&) = delete;
  Model& operator=(const Model&) = delete;

  std::string bytes;
  std::vector<Node> nodes;                            ///< in the order of the file
  std::map<std::string, std::string_view> constants;  ///< initializers and Constant nodes
  std::vector<std::string> outputs;                   ///< names of the graph's outputs
};

/// Throws IoError if the bytes are no ONNX model.
void read_model(Span<const std::uint8_t> bytes, const std::string& name, Model& model);

/// A constant of type float, int32 or int64; empty if its type or size is another. A tensor whose
/// data does not fit its shape is none.
bool read_tensor(std::string_view encoded, Tensor& tensor);

/// A node `op` of the domain "dynslam" with one attribute `layout`, encoded.
std::string encode_node(const std::string& name, const std::string& op,
                        const std::vector<std::string>& inputs, const std::string& output,
                        const std::vector<std::int64_t>& layout);

/// A float vector as an initializer, encoded.
std::string encode_initializer(const std::string& name, const std::vector<float>& values);

/// The model with other nodes and with more initializers, less those that no node uses any more,
/// and with the domain "dynslam" among its imports.
std::string encode_model(const Model& model, const std::vector<std::string>& nodes,
                         const std::vector<std::string>& initializers,
                         const std::vector<std::string>& unused_initializers);

}  // namespace dynslam::attention::onnx
