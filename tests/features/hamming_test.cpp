#include "dynslam/features/hamming.hpp"

#include <bitset>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/features/hamming_reference.hpp"

#include "features/support.hpp"

namespace dynslam::features {
namespace {

using testing::for_each_target;

std::vector<std::uint8_t> random_bytes(std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  std::vector<std::uint8_t> bytes(count);
  for (std::uint8_t& byte : bytes) byte = static_cast<std::uint8_t>(random());
  return bytes;
}

TEST(HammingReference, CountsTheBitsThatDiffer) {
  const std::vector<std::uint8_t> a = random_bytes(100, 1);
  const std::vector<std::uint8_t> b = random_bytes(100, 2);
  std::size_t expected = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    expected += std::bitset<8>(static_cast<unsigned>(a[i] ^ b[i])).count();
  }
  EXPECT_EQ(hamming_distance_reference(a.data(), b.data(), 100), static_cast<int>(expected));
  static constexpr std::uint8_t kZeros[2] = {0, 0};
  static constexpr std::uint8_t kNine[2] = {255, 1};
  static_assert(hamming_distance_reference(kZeros, kNine, 2) == 9);
}

TEST(HammingDistance, EqualsTheReferenceOnAllTargetsForEveryLengthAndAlignment) {
  const std::vector<std::uint8_t> a = random_bytes(600, 3);
  const std::vector<std::uint8_t> b = random_bytes(600, 4);
  for_each_target([&](const std::string& target) {
    for (std::size_t bytes = 0; bytes <= 130; ++bytes) {
      for (const std::size_t offset : {0U, 1U, 7U}) {
        EXPECT_EQ(hamming_distance(a.data() + offset, b.data() + 2 * offset, bytes),
                  hamming_distance_reference(a.data() + offset, b.data() + 2 * offset, bytes))
            << target << " " << bytes;
      }
    }
  });
}

TEST(HammingDistance, OfNothingIsZeroAndOfOppositesAllBits) {
  EXPECT_EQ(hamming_distance(nullptr, nullptr, 0), 0);
  const std::vector<std::uint8_t> zeros(64, 0);
  const std::vector<std::uint8_t> ones(64, 255);
  EXPECT_EQ(hamming_distance(zeros.data(), ones.data(), 64), 512);
}

TEST(HammingDistances, EqualTheReferenceOnAllTargetsForRowsWithGaps) {
  for (const int width : {1, 8, 31, 32, 33, 48, 61, 64, 300}) {
    const std::vector<std::uint8_t> bytes =
        random_bytes(static_cast<std::size_t>(width + 5) * 20, 5);
    const DescriptorsView train(bytes.data(), width, 20, width + 5);
    const std::vector<std::uint8_t> query = random_bytes(static_cast<std::size_t>(width), 6);
    const std::vector<std::int32_t> rows = {19, 3, 3, 0};
    for_each_target([&](const std::string& target) {
      std::vector<std::int32_t> all(20);
      hamming_distances(query, train, all);
      for (int i = 0; i < 20; ++i) {
        EXPECT_EQ(all[static_cast<std::size_t>(i)],
                  hamming_distance_reference(query.data(), train.row(i), query.size()))
            << target << " " << width;
      }
      std::vector<std::int32_t> some(4);
      hamming_distances(query, train, rows, some);
      for (std::size_t i = 0; i < rows.size(); ++i) {
        EXPECT_EQ(some[i], all[static_cast<std::size_t>(rows[i])]) << target << " " << width;
      }
    });
  }
}

TEST(HammingDistances, ToNoRowsAreNone) {
  std::vector<std::int32_t> none;
  const std::vector<std::uint8_t> query(32);
  hamming_distances(query, {}, none);
  hamming_distances(query, {}, Span<const std::int32_t>(), none);
  EXPECT_TRUE(none.empty());
}

TEST(HammingDistances, RefuseSizesThatDisagreeAndIndicesThatAreNoRows) {
  const std::vector<std::uint8_t> bytes(320);
  const DescriptorsView train(bytes.data(), 32, 10);
  const std::vector<std::uint8_t> query(32);
  const std::vector<std::uint8_t> short_query(31);
  std::vector<std::int32_t> ten(10, -7);
  std::vector<std::int32_t> nine(9, -7);
  EXPECT_THROW(hamming_distances(query, train, nine), InvalidArgument);
  EXPECT_THROW(hamming_distances(short_query, train, ten), InvalidArgument);
  const std::vector<std::int32_t> rows(10, 9);
  const std::vector<std::int32_t> beyond = {0, 10};
  const std::vector<std::int32_t> negative = {0, -1};
  std::vector<std::int32_t> two(2, -7);
  EXPECT_THROW(hamming_distances(query, train, rows, nine), InvalidArgument);
  EXPECT_THROW(hamming_distances(short_query, train, rows, ten), InvalidArgument);
  EXPECT_THROW(hamming_distances(query, train, beyond, two), InvalidArgument);
  EXPECT_THROW(hamming_distances(query, train, negative, two), InvalidArgument);
  for (const std::int32_t value : ten) EXPECT_EQ(value, -7);
  for (const std::int32_t value : two) EXPECT_EQ(value, -7);
}

}  // namespace
}  // namespace dynslam::features
