#include "features/hamming_kernels.hpp"

#include <algorithm>
#include <cstring>

#include "dynslam/features/hamming_reference.hpp"

#include "features/simd.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "features/hamming_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace dynslam::features::detail::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

HWY_INLINE int count_bits(std::uint64_t v) {
#if HWY_TARGET == HWY_SCALAR || HWY_TARGET == HWY_EMU128 || HWY_TARGET == HWY_SSSE3
  // Without an instruction for it: sums of neighbouring bits, pairs, fours, and the bytes at once.
  v -= (v >> 1) & 0x5555555555555555U;
  v = (v & 0x3333333333333333U) + ((v >> 2) & 0x3333333333333333U);
  v = (v + (v >> 4)) & 0x0F0F0F0F0F0F0F0FU;
  return static_cast<int>((v * 0x0101010101010101U) >> 56);
#else
  return static_cast<int>(hwy::PopCount(v));
#endif
}

HWY_INLINE std::uint64_t load_word(const std::uint8_t* at) {
  std::uint64_t word;
  std::memcpy(&word, at, sizeof(word));
  return word;
}

HWY_INLINE int distance_of(const std::uint8_t* a, const std::uint8_t* b, std::size_t bytes) {
  int distance = 0;
  std::size_t i = 0;
  for (; i + 8 <= bytes; i += 8) distance += count_bits(load_word(a + i) ^ load_word(b + i));
  if (i < bytes) {
    std::uint64_t rest_a = 0;
    std::uint64_t rest_b = 0;
    std::memcpy(&rest_a, a + i, bytes - i);
    std::memcpy(&rest_b, b + i, bytes - i);
    distance += count_bits(rest_a ^ rest_b);
  }
  return distance;
}

/// 32 bytes, the length that matters most, without a loop.
HWY_INLINE int distance_of_32(const std::uint64_t* query, const std::uint8_t* b) {
  return count_bits(query[0] ^ load_word(b)) + count_bits(query[1] ^ load_word(b + 8)) +
         count_bits(query[2] ^ load_word(b + 16)) + count_bits(query[3] ^ load_word(b + 24));
}

void many(const std::uint8_t* query, const std::uint8_t* train, std::ptrdiff_t stride,
          std::size_t bytes, const std::int32_t* rows, std::size_t count, std::int32_t* distances) {
  std::uint64_t words[4] = {};
  if (bytes == 32) std::memcpy(words, query, 32);
  for (std::size_t i = 0; i < count; ++i) {
    const std::ptrdiff_t row = rows != nullptr ? rows[i] : static_cast<std::ptrdiff_t>(i);
    const std::uint8_t* at = train + row * stride;
    distances[i] = bytes == 32 ? distance_of_32(words, at) : distance_of(query, at, bytes);
  }
}

#if HWY_TARGET == HWY_SCALAR

void block(const std::uint64_t* queries, std::size_t query_count, const std::uint64_t* train,
           std::size_t rows, std::size_t words, TwoKeys* keys, std::uint32_t* reverse) {
  const std::size_t pitch = padded_rows(rows);
  for (std::size_t q = 0; q < query_count; ++q) {
    TwoKeys two;
    for (std::size_t t = 0; t < rows; ++t) {
      std::uint32_t distance = 0;
      for (std::size_t w = 0; w < words; ++w) {
        distance +=
            static_cast<std::uint32_t>(count_bits(queries[q * words + w] ^ train[w * pitch + t]));
      }
      const std::uint32_t key = (distance << kKeyIndexBits) | static_cast<std::uint32_t>(t);
      two.second = std::min(two.second, std::max(two.best, key));
      two.best = std::min(two.best, key);
      if (reverse != nullptr) {
        reverse[t] =
            std::min(reverse[t], (distance << kKeyIndexBits) | static_cast<std::uint32_t>(q));
      }
    }
    keys[q] = two;
  }
}

#else

// Lanes are train rows: a lane's 64 bits go through the words of one descriptor, so nothing is
// summed across lanes until the end. At most 8 lanes: what `padded_rows` provides for.
using D64 = hn::CappedTag<std::uint64_t, 8>;
using D8 = hn::Repartition<std::uint8_t, D64>;
using D32 = hn::Repartition<std::uint32_t, D64>;
using V64 = hn::Vec<D64>;
using V32 = hn::Vec<D32>;

