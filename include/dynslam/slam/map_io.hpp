// Maps in files.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/slam/map.hpp"

namespace dynslam::slam {

/// A map with what is needed to go on with it.
struct StoredMap {
  DepthCamera camera;                ///< its keyframes' camera; bf: of their right columns
  std::vector<float> scale_factors;  ///< side of level 0 over that of each pyramid level
  Map map;
};

/// Writes a map to a file that appears complete or not at all: keyframes with their features and
/// poses, points, and who sees whom. Points that nobody sees are left out.
///
/// Throws InvalidArgument if the camera is invalid or a keyframe has a feature beyond the scale
/// factors; IoError if the file cannot be written, a full disk included, an older one then being as
/// it was. O(bytes), about 68 for a feature and 130 for a point. Whoever changes the map must wait.
void save_map(const std::string& path, const Map& map, const DepthCamera& camera,
              Span<const float> scale_factors);

/// Reads what `save_map` wrote; ids are given anew, all else is the same bit for bit.
///
/// The content is not trusted: sizes, checksums and every value are checked before they are used.
/// Throws IoError naming the file and the place: "a.map: no sound map: keyframe 3: feature 17:
/// octave is 9, expected 0 .. 7". O(bytes).
StoredMap load_map(const std::string& path);

/// The same in memory; `name` stands for the path in messages.
std::string serialize_map(const Map& map, const DepthCamera& camera,
                          Span<const float> scale_factors);
StoredMap parse_map(Span<const std::uint8_t> bytes, const std::string& name = "map");

}  // namespace dynslam::slam
