// Pictures of the shared data for the benchmarks.
#pragma once

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <system_error>
#include <vector>

namespace dynslam::features::benchmark_data {

/// Paths of what is in a folder of the data, in the order of the names; none without the data.
inline std::vector<std::string> names_in(const std::string& folder) {
  const char* chosen = std::getenv("DYNSLAM_DATA");
  const std::filesystem::path base = chosen != nullptr ? chosen : DYNSLAM_DEFAULT_DATA_DIR;
  std::error_code error;
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(base / folder, error)) {
    names.push_back(entry.path().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

}  // namespace dynslam::features::benchmark_data
