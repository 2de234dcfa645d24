// What runs over whole vocabularies and whole images: vectorized, raw pointers only. Each kernel
// picks its instructions when it is called (Highway); results are exact and the same everywhere.
#pragma once

#include <cstddef>
#include <cstdint>

namespace dynslam::loop::detail {

/// Descriptors on their way down the tree of a block (vocabulary_block.hpp), which was checked.
struct Walk {
  const std::uint8_t* tree = nullptr;
  std::size_t descriptor_bytes = 0;
  std::size_t fetch_bytes = 0;  // size of a full block, to be fetched before it is needed
  int node_level = -1;          // level of the node that is asked for; below 0: none

  const std::uint8_t* rows = nullptr;
  std::ptrdiff_t row_stride = 0;
  const std::uint32_t* kept = nullptr;  // rows to walk; null: 0 .. count - 1
  std::size_t count = 0;
};

/// words[i], nodes[i]: word of descriptor i and number of the node that it passed at node_level
/// (of the word itself if that lies above; 0 for level 0). `nodes` may be null.
void walk_down(const Walk& walk, std::uint32_t* words, std::uint32_t* nodes);

/// 64 bits that change when a bit of the bytes does, or their order. Not against intent.
class Checksum {
 public:
  static constexpr std::size_t kStripe = 64;

  Checksum();
  /// Whole stripes, unless nothing follows.
  void add(const std::uint8_t* bytes, std::size_t size);
  std::uint64_t value() const;

 private:
  std::uint64_t keys_[8];
  std::uint64_t sums_[8] = {};
  std::uint64_t size_ = 0;
};

/// Whether all are within 0 .. kMaxWordWeight; -0 is not.
bool all_weights_valid(const double* weights, std::size_t count);

/// nearest[i] = index of the centre nearest to row i (rows[i] if given), the first of equal ones;
/// returns the sum of the distances. Descriptors and centres are `words` 64-bit words long.
std::uint64_t assign_nearest(const std::uint64_t* descriptors, std::size_t words,
                             const std::uint32_t* rows, std::size_t count,
                             const std::uint64_t* centres, std::size_t centre_count,
                             std::uint8_t* nearest);

/// distances[i] = min(distances[i], distance of row rows[i] to the centre); returns their sum.
std::uint64_t lower_distances(const std::uint64_t* descriptors, std::size_t words,
                              const std::uint32_t* rows, std::size_t count,
                              const std::uint64_t* centre, std::uint16_t* distances);

}  // namespace dynslam::loop::detail
