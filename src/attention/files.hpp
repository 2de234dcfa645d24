// Whole files.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "dynslam/core/span.hpp"

namespace dynslam::attention::detail {

/// Throws IoError naming the file if it cannot be read.
std::vector<std::uint8_t> read_file(const std::string& path);

}  // namespace dynslam::attention::detail
