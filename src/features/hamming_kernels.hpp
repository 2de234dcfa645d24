// Hamming distances, raw pointers only. Each kernel picks its vector instructions when it is called
// (Highway); the results are exact, so they are the same on all machines.
#pragma once

#include <cstddef>
#include <cstdint>

namespace dynslam::features::detail {

int hamming_one(const std::uint8_t* a, const std::uint8_t* b, std::size_t bytes);

/// distances[i] = distance of `query` to the row i (or rows[i], if `rows` is given) of `train`.
void hamming_many(const std::uint8_t* query, const std::uint8_t* train, std::ptrdiff_t stride,
                  std::size_t bytes, const std::int32_t* rows, std::size_t count,
                  std::int32_t* distances);

// All against all. A key holds a distance and, below it, an index: the smaller key is the nearer
// descriptor and, of equally near ones, the first. Rows are taken in blocks so that both fit.
inline constexpr int kKeyIndexBits = 12;
inline constexpr std::size_t kBlockRows = std::size_t{1} << kKeyIndexBits;
inline constexpr std::uint32_t kNoKey = 0xFFFFFFFFU;
/// Longest descriptor whose distances fit above the index.
inline constexpr std::size_t kMaxKeyBytes = ((std::size_t{1} << (32 - kKeyIndexBits)) - 1) / 8;

/// 64-bit words of a descriptor.
inline std::size_t words_of(std::size_t bytes) { return (bytes + 7) / 8; }

/// Train rows rounded up so that whole vectors can be read.
inline std::size_t padded_rows(std::size_t rows) { return (rows + 7) / 8 * 8; }

/// The two smallest keys (distance, train row) of a query.
struct TwoKeys {
  std::uint32_t best = kNoKey;
  std::uint32_t second = kNoKey;
};

/// Compares `queries` descriptors (words_of(bytes) words each, without gaps) with a block of at
/// most kBlockRows train descriptors given word by word: word w of row t is train[w
/// padded_rows(rows) + t].
///
/// keys[q]: the two nearest rows of query q. If `reverse` is not null, reverse[t],
/// padded_rows(rows) of them, is lowered to the key (distance, query row) of the nearest query of
/// row t; queries are then at most kBlockRows.
void hamming_block(const std::uint64_t* queries, std::size_t query_count,
                   const std::uint64_t* train, std::size_t rows, std::size_t words, TwoKeys* keys,
                   std::uint32_t* reverse);

}  // namespace dynslam::features::detail
