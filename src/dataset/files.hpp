// Whole files in and out, with errors that name the file. Internal.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace dynslam::dataset::detail {

namespace fs = std::filesystem;

/// Content of a regular file. Throws IoError.
std::string read_file(const fs::path& path);

/// Makes the folder and those above it. Throws IoError.
void make_folder(const fs::path& path);

/// Throws IoError unless `path` is a folder that can be opened.
void expect_folder(const fs::path& path);

/// Regular files with the extension of an image format, in natural order of their names. Throws
/// IoError if `folder` is none.
std::vector<fs::path> list_images(const fs::path& folder);

/// The last name of a path, also of "." and of one that ends in a slash.
std::string folder_name(const fs::path& folder);

}  // namespace dynslam::dataset::detail
