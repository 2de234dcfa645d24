// libFuzzer target: files of networks are read or refused by IoError.
#include <cstddef>
#include <cstdint>

#include "fuzz/network_files.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    dynslam::segmentation::testing::parse_network_file({reinterpret_cast<const char*>(data), size});
  } catch (const dynslam::IoError&) {
  }
  return 0;
}
