#include "segmentation/onnx_file.hpp"

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <set>
#include <string_view>
#include <utility>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"
#include "dynslam/core/protobuf.hpp"

#include "segmentation/sha256.hpp"

namespace dynslam::segmentation {
namespace {

using protobuf::bytes_of;
using protobuf::Field;
using protobuf::FieldReader;

// ValueInfoProto: name = 1, type = 2 > tensor_type = 1 > shape = 2 > dim = 1 > dim_value = 1.
TensorInfo tensor_info(std::string_view value_info) {
  TensorInfo info;
  info.name = std::string(bytes_of(value_info, 1));
  const std::string_view tensor = bytes_of(bytes_of(value_info, 2), 1);
  FieldReader dims(bytes_of(tensor, 2));
  Field dim;
  while (dims.next(dim)) {
    if (dim.number != 1 || !dim.is_bytes()) continue;
    std::int64_t size = -1;
    FieldReader reader(dim.bytes);
    Field field;
    while (reader.next(field)) {
      if (field.number == 1 && !field.is_bytes()) size = static_cast<std::int64_t>(field.value);
    }
    info.shape.push_back(size > 0 ? size : -1);
  }
  return info;
}

// GraphProto: node = 1, initializer = 5 (its name = 8), input = 11, output = 12.
bool read_graph(std::string_view graph, OnnxFile& file) {
  std::set<std::string, std::less<>> weights;
  FieldReader reader(graph);
  Field field;
  while (reader.next(field)) {
    if (!field.is_bytes()) continue;
    if (field.number == 5) weights.emplace(bytes_of(field.bytes, 8));
    if (field.number == 11) file.inputs.push_back(tensor_info(field.bytes));
    if (field.number == 12) file.outputs.push_back(tensor_info(field.bytes));
  }
  const auto is_weight = [&](const TensorInfo& t) { return weights.count(t.name) > 0; };
  file.inputs.erase(std::remove_if(file.inputs.begin(), file.inputs.end(), is_weight),
                    file.inputs.end());
  return !reader.broken();
}

}  // namespace

std::string read_file_bytes(const std::string& path) {
  std::string bytes = read_file(path);
  if (bytes.empty()) throw_io_error(path, "is empty");
  return bytes;
}

OnnxFile read_onnx_file(const std::string& path) {
  return parse_onnx_file(read_file_bytes(path), path);
}

OnnxFile parse_onnx_file(std::string bytes, const std::string& path) {
  OnnxFile file;
  file.path = path;
  file.bytes = std::move(bytes);
  // ModelProto: ir_version = 1, graph = 7, metadata_props = 14 (key = 1, value = 2).
  FieldReader reader(file.bytes);
  bool has_version = false;
  bool has_graph = false;
  bool sound = true;
  Field field;
  while (reader.next(field)) {
    has_version |= field.number == 1 && !field.is_bytes();
    if (field.number == 7 && field.is_bytes()) {
      has_graph = true;
      sound &= read_graph(field.bytes, file);
    }
    if (field.number == 14 && field.is_bytes()) {
      file.metadata[std::string(bytes_of(field.bytes, 1))] = std::string(bytes_of(field.bytes, 2));
    }
  }
  if (reader.broken() || !sound || !has_version || !has_graph) {
    throw_io_error(path, has_version ? "is cut short or damaged: expected an ONNX model"
                                     : "is not a network: expected an ONNX model");
  }
  if (file.inputs.empty() || file.outputs.empty()) {
    throw_io_error(path, "is not a network: its graph has " + std::to_string(file.inputs.size()) +
                             " inputs and " + std::to_string(file.outputs.size()) +
                             " outputs, expected at least one of each");
  }
  file.sha256 = sha256(file.bytes.data(), file.bytes.size());
  return file;
}

std::vector<std::string> class_names_of(const OnnxFile& file) {
  const auto entry = file.metadata.find("names");
  if (entry == file.metadata.end()) return {};
  // {0: 'person', 1: "a 'b'"}: a number, a colon, a quoted text; a backslash takes the next
  // character as it is.
  const std::string& text = entry->second;
  std::vector<std::string> names;
  std::size_t at = 0;
  while (true) {
    while (at < text.size() && std::isdigit(static_cast<unsigned char>(text[at])) == 0) ++at;
    if (at == text.size()) return names;
    std::size_t number = 0;
    while (at < text.size() && std::isdigit(static_cast<unsigned char>(text[at])) != 0) {
      number =
          std::min<std::size_t>(number * 10 + static_cast<std::size_t>(text[at++] - '0'), 1000000);
    }
    while (at < text.size() && (text[at] == ':' || text[at] == ' ')) ++at;
    if (number != names.size() || at == text.size() || (text[at] != '\'' && text[at] != '"')) {
      return {};
    }
    const char quote = text[at++];
    std::string name;
    while (at < text.size() && text[at] != quote) {
      if (text[at] == '\\' && at + 1 < text.size()) ++at;
      name += text[at++];
    }
    if (at == text.size()) return {};
    ++at;
    names.push_back(name);
  }
}

std::string shape_text(const std::vector<std::int64_t>& shape) {
  std::string text;
  for (const std::int64_t size : shape) {
    text += (text.empty() ? "" : "x") + (size < 0 ? std::string("?") : std::to_string(size));
  }
  return text.empty() ? "a single number" : text;
}

std::string tensors_text(const std::vector<TensorInfo>& tensors) {
  std::string text;
  for (const TensorInfo& tensor : tensors) {
    text += (text.empty() ? "" : ", ") + tensor.name + " " + shape_text(tensor.shape);
  }
  return text.empty() ? "nothing" : text;
}

}  // namespace dynslam::segmentation
