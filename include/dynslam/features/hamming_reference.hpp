// Hamming distance in plain C++: the oracle of the vectorized kernels, and of use in constant
// expressions or where linking the room is not wanted.
#pragma once

#include <cstddef>
#include <cstdint>

namespace dynslam::features {

/// Number of bits in which two strings of `bytes` bytes differ, byte by byte. O(bytes).
constexpr int hamming_distance_reference(const std::uint8_t* a, const std::uint8_t* b,
                                         std::size_t bytes) {
  int distance = 0;
  for (std::size_t i = 0; i < bytes; ++i) {
    // Each step clears the lowest set bit.
    for (unsigned rest = static_cast<unsigned>(a[i] ^ b[i]); rest != 0; rest &= rest - 1) {
      ++distance;
    }
  }
  return distance;
}

}  // namespace dynslam::features