/// Distances of one query to a vector of train rows.
HWY_INLINE V64 distances_of(const std::uint64_t* query, const std::uint64_t* train,
                            std::size_t pitch, std::size_t words) {
  const D64 d64;
  const D8 d8;
  // Counts of a byte's bits add up in the byte, 31 words at most, before bytes are summed.
  V64 sum = hn::Zero(d64);
  for (std::size_t begin = 0; begin < words; begin += 31) {
    const std::size_t end = std::min(begin + 31, words);
    auto counts = hn::Zero(d8);
    for (std::size_t w = begin; w < end; ++w) {
      const V64 differing = hn::Xor(hn::Set(d64, query[w]), hn::LoadU(d64, train + w * pitch));
      counts = hn::Add(counts, hn::PopulationCount(hn::BitCast(d8, differing)));
    }
    sum = hn::Add(sum, hn::SumsOf8(counts));
  }
  return sum;
}

/// The same for four words, unrolled.
HWY_INLINE V64 distances_of_4(V64 q0, V64 q1, V64 q2, V64 q3, const std::uint64_t* train,
                              std::size_t pitch) {
  const D64 d64;
  const D8 d8;
  const auto count = [&](V64 q, const std::uint64_t* at) HWY_ATTR {
    return hn::PopulationCount(hn::BitCast(d8, hn::Xor(q, hn::LoadU(d64, at))));
  };
  const auto first = hn::Add(count(q0, train), count(q1, train + pitch));
  const auto last = hn::Add(count(q2, train + 2 * pitch), count(q3, train + 3 * pitch));
  return hn::SumsOf8(hn::Add(first, last));
}

/// Lowers the two smallest keys of each lane by another key. The upper half of every 64-bit lane
/// stays 0 in `key`; it has to start as 0 in `best` and `second` too.
HWY_INLINE void keep_two(V32 key, V32& best, V32& second) {
  second = hn::Min(second, hn::Max(best, key));
  best = hn::Min(best, key);
}

TwoKeys two_of_lanes(V32 best, V32 second) {
  const D64 d64;
  alignas(64) std::uint64_t bests[8];
  alignas(64) std::uint64_t seconds[8];
  hn::Store(hn::BitCast(d64, best), d64, bests);
  hn::Store(hn::BitCast(d64, second), d64, seconds);
  TwoKeys two;
  for (std::size_t i = 0; i < hn::Lanes(d64); ++i) {
    for (const std::uint64_t wide : {bests[i], seconds[i]}) {
      const std::uint32_t key = static_cast<std::uint32_t>(wide);
      two.second = std::min(two.second, std::max(two.best, key));
      two.best = std::min(two.best, key);
    }
  }
  return two;
}

HWY_INLINE void lower_reverse(V64 distance, std::size_t query, std::uint32_t* reverse) {
  const D64 d64;
  const hn::Rebind<std::uint32_t, D64> narrow;
  const V64 key = hn::Or(hn::ShiftLeft<kKeyIndexBits>(distance),
                         hn::Set(d64, static_cast<std::uint64_t>(query)));
  // The numbers fit in 32 bits: the lower halves are all there is.
  const auto lower = hn::TruncateTo(narrow, key);
  hn::StoreU(hn::Min(hn::LoadU(narrow, reverse), lower), narrow, reverse);
}

