#pragma once

#include <cstddef>
#include <string>

namespace dynslam::segmentation {

/// SHA-256 (FIPS 180-4) as 64 lower-case hexadecimal digits.
std::string sha256(const void* data, std::size_t size);

}  // namespace dynslam::segmentation
