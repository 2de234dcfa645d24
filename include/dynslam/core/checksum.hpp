// A checksum of bytes in files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

namespace dynslam {

/// Multiplies and folds eight bytes at a time: against bit rot and cut files, not against forgery.
///
/// `start` chains pieces: checksum(b, n, checksum(a, m)). Another value on machines of the other
/// byte order. O(bytes); no allocation; thread-safe.
inline std::uint64_t checksum(const void* data, std::size_t bytes, std::uint64_t start = 0) {
  constexpr std::uint64_t kPrime = 0x9E3779B97F4A7C15ULL;
  const auto* at = static_cast<const std::uint8_t*>(data);
  std::uint64_t sum = (start ^ bytes) * kPrime + 1;
  while (bytes > 0) {
    std::uint64_t part = 0;
    const std::size_t n = bytes < 8 ? bytes : 8;
    std::memcpy(&part, at, n);
    sum = (sum ^ part) * kPrime;
    sum ^= sum >> 29;
    at += n;
    bytes -= n;
  }
  return sum ^ (sum >> 32);
}

}  // namespace dynslam
