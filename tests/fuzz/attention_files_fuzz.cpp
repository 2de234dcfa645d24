// libFuzzer over the two formats that attention reads: safetensors, and ONNX files to fuse. The
// first byte says which. Anything but IoError is a bug, and so is reading outside of the bytes.
#include <cstddef>
#include <cstdint>

#include "dynslam/attention/onnx_fuse.hpp"
#include "dynslam/attention/safetensors.hpp"
#include "dynslam/core/errors.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const dynslam::Span<const std::uint8_t> bytes(data + 1, size - 1);
  try {
    if (data[0] == 'o') {
      dynslam::attention::fuse_onnx(bytes, "fuzz");
    } else {
      const auto file = dynslam::attention::SafeTensors::parse(bytes, "fuzz");
      float sum = 0.0F;
      for (const auto& [name, tensor] : file.tensors()) {
        for (const float v : tensor.values) sum += v;
      }
      dynslam::attention::load_ghost_c3(file, "");
      (void)sum;
    }
  } catch (const dynslam::IoError&) {
  }
  return 0;
}