template <bool kFourWords>
TwoKeys compare_query(const std::uint64_t* query, std::size_t query_index,
                      const std::uint64_t* train, std::size_t rows, std::size_t words,
                      std::uint32_t* reverse) {
  const D64 d64;
  const D32 d32;
  const std::size_t lanes = hn::Lanes(d64);
  const std::size_t pitch = padded_rows(rows);
  const V64 q0 = hn::Set(d64, query[0]);
  const V64 q1 = hn::Set(d64, kFourWords ? query[1] : 0);
  const V64 q2 = hn::Set(d64, kFourWords ? query[2] : 0);
  const V64 q3 = hn::Set(d64, kFourWords ? query[3] : 0);
  const V64 none = hn::Set(d64, std::uint64_t{kNoKey});
  V64 index = hn::Iota(d64, 0);
  V32 best = hn::BitCast(d32, none);
  V32 second = best;
  const auto distance_at = [&](std::size_t t) HWY_ATTR {
    if constexpr (kFourWords) {
      return distances_of_4(q0, q1, q2, q3, train + t, pitch);
    } else {
      return distances_of(query, train + t, pitch, words);
    }
  };
  std::size_t t = 0;
  for (; t + lanes <= rows; t += lanes) {
    const V64 distance = distance_at(t);
    const V64 key = hn::Or(hn::ShiftLeft<kKeyIndexBits>(distance), index);
    keep_two(hn::BitCast(d32, key), best, second);
    if (reverse != nullptr) lower_reverse(distance, query_index, reverse + t);
    index = hn::Add(index, hn::Set(d64, std::uint64_t{lanes}));
  }
  if (t < rows) {
    // The padding behind the last row is no row.
    const V64 distance = distance_at(t);
    const V64 key = hn::Or(hn::ShiftLeft<kKeyIndexBits>(distance), index);
    const auto is_row = hn::Lt(hn::BitCast(hn::RebindToSigned<D64>(), index),
                               hn::Set(hn::RebindToSigned<D64>(), static_cast<std::int64_t>(rows)));
    const V64 kept = hn::IfThenElse(hn::RebindMask(d64, is_row), key, none);
    keep_two(hn::BitCast(d32, kept), best, second);
    if (reverse != nullptr) lower_reverse(distance, query_index, reverse + t);
  }
  return two_of_lanes(best, second);
}

void block(const std::uint64_t* queries, std::size_t query_count, const std::uint64_t* train,
           std::size_t rows, std::size_t words, TwoKeys* keys, std::uint32_t* reverse) {
  for (std::size_t q = 0; q < query_count; ++q) {
    const std::uint64_t* query = queries + q * words;
    keys[q] = words == 4 ? compare_query<true>(query, q, train, rows, words, reverse)
                         : compare_query<false>(query, q, train, rows, words, reverse);
  }
}

#endif

}  // namespace

// Names for the dispatch tables, which cannot see into an anonymous namespace.
int hamming_one_target(const std::uint8_t* a, const std::uint8_t* b, std::size_t bytes) {
  return distance_of(a, b, bytes);
}

void hamming_many_target(const std::uint8_t* query, const std::uint8_t* train,
                         std::ptrdiff_t stride, std::size_t bytes, const std::int32_t* rows,
                         std::size_t count, std::int32_t* distances) {
  many(query, train, stride, bytes, rows, count, distances);
}

void hamming_block_target(const std::uint64_t* queries, std::size_t query_count,
                          const std::uint64_t* train, std::size_t rows, std::size_t words,
                          TwoKeys* keys, std::uint32_t* reverse) {
  block(queries, query_count, train, rows, words, keys, reverse);
}

}  // namespace dynslam::features::detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::features::detail {

HWY_EXPORT(hamming_one_target);
HWY_EXPORT(hamming_many_target);
HWY_EXPORT(hamming_block_target);

int hamming_one(const std::uint8_t* a, const std::uint8_t* b, std::size_t bytes) {
  return HWY_DYNAMIC_DISPATCH(hamming_one_target)(a, b, bytes);
}

void hamming_many(const std::uint8_t* query, const std::uint8_t* train, std::ptrdiff_t stride,
                  std::size_t bytes, const std::int32_t* rows, std::size_t count,
                  std::int32_t* distances) {
  HWY_DYNAMIC_DISPATCH(hamming_many_target)(query, train, stride, bytes, rows, count, distances);
}

void hamming_block(const std::uint64_t* queries, std::size_t query_count,
                   const std::uint64_t* train, std::size_t rows, std::size_t words, TwoKeys* keys,
                   std::uint32_t* reverse) {
  HWY_DYNAMIC_DISPATCH(hamming_block_target)
  (queries, query_count, train, rows, words, keys, reverse);
}

}  // namespace dynslam::features::detail
#endif
