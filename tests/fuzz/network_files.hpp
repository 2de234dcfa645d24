// Any bytes through the readers of networks: the first says which, the rest is the file.
#pragma once

#include <cstdlib>
#include <string>
#include <string_view>

#include "dynslam/core/errors.hpp"

#include "segmentation/darknet_cfg.hpp"
#include "segmentation/onnx_file.hpp"

namespace dynslam::segmentation::testing {

/// Throws IoError for what the readers refuse; aborts if they let something unsound pass.
inline void parse_any(std::string_view bytes) {
  if (bytes.empty()) return;
  const std::string rest(bytes.substr(1));
  if (bytes.front() == 'o') {
    const OnnxFile file = parse_onnx_file(rest, "fuzz");
    if (file.inputs.empty() || file.outputs.empty()) std::abort();
    class_names_of(file);
    tensors_text(file.inputs);
  } else {
    const DarknetCfg cfg = read_darknet_cfg("fuzz", rest);
    if (cfg.width <= 0 || cfg.height <= 0 || cfg.classes <= 0) std::abort();
  }
}

}  // namespace dynslam::segmentation::testing
