#include "loop/walk_kernels.hpp"

#include <algorithm>
#include <cstring>

#include "dynslam/loop/vocabulary_tree.hpp"

#include "loop/simd.hpp"
#include "loop/vocabulary_block.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "loop/walk_kernels.cpp"
#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace dynslam::loop::detail::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

HWY_INLINE std::uint32_t count_bits(std::uint64_t v) {
#if HWY_TARGET == HWY_SCALAR || HWY_TARGET == HWY_EMU128 || HWY_TARGET == HWY_SSSE3
  // Without an instruction for it: sums of neighbouring bits, pairs, fours, and the bytes at once.
  v -= (v >> 1) & 0x5555555555555555U;
  v = (v & 0x3333333333333333U) + ((v >> 2) & 0x3333333333333333U);
  v = (v + (v >> 4)) & 0x0F0F0F0F0F0F0F0FU;
  return static_cast<std::uint32_t>((v * 0x0101010101010101U) >> 56);
#else
  return static_cast<std::uint32_t>(hwy::PopCount(v));
#endif
}

HWY_INLINE std::uint64_t word64(const std::uint8_t* at) {
  std::uint64_t word;
  std::memcpy(&word, at, sizeof(word));
  return word;
}

HWY_INLINE std::uint32_t word32(const std::uint8_t* at) {
  std::uint32_t word;
  std::memcpy(&word, at, sizeof(word));
  return word;
}

/// Distance of two descriptors of kWords words, or of `words` if that is 0.
template <std::size_t kWords>
HWY_INLINE std::uint32_t distance(const std::uint64_t* a, const std::uint8_t* b,
                                  std::size_t words) {
  std::uint32_t sum = 0;
  if constexpr (kWords != 0) {
    for (std::size_t w = 0; w < kWords; ++w) sum += count_bits(a[w] ^ word64(b + 8 * w));
  } else {
    for (std::size_t w = 0; w < words; ++w) sum += count_bits(a[w] ^ word64(b + 8 * w));
  }
  return sum;
}

// Descriptors that walk at once. While one waits for its next block the others compare.
constexpr std::size_t kWalkers = 16;
constexpr std::size_t kMaxWords = kMaxDescriptorBytes / 8;
constexpr std::size_t kLine = 64;
constexpr std::size_t kMaxFetch = 24 * kLine;

struct Walker {
  const std::uint8_t* block;
  std::size_t item;  // which descriptor
  int level;         // of the block's children
};

template <std::size_t kWords>
class Walkers {
 public:
  Walkers(const Walk& walk, std::uint32_t* words, std::uint32_t* nodes)
      : walk_(walk), words_(words), nodes_(nodes) {}

  void run() {
    std::size_t active = 0;
    while (active < kWalkers && next_ < walk_.count) start(active++);
    while (active > 0) {
      for (std::size_t i = 0; i < active;) {
        if (step(i)) {
          ++i;
        } else if (next_ < walk_.count) {
          start(i++);
        } else {
          --active;
          walkers_[i] = walkers_[active];
          std::memcpy(queries_[i], queries_[active], sizeof(queries_[i]));
        }
      }
    }
  }

 private:
  void start(std::size_t i) {
    const std::size_t row = walk_.kept != nullptr ? walk_.kept[next_] : next_;
    const std::uint8_t* at = walk_.rows + static_cast<std::ptrdiff_t>(row) * walk_.row_stride;
    queries_[i][words64_ - 1] = 0;
    std::memcpy(queries_[i], at, walk_.descriptor_bytes);
    if (nodes_ != nullptr) nodes_[next_] = 0;
    walkers_[i] = {walk_.tree, next_, 1};
    ++next_;
  }

