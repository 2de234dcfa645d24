// libFuzzer target: a trajectory is read or refused by IoError.
#include <cstddef>
#include <cstdint>

#include "fuzz/trajectory.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    dynslam::evaluation::testing::parse_any_trajectory({reinterpret_cast<const char*>(data), size});
  } catch (const dynslam::IoError&) {
  }
  return 0;
}
