// Graphs that PyTorch exports while the tests run.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace dynslam::attention::testing {

inline bool torch_is_here() { return std::string(DYNSLAM_TORCH_PYTHON) != ""; }

/// Exports <name>.onnx and <name>.safetensors into the scratch directory; empty if that failed.
inline std::string exported(const std::string& name, const std::string& more = "") {
  const std::string folder = "exported";
  const std::string stem = folder + "/" + name;
  const auto newer_than = [&](const char* script) {
    return std::filesystem::last_write_time(stem + ".safetensors") >
           std::filesystem::last_write_time(std::string(DYNSLAM_TEST_SOURCE_DIR) + script);
  };
  if (std::filesystem::exists(stem + ".safetensors") && newer_than("/layers.py") &&
      newer_than("/export_onnx.py")) {
    return stem;
  }
  const std::string command = std::string(DYNSLAM_TORCH_PYTHON) + " " + DYNSLAM_TEST_SOURCE_DIR +
                              "/export_onnx.py " + folder + " --only " + name + " " + more;
  // The sanitizers' library would be loaded into the interpreter too.
  if (std::system(("LD_PRELOAD= " + command + " > export.log 2>&1").c_str()) != 0) return {};
  return stem;
}

inline std::vector<std::uint8_t> bytes_of_file(const std::string& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

}  // namespace dynslam::attention::testing
