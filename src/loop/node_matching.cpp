#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>

#include "dynslam/core/errors.hpp"
#include "dynslam/loop/verification.hpp"

namespace dynslam::loop {
namespace {

int bits(std::uint64_t x) {
  x -= (x >> 1) & 0x5555555555555555ULL;
  x = (x & 0x3333333333333333ULL) + ((x >> 2) & 0x3333333333333333ULL);
  x = (x + (x >> 4)) & 0x0F0F0F0F0F0F0F0FULL;
  return static_cast<int>((x * 0x0101010101010101ULL) >> 56);
}

int distance(const std::uint8_t* a, const std::uint8_t* b, std::size_t bytes) {
  int sum = 0;
  for (std::size_t i = 0; i < bytes; i += 8) {
    std::uint64_t x = 0, y = 0;
    const std::size_t n = bytes - i < 8 ? bytes - i : 8;
    std::memcpy(&x, a + i, n);
    std::memcpy(&y, b + i, n);
    sum += bits(x ^ y);
  }
  return sum;
}

void check_rows(const char* parameter, const FeatureVector& index, DescriptorsView descriptors) {
  for (const std::uint32_t row : index.all_features()) {
    require(static_cast<std::int64_t>(row) < descriptors.height, "match_by_nodes", parameter, row,
            "a row of " + std::to_string(descriptors.height) + " descriptors");
  }
}

struct Nearest {
  std::int32_t row = -1;
  int distance = std::numeric_limits<int>::max();
  int second = std::numeric_limits<int>::max();

  void offer(std::int32_t other, int d) {
    if (d < distance) {
      second = distance;
      distance = d;
      row = other;
    } else if (d < second) {
      second = d;
    }
  }
};

}  // namespace

void NodeMatchOptions::validate() const {
  require(max_distance >= 0.0 && max_distance <= 1.0, "NodeMatchOptions", "max_distance",
          max_distance, "a share in [0, 1]");
  require(ratio > 0.0 && ratio <= 1.0, "NodeMatchOptions", "ratio", ratio, "a number in (0, 1]");
}

void match_by_nodes(const FeatureVector& query_index, DescriptorsView query,
                    const FeatureVector& train_index, DescriptorsView train,
                    const NodeMatchOptions& options, std::vector<Match>& matches) {
  options.validate();
  check_rows("query_index", query_index, query);
  check_rows("train_index", train_index, train);
  if (query_index.empty() || train_index.empty()) {
    matches.clear();
    return;
  }
  require(query.width == train.width, "match_by_nodes", "train descriptors", train.width,
          std::to_string(query.width) + " bytes as the query's");
  const auto bytes = static_cast<std::size_t>(query.width);
  std::vector<Nearest> of_query(static_cast<std::size_t>(query.height));
  std::vector<Nearest> of_train(static_cast<std::size_t>(train.height));
  std::size_t i = 0, j = 0;
  while (i < query_index.size() && j < train_index.size()) {
    if (query_index.node(i) < train_index.node(j)) {
      ++i;
    } else if (train_index.node(j) < query_index.node(i)) {
      ++j;
    } else {
      for (const std::uint32_t q : query_index.features(i)) {
        const std::uint8_t* const descriptor = query.row(static_cast<int>(q));
        for (const std::uint32_t t : train_index.features(j)) {
          const int d = distance(descriptor, train.row(static_cast<int>(t)), bytes);
          of_query[q].offer(static_cast<std::int32_t>(t), d);
          of_train[t].offer(static_cast<std::int32_t>(q), d);
        }
      }
      ++i, ++j;
    }
  }
  matches.clear();
  const double most = options.max_distance * 8.0 * static_cast<double>(bytes);
  for (std::size_t q = 0; q < of_query.size(); ++q) {
    const Nearest& best = of_query[q];
    if (best.row < 0 || best.distance > most) continue;
    if (options.ratio < 1.0 && best.second != std::numeric_limits<int>::max() &&
        best.distance >= options.ratio * best.second)
      continue;
    if (options.mutual &&
        of_train[static_cast<std::size_t>(best.row)].row != static_cast<std::int32_t>(q))
      continue;
    Match match;
    match.query = static_cast<std::int32_t>(q);
    match.train = best.row;
    match.distance = static_cast<float>(best.distance);
    matches.push_back(match);
  }
}

}  // namespace dynslam::loop