  /// One level down; false at a word.
  HWY_INLINE bool step(std::size_t i) {
    Walker& walker = walkers_[i];
    const std::uint8_t* block = walker.block;
    const std::size_t children = word32(block);
    const std::uint8_t* descriptor = block + descriptors_offset(children);
    // The distance above, the child below: the least number is the first of the nearest.
    std::uint32_t best = 0xFFFFFFFFU;
    for (std::uint32_t c = 0; c < children; ++c, descriptor += 8 * words64_) {
      best = std::min(best, distance<kWords>(queries_[i], descriptor, words64_) << 16 | c);
    }
    best &= 0xFFFFU;
    const std::uint32_t link = word32(block + 8 + 4 * best);
    const bool is_word = (link & kLeafBit) != 0;
    if (nodes_ != nullptr &&
        (walker.level == walk_.node_level || (is_word && walker.level < walk_.node_level))) {
      nodes_[walker.item] = word32(block + 4) + best;
    }
    if (is_word) {
      words_[walker.item] = link & ~kLeafBit;
      return false;
    }
    walker.block = walk_.tree + std::size_t{link} * 8;
    ++walker.level;
    const auto address = reinterpret_cast<std::uintptr_t>(walker.block);  // may reach too far
    for (std::size_t b = 0; b < walk_.fetch_bytes; b += kLine) {
      hwy::Prefetch(reinterpret_cast<const void*>(address + b));
    }
    return true;
  }

  const Walk& walk_;
  std::uint32_t* words_;
  std::uint32_t* nodes_;
  const std::size_t words64_ = kWords != 0 ? kWords : (walk_.descriptor_bytes + 7) / 8;
  std::size_t next_ = 0;
  Walker walkers_[kWalkers];
  std::uint64_t queries_[kWalkers][kWords != 0 ? kWords : kMaxWords];
};

void walk_target(const Walk& given, std::uint32_t* words, std::uint32_t* nodes) {
  Walk walk = given;
  walk.fetch_bytes = std::min(walk.fetch_bytes + kLine, kMaxFetch);  // it may begin amid a line
  switch ((walk.descriptor_bytes + 7) / 8) {
    case 4:
      return Walkers<4>(walk, words, nodes).run();
    case 6:
      return Walkers<6>(walk, words, nodes).run();
    case 8:
      return Walkers<8>(walk, words, nodes).run();
    default:
      return Walkers<0>(walk, words, nodes).run();
  }
}

// Eight lanes of 64 bits, whatever the width of the machine's vectors. Each adds the product of the
// halves of its keyed input, and the input of its neighbour, so that no bit is lost where the other
// half is 0; keys change from stripe to stripe, so that stripes cannot change places.
constexpr std::size_t kSumLanes = 8;
constexpr std::uint64_t kSumStep = 0x9E3779B97F4A7C15U;
constexpr std::size_t kSumAhead = 4096;  // a page: where the machine's own fetching ahead stops

#if HWY_TARGET == HWY_SCALAR
void sum_stripes(const std::uint8_t* bytes, std::size_t stripes, std::uint64_t* keys,
                 std::uint64_t* sums) {
  for (std::size_t s = 0; s < stripes; ++s, bytes += 8 * kSumLanes) {
    for (std::size_t i = 0; i < kSumLanes; ++i) {
      const std::uint64_t keyed = word64(bytes + 8 * i) ^ keys[i];
      sums[i] += (keyed & 0xFFFFFFFFU) * (keyed >> 32) + word64(bytes + 8 * (i ^ 1U));
      keys[i] += kSumStep;
    }
  }
}
#else
void sum_stripes(const std::uint8_t* bytes, std::size_t stripes, std::uint64_t* keys,
                 std::uint64_t* sums) {
  const hn::CappedTag<std::uint64_t, kSumLanes> d;
  const hn::Repartition<std::uint32_t, decltype(d)> d32;
  const hn::Repartition<std::uint8_t, decltype(d)> d8;
  const auto step = hn::Set(d, kSumStep);
  for (std::size_t first = 0; first < kSumLanes; first += hn::Lanes(d)) {
    auto key = hn::LoadU(d, keys + first);
    auto sum = hn::LoadU(d, sums + first);
    const std::uint8_t* at = bytes + 8 * first;
    for (std::size_t s = 0; s < stripes; ++s, at += 8 * kSumLanes) {
      // An address, not a pointer: it may lie behind the bytes.
      if (first == 0) {
        hwy::Prefetch(
            reinterpret_cast<const void*>(reinterpret_cast<std::uintptr_t>(at) + kSumAhead));
      }
      const auto data = hn::BitCast(d, hn::LoadU(d8, at));
      const auto keyed = hn::Xor(data, key);
      const auto low = hn::BitCast(d32, keyed);
      const auto high = hn::BitCast(d32, hn::ShiftRight<32>(keyed));
      sum = hn::Add(sum, hn::Add(hn::MulEven(low, high), hn::Shuffle01(data)));
      key = hn::Add(key, step);
    }
    hn::StoreU(key, d, keys + first);
    hn::StoreU(sum, d, sums + first);
  }
}
#endif

