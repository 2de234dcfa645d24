// Rules that the readers' options share. Internal.
#pragma once

#include <cmath>
#include <optional>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/errors.hpp"

namespace dynslam::dataset::detail {

/// A camera whose size may be left to the images (both sides 0).
inline void validate_camera(const std::optional<DepthCamera>& camera, const char* options) {
  if (!camera) return;
  require((camera->width == 0) == (camera->height == 0) && camera->width >= 0, options,
          "camera.width", camera->width, "width and height both positive, or both 0");
  DepthCamera sized = *camera;
  if (sized.width == 0) sized.width = sized.height = 1;
  sized.validate();
}

inline void require_seconds(double value, const char* options, const char* name) {
  require(std::isfinite(value) && value >= 0.0, options, name, value,
          "a number of seconds that is not negative");
}

}  // namespace dynslam::dataset::detail
