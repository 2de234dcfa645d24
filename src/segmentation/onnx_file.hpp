// What an ONNX file says of itself, read without any runtime: so that a file that is not a network
// is refused in our own words before a runtime writes to stderr about it.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "dynslam/segmentation/segmenter.hpp"

namespace dynslam::segmentation {

struct OnnxFile {
  std::string path;
  std::string bytes;  ///< the whole file
  std::string sha256;
  std::vector<TensorInfo> inputs;  ///< without the graph's own weights
  std::vector<TensorInfo> outputs;
  std::map<std::string, std::string> metadata;
};

/// Throws IoError naming the file if it cannot be read, is cut short or is not an ONNX model with
/// at least one input and one output.
OnnxFile read_onnx_file(const std::string& path);

/// The same for bytes in memory; `path` is for messages.
OnnxFile parse_onnx_file(std::string bytes, const std::string& path);

/// The whole file; throws IoError if it cannot be read or is empty.
std::string read_file_bytes(const std::string& path);

/// Class names in the metadata that Ultralytics' export writes ("{0: 'person', 1: 'bicycle'}");
/// empty if there are none or they are not numbered 0, 1, ... without a gap.
std::vector<std::string> class_names_of(const OnnxFile& file);

/// "1x3x?x640" for messages.
std::string shape_text(const std::vector<std::int64_t>& shape);

/// "images 1x3x480x640, mask 1x1" for messages.
std::string tensors_text(const std::vector<TensorInfo>& tensors);

}  // namespace dynslam::segmentation
