// The camera of the tests of two views.
#pragma once

#include "dynslam/core/camera.hpp"

namespace dynslam::slam {

inline PinholeCamera camera() {
  PinholeCamera camera;
  camera.fx = camera.fy = 500.0;
  camera.cx = 319.5;
  camera.cy = 239.5;
  camera.width = 640;
  camera.height = 480;
  return camera;
}

}  // namespace dynslam::slam
