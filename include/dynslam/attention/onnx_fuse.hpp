// Replaces chains of primitive operators in an ONNX file by the one layer that they are.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "dynslam/core/span.hpp"

namespace dynslam::attention {

/// What `fuse_onnx` found.
struct OnnxFusion {
  std::string bytes;  ///< the new file
  int ghost_c3 = 0;
  int ghost_bottleneck = 0;
  int ghost_module = 0;
  int dfc = 0;
  int cbam = 0;
  int nodes_before = 0;
  int nodes_after = 0;

  int total() const { return ghost_c3 + ghost_bottleneck + ghost_module + dfc + cbam; }
};

/// Finds GhostV2C3 blocks, GhostNetV2 bottlenecks, Ghost modules, DFC attention and CBAM (both
/// orders) in the graph of an ONNX model and replaces each, the largest first, by one node of the
/// domain `dynslam` that `register_opencv_layers` and `register_onnxruntime_operators` run.
///
/// A chain is replaced only if it is the whole layer: weights constant and of the right shapes, no
/// value inside it used elsewhere, no output of the graph inside it. Everything else is kept byte
/// for byte. Batch normalization behind a convolution is folded. A model without such chains
/// comes back as it was. `name` stands for the path in errors. Throws IoError if the bytes are no
/// ONNX model. O(size of the file); allocates about three times the file.
OnnxFusion fuse_onnx(Span<const std::uint8_t> bytes, const std::string& name);

/// Reads `input`, writes `output`. Throws IoError if either fails; `output` is written whole or
/// not at all.
OnnxFusion fuse_onnx_file(const std::string& input, const std::string& output);

}  // namespace dynslam::attention
