#include "loop/quicklz.hpp"

#include <random>

#include <gtest/gtest.h>

namespace dynslam::loop::detail {
namespace {

std::vector<std::uint8_t> sample(std::size_t size, unsigned letters, unsigned seed) {
  std::mt19937 random(seed);
  std::vector<std::uint8_t> bytes(size);
  for (auto& byte : bytes) byte = static_cast<std::uint8_t>(random() % letters);
  return bytes;
}

TEST(QuickLz, UnpacksWhatItPacked) {
  for (const std::size_t size : {1U, 2U, 3U, 11U, 12U, 40U, 1000U, 10000U}) {
    for (const unsigned letters : {1U, 2U, 5U, 40U, 256U}) {
      const auto bytes = sample(size, letters, 3);
      std::vector<std::uint8_t> packet = {9};  // what was there before stays
      pack_quicklz(bytes, packet);
      packet.erase(packet.begin());
      EXPECT_LE(packet.size(), size + kLongQuickLzHeader);
      std::vector<std::uint8_t> out = {1, 2};
      ASSERT_TRUE(unpack_quicklz(packet, out)) << size << ' ' << letters;
      out.erase(out.begin(), out.begin() + 2);
      EXPECT_EQ(out, bytes);
      if (size == 10000U && letters <= 5U) {
        EXPECT_LT(packet.size(), size * 3 / 4);
      }
    }
  }
}

TEST(QuickLz, RefusesEveryCutAndSurvivesEveryFlippedBit) {
  const auto bytes = sample(300, 3, 4);
  std::vector<std::uint8_t> packet;
  pack_quicklz(bytes, packet);
  std::vector<std::uint8_t> out;
  for (std::size_t size = 0; size < packet.size(); ++size) {
    EXPECT_FALSE(unpack_quicklz({packet.data(), size}, out));
    EXPECT_TRUE(out.empty());
  }
  for (std::size_t bit = 0; bit < packet.size() * 8; ++bit) {
    auto flipped = packet;
    flipped[bit / 8] ^= static_cast<std::uint8_t>(1U << (bit % 8));
    const auto header = read_quicklz_header(flipped);
    if (header && header->unpacked_bytes > 100000) continue;  // callers refuse those
    out.clear();
    if (!unpack_quicklz(flipped, out)) {
      EXPECT_TRUE(out.empty());
    }
  }
}

}  // namespace
}  // namespace dynslam::loop::detail