void checksum_target(const std::uint8_t* bytes, std::size_t size, std::uint64_t* keys,
                     std::uint64_t* sums) {
  constexpr std::size_t kStripe = Checksum::kStripe;
  constexpr std::size_t kPiece = 256;  // stripes that stay in the first cache between passes
  std::size_t left = size / kStripe;
  while (left > 0) {
    const std::size_t piece = std::min(left, kPiece);
    sum_stripes(bytes, piece, keys, sums);
    bytes += piece * kStripe;
    left -= piece;
  }
  if (size % kStripe == 0) return;
  alignas(64) std::uint8_t rest[kStripe] = {};
  std::memcpy(rest, bytes, size % kStripe);
  sum_stripes(rest, 1, keys, sums);
}

bool weights_valid_target(const double* weights, std::size_t count) {
  // Numbers without a sign are ordered as their bit patterns are; all others are above them.
  std::uint64_t highest = 0;
  for (std::size_t i = 0; i < count; ++i) {
    std::uint64_t bits;
    std::memcpy(&bits, weights + i, sizeof(bits));
    highest = std::max(highest, bits);
  }
  std::uint64_t most;
  std::memcpy(&most, &kMaxWordWeight, sizeof(most));
  return highest <= most;
}

template <std::size_t kWords>
std::uint64_t assign(const std::uint64_t* descriptors, std::size_t words, const std::uint32_t* rows,
                     std::size_t count, const std::uint64_t* centres, std::size_t centre_count,
                     std::uint8_t* nearest) {
  const std::size_t length = kWords != 0 ? kWords : words;
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < count; ++i) {
    constexpr std::size_t kAhead = 16;
    if (i + kAhead < count) hwy::Prefetch(descriptors + rows[i + kAhead] * length);
    const std::uint64_t* query = descriptors + rows[i] * length;
    std::uint32_t best = 0xFFFFFFFFU;
    for (std::uint32_t c = 0; c < centre_count; ++c) {
      const auto* centre = reinterpret_cast<const std::uint8_t*>(centres + c * length);
      best = std::min(best, distance<kWords>(query, centre, length) << 16 | c);
    }
    nearest[i] = static_cast<std::uint8_t>(best & 0xFFU);
    sum += best >> 16;
  }
  return sum;
}

std::uint64_t assign_target(const std::uint64_t* descriptors, std::size_t words,
                            const std::uint32_t* rows, std::size_t count,
                            const std::uint64_t* centres, std::size_t centre_count,
                            std::uint8_t* nearest) {
  const auto function = words == 4 ? assign<4> : assign<0>;
  return function(descriptors, words, rows, count, centres, centre_count, nearest);
}

std::uint64_t lower_target(const std::uint64_t* descriptors, std::size_t words,
                           const std::uint32_t* rows, std::size_t count,
                           const std::uint64_t* centre, std::uint16_t* distances) {
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const auto* row = reinterpret_cast<const std::uint8_t*>(descriptors + rows[i] * words);
    const std::uint32_t now =
        words == 4 ? distance<4>(centre, row, words) : distance<0>(centre, row, words);
    distances[i] = std::min(distances[i], static_cast<std::uint16_t>(now));
    sum += distances[i];
  }
  return sum;
}

}  // namespace

