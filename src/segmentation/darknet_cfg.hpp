// What a Darknet cfg file says of its network.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

namespace dynslam::segmentation {

struct DarknetCfg {
  int width = 0;    ///< of the input, pixels
  int height = 0;   ///< of the input, pixels
  int classes = 0;  ///< of the last head
  /// Numbers that the weights file must hold behind its header; nothing if the network has a layer
  /// that is not known here.
  std::optional<std::uint64_t> weights;
};

/// Throws IoError naming `path` if the text has no [net] section with width and height, or no
/// [yolo] or [region] section with classes.
DarknetCfg read_darknet_cfg(const std::string& path, const std::string& text);

/// Throws IoError naming `path` if the bytes of a weights file are fewer than `cfg` needs: OpenCV
/// would fill the rest with whatever there is.
void require_whole_weights(const std::string& path, const std::string& bytes,
                           const DarknetCfg& cfg);

}  // namespace dynslam::segmentation
