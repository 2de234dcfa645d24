#include "attention/onnx_graph.hpp"

#include <algorithm>
#include <cstring>
#include <set>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/protobuf.hpp"

namespace dynslam::attention::onnx {
namespace {

using protobuf::bytes_of;
using protobuf::Field;
using protobuf::FieldReader;
using protobuf::put_bytes;
using protobuf::put_number;

// Field numbers of the ONNX schema (onnx.proto3).
namespace model_field {
constexpr std::uint32_t kIrVersion = 1, kGraph = 7, kOpsetImport = 8;
}
namespace graph_field {
constexpr std::uint32_t kNode = 1, kInitializer = 5, kInput = 11, kOutput = 12;
}
namespace node_field {
constexpr std::uint32_t kInput = 1, kOutput = 2, kName = 3, kOp = 4, kAttribute = 5, kDomain = 7;
}
namespace attribute_field {
constexpr std::uint32_t kName = 1, kFloat = 2, kInt = 3, kText = 4, kTensor = 5, kGraph = 6,
                        kInts = 8, kGraphs = 11, kType = 20;
}
namespace tensor_field {
constexpr std::uint32_t kDims = 1, kType = 2, kFloats = 4, kInts32 = 5, kInts64 = 7, kName = 8,
                        kRaw = 9, kLocation = 14;
}
constexpr std::uint64_t kFloatType = 1, kInt32Type = 6, kInt64Type = 7;
constexpr std::uint64_t kIntsAttribute = 7;

float to_float(std::uint64_t bits) {
  const auto narrow = static_cast<std::uint32_t>(bits);
  float value;
  std::memcpy(&value, &narrow, sizeof(value));
  return value;
}

/// A repeated number: packed into bytes, or one a field.
bool append_numbers(const Field& field, std::vector<std::int64_t>& numbers) {
  if (field.is_number()) {
    numbers.push_back(static_cast<std::int64_t>(field.value));
    return true;
  }
  if (!field.is_bytes()) return false;
  FieldReader reader(field.bytes);
  while (!reader.at_end()) numbers.push_back(static_cast<std::int64_t>(reader.varint()));
  return !reader.broken();
}

bool read_attribute(std::string_view encoded, Node& node) {
  Attribute attribute;
  std::string name;
  FieldReader reader(encoded);
  Field field;
  while (reader.next(field)) {
    switch (field.number) {
      case attribute_field::kName:
        name = std::string(field.bytes);
        break;
      case attribute_field::kFloat:
        attribute.number = to_float(field.value);
        break;
      case attribute_field::kInt:
        attribute.integer = static_cast<std::int64_t>(field.value);
        break;
      case attribute_field::kText:
        attribute.text = std::string(field.bytes);
        break;
      case attribute_field::kTensor:
        attribute.tensor = field.bytes;
        break;
      case attribute_field::kInts:
        if (!append_numbers(field, attribute.integers)) return false;
        break;
      case attribute_field::kGraph:
      case attribute_field::kGraphs:
        node.has_subgraph = true;
        break;
      default:
        break;
    }
  }
  node.attributes[name] = attribute;
  return !reader.broken();
}

bool read_node(std::string_view encoded, Node& node) {
  node.encoded = std::string(encoded);
  FieldReader reader(encoded);
  Field field;
  while (reader.next(field)) {
    switch (field.number) {
      case node_field::kInput:
        node.inputs.emplace_back(field.bytes);
        break;
      case node_field::kOutput:
        node.outputs.emplace_back(field.bytes);
        break;
      case node_field::kName:
        node.name = std::string(field.bytes);
        break;
      case node_field::kOp:
        node.op = std::string(field.bytes);
        break;
      case node_field::kDomain:
        node.domain = std::string(field.bytes);
        break;
      case node_field::kAttribute:
        if (!read_attribute(field.bytes, node)) return false;
        break;
      default:
        break;
    }
  }
  return !reader.broken();
}

bool read_graph(std::string_view graph, Model& model) {
  FieldReader reader(graph);
  Field field;
  while (reader.next(field)) {
    if (field.number == graph_field::kNode) {
      Node node;
      if (!read_node(field.bytes, node)) return false;
      model.nodes.push_back(std::move(node));
    } else if (field.number == graph_field::kInitializer) {
      model.constants[std::string(bytes_of(field.bytes, tensor_field::kName))] = field.bytes;
    } else if (field.number == graph_field::kOutput) {
      model.outputs.emplace_back(bytes_of(field.bytes, 1));
    }
  }
  return !reader.broken();
}

}  // namespace

const Attribute* attribute_of(const Node& node, const char* name) {
  const auto found = node.attributes.find(name);
  return found == node.attributes.end() ? nullptr : &found->second;
}

void read_model(Span<const std::uint8_t> bytes, const std::string& name, Model& model) {
  model.bytes.assign(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  FieldReader reader(model.bytes);
  Field field;
  int graphs = 0;
  bool has_version = false;
  bool sound = true;
  while (reader.next(field)) {
    has_version = has_version || (field.number == model_field::kIrVersion && field.is_number());
    if (field.number == model_field::kGraph && field.is_bytes()) {
      ++graphs;
      sound = sound && read_graph(field.bytes, model);
    }
  }
  if (reader.broken() || !sound || !has_version || graphs != 1) {
    throw_io_error(name, has_version ? "is cut short or damaged: expected an ONNX model"
                                     : "is not a network: expected an ONNX model");
  }
  // Constant nodes are read where they stand: their views go into `bytes`, as those of
  // initializers do, because attributes were read from there.
  for (const Node& node : model.nodes) {
    if (node.op != "Constant" || node.outputs.size() != 1) continue;
    const auto value = node.attributes.find("value");
    if (value != node.attributes.end()) model.constants[node.outputs[0]] = value->second.tensor;
  }
}

bool read_tensor(std::string_view encoded, Tensor& tensor) {
  tensor = Tensor();
  std::uint64_t type = 0;
  std::string_view raw;
  bool external = false;
  std::string_view packed_floats;
  FieldReader reader(encoded);
  Field field;
  while (reader.next(field)) {
    if (field.number == tensor_field::kDims) {
      if (!append_numbers(field, tensor.shape)) return false;
    } else if (field.number == tensor_field::kType) {
      type = field.value;
    } else if (field.number == tensor_field::kFloats) {
      if (field.wire == protobuf::kFixed32) {
        tensor.floats.push_back(to_float(field.value));
      } else {
        packed_floats = field.bytes;
      }
    } else if (field.number == tensor_field::kInts32 || field.number == tensor_field::kInts64) {
      if (!append_numbers(field, tensor.ints)) return false;
    } else if (field.number == tensor_field::kRaw) {
      raw = field.bytes;
    } else if (field.number == tensor_field::kLocation) {
      external = field.value != 0;
    }
  }
  if (reader.broken() || external) return false;
  std::uint64_t count = 1;
  for (const std::int64_t size : tensor.shape) {
    if (size < 0 || size > (std::int64_t{1} << 31)) return false;
    count *= static_cast<std::uint64_t>(size);
    if (count > encoded.size()) return false;
  }
  const auto values = static_cast<std::size_t>(count);
  if (type == kFloatType) {
    const std::string_view data = raw.empty() ? packed_floats : raw;
    if (!data.empty() && data.size() == values * sizeof(float)) {
      tensor.floats.resize(values);
      std::memcpy(tensor.floats.data(), data.data(), data.size());
    }
    return tensor.floats.size() == values;
  }
  if (type == kInt64Type && raw.size() == values * 8 && values > 0) {
    tensor.ints.resize(values);
    std::memcpy(tensor.ints.data(), raw.data(), raw.size());
  } else if (type == kInt32Type && raw.size() == values * 4 && values > 0) {
    std::vector<std::int32_t> narrow(values);
    std::memcpy(narrow.data(), raw.data(), raw.size());
    tensor.ints.assign(narrow.begin(), narrow.end());
  } else if (type != kInt64Type && type != kInt32Type) {
    return false;
  }
  return tensor.ints.size() == values;
}

std::string encode_node(const std::string& name, const std::string& op,
                        const std::vector<std::string>& inputs, const std::string& output,
                        const std::vector<std::int64_t>& layout) {
  std::string attribute;
  put_bytes(attribute, attribute_field::kName, "layout");
  for (const std::int64_t value : layout) {
    put_number(attribute, attribute_field::kInts, static_cast<std::uint64_t>(value));
  }
  put_number(attribute, attribute_field::kType, kIntsAttribute);
  std::string node;
  for (const std::string& input : inputs) put_bytes(node, node_field::kInput, input);
  put_bytes(node, node_field::kOutput, output);
  put_bytes(node, node_field::kName, name);
  put_bytes(node, node_field::kOp, op);
  put_bytes(node, node_field::kAttribute, attribute);
  put_bytes(node, node_field::kDomain, "dynslam");
  return node;
}

std::string encode_initializer(const std::string& name, const std::vector<float>& values) {
  std::string tensor;
  put_number(tensor, tensor_field::kDims, values.size());
  put_number(tensor, tensor_field::kType, kFloatType);
  put_bytes(tensor, tensor_field::kName, name);
  put_bytes(tensor, tensor_field::kRaw,
            {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float)});
  return tensor;
}

std::string encode_model(const Model& model, const std::vector<std::string>& nodes,
                         const std::vector<std::string>& initializers,
                         const std::vector<std::string>& unused_initializers) {
  const std::set<std::string, std::less<>> unused(unused_initializers.begin(),
                                                  unused_initializers.end());
  const auto encode_graph = [&](std::string_view graph) {
    std::string out;
    for (const std::string& node : nodes) put_bytes(out, graph_field::kNode, node);
    FieldReader reader(graph);
    Field field;
    while (reader.next(field)) {
      const bool weight = field.number == graph_field::kInitializer;
      if (field.number == graph_field::kNode) continue;
      if (weight && unused.count(bytes_of(field.bytes, tensor_field::kName)) > 0) continue;
      if (field.number == graph_field::kInput && unused.count(bytes_of(field.bytes, 1)) > 0) {
        continue;  // old files name their weights among the inputs
      }
      out.append(field.encoded);
    }
    for (const std::string& tensor : initializers) {
      put_bytes(out, graph_field::kInitializer, tensor);
    }
    return out;
  };
  std::string out;
  FieldReader reader(model.bytes);
  Field field;
  bool imported = false;
  while (reader.next(field)) {
    if (field.number == model_field::kGraph) {
      put_bytes(out, model_field::kGraph, encode_graph(field.bytes));
      continue;
    }
    imported = imported ||
               (field.number == model_field::kOpsetImport && bytes_of(field.bytes, 1) == "dynslam");
    out.append(field.encoded);
  }
  if (!imported) {
    std::string import;
    put_bytes(import, 1, "dynslam");
    put_number(import, 2, 1);
    put_bytes(out, model_field::kOpsetImport, import);
  }
  return out;
}

}  // namespace dynslam::attention::onnx
