// libFuzzer target: whatever the bytes, a parser reads them or refuses them by IoError. Which one
// is said by macros: the header FUZZ_PARSER has parse_any of the room FUZZ_ROOM.
#include <cstddef>
#include <cstdint>

#include "dynslam/core/errors.hpp"

#include FUZZ_PARSER

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    dynslam::FUZZ_ROOM::testing::parse_any({reinterpret_cast<const char*>(data), size});
  } catch (const dynslam::IoError&) {
  }
  return 0;
}
