// Hamming distances between binary descriptors, vectorized with run-time
// dispatch.
#pragma once

#include <cstddef>
#include <cstdint>

#include "dynslam/core/image_view.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam::features {

/// Number of bits in which two strings of `bytes` bytes differ. Any length, any
/// alignment; 0 for no bytes. O(bytes), no allocation, thread-safe.
int hamming_distance(const std::uint8_t* a, const std::uint8_t* b, std::size_t bytes);

/// distances[i] = distance of `query` to row i of `train`.
///
/// Throws InvalidArgument if `query.size() != train.width` (unless train is
/// empty) or `distances.size() != train.height`. O(rows x bytes), no
/// allocation, thread-safe.
void hamming_distances(Span<const std::uint8_t> query, DescriptorsView train,
                       Span<std::int32_t> distances);

/// distances[i] = distance of `query` to row indices[i] of `train`.
///
/// Throws InvalidArgument as above (with indices.size() for the rows), or if an
/// index is not a row.
void hamming_distances(Span<const std::uint8_t> query, DescriptorsView train,
                       Span<const std::int32_t> indices, Span<std::int32_t> distances);

}  // namespace dynslam::features