// Names for the dispatch tables, which cannot see into an anonymous namespace.
void walk_entry(const Walk& walk, std::uint32_t* words, std::uint32_t* nodes) {
  walk_target(walk, words, nodes);
}
void checksum_entry(const std::uint8_t* bytes, std::size_t size, std::uint64_t* keys,
                    std::uint64_t* sums) {
  checksum_target(bytes, size, keys, sums);
}
bool weights_valid_entry(const double* weights, std::size_t count) {
  return weights_valid_target(weights, count);
}
std::uint64_t assign_entry(const std::uint64_t* descriptors, std::size_t words,
                           const std::uint32_t* rows, std::size_t count,
                           const std::uint64_t* centres, std::size_t centre_count,
                           std::uint8_t* nearest) {
  return assign_target(descriptors, words, rows, count, centres, centre_count, nearest);
}
std::uint64_t lower_entry(const std::uint64_t* descriptors, std::size_t words,
                          const std::uint32_t* rows, std::size_t count, const std::uint64_t* centre,
                          std::uint16_t* distances) {
  return lower_target(descriptors, words, rows, count, centre, distances);
}

}  // namespace dynslam::loop::detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::loop::detail {

HWY_EXPORT(walk_entry);
HWY_EXPORT(checksum_entry);
HWY_EXPORT(weights_valid_entry);
HWY_EXPORT(assign_entry);
HWY_EXPORT(lower_entry);

void walk_down(const Walk& walk, std::uint32_t* words, std::uint32_t* nodes) {
  HWY_DYNAMIC_DISPATCH(walk_entry)(walk, words, nodes);
}

namespace {

constexpr std::uint64_t kFirstKeys[8] = {
    0xB5026F5AA96619E9U, 0x3C6EF372FE94F82BU, 0x78DDE6E4B4F1A3C1U, 0xA54FF53A5F1D36F1U,
    0x510E527FADE682D1U, 0x9B05688C2B3E6C1FU, 0x1F83D9ABFB41BD6BU, 0x5BE0CD19137E2179U};

/// The finalizer of MurmurHash3 (Appleby, public domain).
std::uint64_t mix(std::uint64_t v) {
  v = (v ^ (v >> 33)) * 0xFF51AFD7ED558CCDU;
  v = (v ^ (v >> 33)) * 0xC4CEB9FE1A85EC53U;
  return v ^ (v >> 33);
}

}  // namespace

Checksum::Checksum() { std::copy(std::begin(kFirstKeys), std::end(kFirstKeys), keys_); }

void Checksum::add(const std::uint8_t* bytes, std::size_t size) {
  HWY_DYNAMIC_DISPATCH(checksum_entry)(bytes, size, keys_, sums_);
  size_ += size;
}

std::uint64_t Checksum::value() const {
  std::uint64_t total = mix(size_);
  for (const std::uint64_t sum : sums_) total = mix(total ^ sum) * 0x9E3779B97F4A7C15U;
  return total;
}

bool all_weights_valid(const double* weights, std::size_t count) {
  return HWY_DYNAMIC_DISPATCH(weights_valid_entry)(weights, count);
}

std::uint64_t assign_nearest(const std::uint64_t* descriptors, std::size_t words,
                             const std::uint32_t* rows, std::size_t count,
                             const std::uint64_t* centres, std::size_t centre_count,
                             std::uint8_t* nearest) {
  return HWY_DYNAMIC_DISPATCH(assign_entry)(descriptors, words, rows, count, centres, centre_count,
                                            nearest);
}

std::uint64_t lower_distances(const std::uint64_t* descriptors, std::size_t words,
                              const std::uint32_t* rows, std::size_t count,
                              const std::uint64_t* centre, std::uint16_t* distances) {
  return HWY_DYNAMIC_DISPATCH(lower_entry)(descriptors, words, rows, count, centre, distances);
}

}  // namespace dynslam::loop::detail
#endif
