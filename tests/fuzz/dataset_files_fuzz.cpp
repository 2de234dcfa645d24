// libFuzzer target: files of sequence folders are read or refused by IoError.
#include <cstddef>
#include <cstdint>

#include "fuzz/dataset_files.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    dynslam::dataset::testing::parse_dataset_file({reinterpret_cast<const char*>(data), size});
  } catch (const dynslam::IoError&) {
  }
  return 0;
}
