// Any bytes through the readers of weights and of networks to fuse: the first says which, the rest
// is the file.
#pragma once

#include <cstdint>
#include <string_view>

#include "dynslam/attention/onnx_fuse.hpp"
#include "dynslam/attention/safetensors.hpp"
#include "dynslam/core/errors.hpp"

namespace dynslam::attention::testing {

/// Throws IoError for what the readers refuse; every value that they let pass is read.
inline void parse_any(std::string_view bytes) {
  if (bytes.empty()) return;
  const Span<const std::uint8_t> file(reinterpret_cast<const std::uint8_t*>(bytes.data()) + 1,
                                      bytes.size() - 1);
  if (bytes.front() == 'o') {
    fuse_onnx(file, "fuzz");
    return;
  }
  const SafeTensors weights = SafeTensors::parse(file, "fuzz");
  volatile float sink = 0.0F;
  for (const auto& [name, tensor] : weights.tensors()) {
    for (const float value : tensor.values) sink = value;
  }
  static_cast<void>(sink);
  try {
    load_ghost_c3(weights, "");
  } catch (const IoError&) {  // sound, but no such layer
  }
}

}  // namespace dynslam::attention::testing
