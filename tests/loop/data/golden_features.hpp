// The descriptors that the golden files were made of: the same numbers wherever they are made.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

namespace golden {

inline constexpr std::size_t kDescriptorBytes = 32;
inline constexpr std::size_t kTrainingImages = 12;
inline constexpr std::size_t kFeatures = 60;  // an image

inline std::uint64_t mix(std::uint64_t v) {
  v += 0x9E3779B97F4A7C15U;
  v = (v ^ (v >> 30)) * 0xBF58476D1CE4E5B9U;
  v = (v ^ (v >> 27)) * 0x94D049BB133111EBU;
  return v ^ (v >> 31);
}

/// Image `i`, one descriptor of 32 bytes after the other: one of 300 patterns each, an eighth of
/// its bits redrawn. Images 0 .. kTrainingImages - 1 train, those behind are asked about.
inline std::vector<std::uint8_t> image(std::size_t i) {
  std::vector<std::uint8_t> bytes(kFeatures * kDescriptorBytes);
  for (std::size_t f = 0; f < kFeatures; ++f) {
    const std::uint64_t pattern = (i * 17 + f * 3) % 300;
    for (std::uint64_t w = 0; w < 4; ++w) {
      const std::uint64_t draw = (i * kFeatures + f) * 4 + w;
      const std::uint64_t noise = mix(draw) & mix(draw + 1000000) & mix(draw + 2000000);
      const std::uint64_t word = mix(9000000 + pattern * 4 + w) ^ noise;
      std::memcpy(bytes.data() + f * kDescriptorBytes + 8 * w, &word, 8);
    }
  }
  return bytes;
}

}  // namespace golden
