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

#include "dynslam/core/files.hpp"

#include "temp_folder.hpp"

namespace dynslam::attention::testing {

inline bool torch_is_here() { return std::string(DYNSLAM_TORCH_PYTHON) != ""; }

/// Exports <name>.onnx and <name>.safetensors, once in a process; their path without the ending, or
/// empty if that failed.
inline std::string exported(const std::string& name, const std::string& more = "") {
  static const dynslam::testing::TempFolder folder;
  const std::string stem = folder.file(name), log = folder.file("log");
  if (std::filesystem::exists(stem + ".safetensors")) return stem;
  const std::string command = std::string(DYNSLAM_TORCH_PYTHON) + " " + DYNSLAM_TEST_SOURCE_DIR +
                              "/export_onnx.py " + folder.path().string() + " --only " + name +
                              " " + more;
  // The sanitizers' library would be loaded into the interpreter too.
  if (std::system(("LD_PRELOAD= " + command + " > " + log + " 2>&1").c_str()) != 0) {
    ADD_FAILURE() << read_file(log);
    return {};
  }
  return stem;
}

inline std::vector<std::uint8_t> bytes_of_file(const std::string& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

}  // namespace dynslam::attention::testing
