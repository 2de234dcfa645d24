#include "dynslam/features/hamming.hpp"

#include "dynslam/core/errors.hpp"

#include "features/hamming_kernels.hpp"

namespace dynslam::features {

int hamming_distance(const std::uint8_t* a, const std::uint8_t* b, std::size_t bytes) {
  return detail::hamming_one(a, b, bytes);
}

void hamming_distances(Span<const std::uint8_t> query, DescriptorsView train,
                       Span<std::int32_t> distances) {
  constexpr const char* where = "hamming_distances";
  const std::size_t rows = train.empty() ? 0 : static_cast<std::size_t>(train.height);
  require(distances.size() == rows, where, "distances.size()", distances.size(), rows);
  if (rows == 0) return;
  require(query.size() == static_cast<std::size_t>(train.width), where, "query.size()",
          query.size(), train.width);
  detail::hamming_many(query.data(), train.data, train.stride_bytes, query.size(), nullptr, rows,
                       distances.data());
}

void hamming_distances(Span<const std::uint8_t> query, DescriptorsView train,
                       Span<const std::int32_t> indices, Span<std::int32_t> distances) {
  constexpr const char* where = "hamming_distances";
  require(distances.size() == indices.size(), where, "distances.size()", distances.size(),
          indices.size());
  if (indices.empty()) return;
  const int rows = train.empty() ? 0 : train.height;
  for (const std::int32_t index : indices) {
    if (index < 0 || index >= rows) {
      throw_invalid_argument(where, "indices[i]", index,
                             "a row of the " + std::to_string(rows) + " train descriptors");
    }
  }
  require(query.size() == static_cast<std::size_t>(train.width), where, "query.size()",
          query.size(), train.width);
  detail::hamming_many(query.data(), train.data, train.stride_bytes, query.size(), indices.data(),
                       indices.size(), distances.data());
}

}  // namespace dynslam::features
