// EXPECT: conversion from .* to non-scalar type|no viable conversion
// A view of pixels that may only be read does not become one for writing.
#include <cstdint>

#include "dynslam/core/image_view.hpp"

void use(dynslam::ImageView<const std::uint8_t> mask) {
  dynslam::ImageView<std::uint8_t> writable = mask;
  writable(0, 0) = 255;
}
