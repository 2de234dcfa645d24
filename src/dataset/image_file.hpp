// Image files, checked for wholeness before they are decoded. Internal.
#pragma once

#include <filesystem>
#include <string_view>

#include <opencv2/core/mat.hpp>

namespace dynslam::dataset::detail {

/// Why the bytes of a PNG or JPEG file are not whole, or nullptr. A PNG is walked chunk by chunk
/// with its checksums, a JPEG marker by marker to its end. Decoders fill in what is missing (grey,
/// or the row above) and say so on stderr at best; a frame half invented must not reach a tracker.
/// Bytes of another format pass.
const char* find_damage(std::string_view bytes);

/// 8-bit image with one channel, or three (BGR); a fourth is dropped. Throws IoError.
cv::Mat read_color(const std::filesystem::path& path);

/// 16-bit grey image divided by `scale`: CV_32FC1 in metres. Throws IoError.
cv::Mat read_depth(const std::filesystem::path& path, double scale);

/// 8-bit image of one channel, as it is. Throws IoError.
cv::Mat read_mask(const std::filesystem::path& path);

}  // namespace dynslam::dataset::detail
