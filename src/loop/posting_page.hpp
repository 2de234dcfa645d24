// The lists of 64 neighbouring words in one block of memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>

#include "dynslam/core/span.hpp"

namespace dynslam::loop {

// Weights of one image as 14 bits: 4 bits of exponent and 10 of mantissa, relative to the image's
// largest weight, which is 1. Codes run from 1 << 10 (2^-14) to 15 << 10 (1).
inline constexpr std::uint32_t kLeastCode = 1U << 10;
inline constexpr std::uint32_t kGreatestCode = 15U << 10;

/// Nearest code of a ratio in [0, 1]; what is below 2^-14 becomes that.
std::uint32_t encode_ratio(float ratio);

/// Inverse of encode_ratio for codes between the two bounds.
inline float decode_ratio(std::uint32_t code) {
  // Code and float differ in the bias of the exponent, 15 and 127, and in 13 bits of mantissa.
  const std::uint32_t bits = (code << 13) + (112U << 23);
  float ratio;
  std::memcpy(&ratio, &bits, sizeof(ratio));
  return ratio;
}

/// Lists of postings (slot of an image, code of a weight) of 64 words.
///
/// Memory: a table of 64 {end, last slot}, then the lists one after another. A list is cut into
/// blocks of 512 bytes, counted from its own start; no posting straddles a cut. A posting is two
/// bytes, code << 2 | n, and n + 1 bytes of distance: to the slot before, or, for the first of a
/// block, the slot itself. Where a block's last bytes hold no posting they are 0. An empty page
/// takes no memory.
class PostingPage {
 public:
  static constexpr std::uint32_t kWords = 64;
  static constexpr std::uint32_t kBlockBytes = 512;

  PostingPage() = default;

  bool empty() const { return memory_ == nullptr; }
  /// Bytes allocated.
  std::size_t allocated() const;

  /// Appends a posting; `slot` is above the list's last one. O(bytes of the page).
  void append(std::uint32_t word, std::uint32_t slot, std::uint32_t code);

  struct List {
    const std::uint8_t* begin = nullptr;  // readable for four bytes past the end
    std::uint32_t bytes = 0;
  };
  List list(std::uint32_t word) const {
    if (memory_ == nullptr) return {};
    const Table& table = header();
    const std::uint32_t begin = word == 0 ? 0 : table.end[word - 1];
    return {payload() + begin, table.end[word] - begin};
  }

  /// For prefetching.
  const void* table_line(std::uint32_t word) const {
    return memory_ == nullptr ? nullptr : memory_.get() + sizeof(Prefix) + 4U * word;
  }

  /// The page's bytes as they are stored in a file; empty for an empty page.
  Span<const std::uint8_t> bytes() const;

  /// Takes over the bytes of a file. Returns what is wrong with them, or nothing, in which case
  /// every list is sorted, every slot is below `slots` and every code in bounds.
  std::string assign(Span<const std::uint8_t> bytes, std::uint32_t slots);

 private:
  struct Prefix {
    std::uint32_t capacity;  // of the payload
  };
  struct Table {
    std::uint32_t end[kWords];
    std::uint32_t last[kWords];
  };
  static constexpr std::size_t kPadding = 4;

  Table& header() { return *reinterpret_cast<Table*>(memory_.get() + sizeof(Prefix)); }
  const Table& header() const {
    return *reinterpret_cast<const Table*>(memory_.get() + sizeof(Prefix));
  }
  Prefix& prefix() { return *reinterpret_cast<Prefix*>(memory_.get()); }
  const Prefix& prefix() const { return *reinterpret_cast<const Prefix*>(memory_.get()); }
  std::uint8_t* payload() { return memory_.get() + sizeof(Prefix) + sizeof(Table); }
  const std::uint8_t* payload() const { return memory_.get() + sizeof(Prefix) + sizeof(Table); }
  void grow(std::uint32_t payload_bytes, bool slack);

  struct Free {
    void operator()(std::uint8_t* memory) const;
  };
  std::unique_ptr<std::uint8_t[], Free> memory_;
};

/// Calls use(slot, code) for the postings of one block, `bytes` <= kBlockBytes, in ascending order.
template <typename Use>
inline void for_each_in_block(const std::uint8_t* at, std::uint32_t bytes, Use&& use) {
  static constexpr std::uint32_t kMask[4] = {0xFFU, 0xFFFFU, 0xFFFFFFU, 0xFFFFFFFFU};
  const std::uint8_t* const end = at + bytes;
  std::uint32_t slot = 0;
  while (end - at >= 3) {
    std::uint16_t head;
    std::uint32_t distance;
    std::memcpy(&head, at, 2);
    if (head == 0) break;  // the rest is padding: no code is 0
    std::memcpy(&distance, at + 2, 4);
    const std::uint32_t n = head & 3U;
    slot += distance & kMask[n];
    use(slot, static_cast<std::uint32_t>(head >> 2));
    at += n + 3;
  }
}

template <typename Use>
inline void for_each_posting(PostingPage::List list, Use&& use) {
  while (list.bytes > 0) {
    const std::uint32_t bytes =
        list.bytes < PostingPage::kBlockBytes ? list.bytes : PostingPage::kBlockBytes;
    for_each_in_block(list.begin, bytes, use);
    list.begin += bytes;
    list.bytes -= bytes;
  }
}

/// First slot of the block that starts at `at`.
inline std::uint32_t first_slot(const std::uint8_t* at) {
  std::uint32_t distance;
  std::memcpy(&distance, at + 2, 4);
  return distance & (0xFFFFFFFFU >> (8U * (3U - (at[0] & 3U))));
}

}  // namespace dynslam::loop
