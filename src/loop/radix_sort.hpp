// Stable sorting of (number, place) pairs: an image's features by word or by node.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace dynslam::loop::detail {

/// Numbers in the upper half, places in the lower. Sorts by the upper halves; equal ones keep their
/// order. `scratch` is grown to the size of `keys`. O(n), a few counting passes.
inline void sort_by_upper_half(std::vector<std::uint64_t>& keys,
                               std::vector<std::uint64_t>& scratch) {
  constexpr int kBits = 11;
  constexpr std::size_t kBuckets = std::size_t{1} << kBits;
  std::uint64_t any = 0;
  for (const std::uint64_t key : keys) any |= key;
  if (keys.size() < 64) {
    std::stable_sort(keys.begin(), keys.end(),
                     [](std::uint64_t a, std::uint64_t b) { return a >> 32 < b >> 32; });
    return;
  }
  scratch.resize(keys.size());
  for (int shift = 32; shift < 64 && (any >> shift) != 0; shift += kBits) {
    std::array<std::uint32_t, kBuckets> begins{};
    for (const std::uint64_t key : keys) ++begins[(key >> shift) & (kBuckets - 1)];
    std::uint32_t begin = 0;
    for (std::uint32_t& b : begins) {
      const std::uint32_t count = b;
      b = begin;
      begin += count;
    }
    for (const std::uint64_t key : keys) scratch[begins[(key >> shift) & (kBuckets - 1)]++] = key;
    keys.swap(scratch);
  }
}

}  // namespace dynslam::loop::detail
