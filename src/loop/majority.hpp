// Counting bits of descriptors, and the descriptor that most of them agree on.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace dynslam::loop::detail {

/// Counts how often each bit is set. Counts are kept bit-sliced: plane p holds bit p of all counts,
/// so that adding a descriptor is a few operations on whole words.
class BitCounter {
 public:
  explicit BitCounter(std::size_t words)
      : words_(words), planes_(kPlanes * words, 0), counts_(words * 64, 0) {}

  void clear();
  void add(const std::uint64_t* descriptor) {
    if (words_ == 4) {
      add_words<4>(descriptor, planes_.data());
    } else {
      for (std::size_t w = 0; w < words_; ++w) {
        add_words<1>(descriptor + w, planes_.data() + kPlanes * w);
      }
    }
    ++added_;
    if (++waiting_ == kMostWaiting) flush();
  }
  /// Adds what another one counted.
  void add(BitCounter& other);
  std::size_t added() const { return added_; }
  /// Bits set in at least half of what was added.
  void majority(std::uint64_t* descriptor);

 private:
  static constexpr std::size_t kPlanes = 8;
  static constexpr std::size_t kMostWaiting = (1U << kPlanes) - 1;

  template <std::size_t kWords>
  static void add_words(const std::uint64_t* descriptor, std::uint64_t* planes) {
    std::uint64_t carry[kWords];
    for (std::size_t w = 0; w < kWords; ++w) carry[w] = descriptor[w];
    for (std::size_t p = 0; p < kPlanes; ++p, planes += kWords) {
      std::uint64_t left = 0;
      for (std::size_t w = 0; w < kWords; ++w) {
        const std::uint64_t both = planes[w] & carry[w];
        planes[w] ^= carry[w];
        carry[w] = both;
        left |= both;
      }
      if (left == 0) return;
    }
  }
  /// Plane p of word w.
  std::uint64_t& plane_of(std::size_t p, std::size_t w) {
    return planes_[words_ == 4 ? 4 * p + w : kPlanes * w + p];
  }

  void flush();

  std::size_t words_;
  std::vector<std::uint64_t> planes_;
  std::vector<std::uint32_t> counts_;
  std::size_t waiting_ = 0;
  std::size_t added_ = 0;
};

}  // namespace dynslam::loop::detail
