// Whole files in and out.
#pragma once

#include <string>
#include <string_view>

namespace dynslam::evaluation {

/// The bytes of a file. Throws IoError with the system's reason.
std::string read_file(const std::string& path);

/// Writes a file that appears complete or not at all: under another name in the same folder, then
/// renamed. A symbolic link stays one; a device or pipe is written directly. Throws IoError.
void write_file_atomically(const std::string& path, std::string_view bytes);

}  // namespace dynslam::evaluation
