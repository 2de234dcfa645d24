// Where the tests of this room find their files.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>

namespace dynslam::segmentation {

/// A small file that lies beside the tests.
inline std::string test_file(const std::string& name) {
  return std::string(DYNSLAM_TEST_DATA_DIR) + "/" + name;
}

/// A path in the shared data, or empty if it is not there.
inline std::string shared_data(const std::string& name) {
  const char* root = std::getenv("DYNSLAM_DATA");
  const std::filesystem::path path =
      std::filesystem::path(root != nullptr ? root : DYNSLAM_DEFAULT_DATA_DIR) / name;
  std::error_code error;
  return std::filesystem::exists(path, error) ? path.string() : std::string();
}

/// Runs `action`, which should throw an `Error`, and gives its message; empty if it does not.
template <typename Error, typename Action>
std::string message_of(Action&& action) {
  try {
    action();
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

}  // namespace dynslam::segmentation
