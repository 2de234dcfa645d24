// Whole files.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "dynslam/core/span.hpp"

namespace dynslam::attention::detail {

/// Throws IoError naming the file if it cannot be read.
std::vector<std::uint8_t> read_file(const std::string& path);

/// Writes beside the file and renames, so that it is there whole or not at all. Throws IoError.
void write_file(const std::string& path, const std::string& bytes);

}  // namespace dynslam::attention::detail
