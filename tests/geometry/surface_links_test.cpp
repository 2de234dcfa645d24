#include <cstddef>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/geometry/region_grow.hpp"

namespace dynslam::geometry {
namespace {

TEST(SurfaceLinks, SmoothRowsInStepAsOneAfterTheOther) {
  constexpr int kWidth = 9, kRows = 4;
  std::vector<float> gain(kRows * kWidth), sum(gain.size()), weight(gain.size());
  for (std::size_t i = 0; i < gain.size(); ++i) {
    gain[i] = 0.1F * static_cast<float>(i % 8);
    sum[i] = static_cast<float>(i * i % 11);
    weight[i] = static_cast<float>(i % 5);
  }
  std::vector<float> sum_alone = sum, weight_alone = weight;
  detail::smooth_rows<kRows>(sum.data(), weight.data(), gain.data(), kWidth);
  for (std::size_t i = 0; i < gain.size(); i += kWidth) {
    detail::smooth_rows<1>(&sum_alone[i], &weight_alone[i], &gain[i], kWidth);
  }
  EXPECT_EQ(sum, sum_alone);
  EXPECT_EQ(weight, weight_alone);
}

TEST(SurfaceLinks, SmoothColumnsAsRowsOfTheTransposed) {
  constexpr int kWidth = 7, kHeight = 5;
  std::vector<float> values(kWidth * kHeight), gain(values.size());
  std::vector<float> values_turned(values.size()), gain_turned(values.size());
  for (std::size_t y = 0; y < kHeight; ++y) {
    for (std::size_t x = 0; x < kWidth; ++x) {
      const std::size_t i = y * kWidth + x, turned = x * kHeight + y;
      values[i] = values_turned[turned] = static_cast<float>(i * i % 13);
      gain[i] = gain_turned[turned] = 0.1F * static_cast<float>(i % 9);
    }
  }
  detail::smooth_columns(values, gain, kWidth, kHeight);
  std::vector<float> unused = values_turned;
  for (std::size_t x = 0; x < kWidth * kHeight; x += kHeight) {
    detail::smooth_rows<1>(&values_turned[x], &unused[x], &gain_turned[x], kHeight);
  }
  for (std::size_t y = 0; y < kHeight; ++y) {
    for (std::size_t x = 0; x < kWidth; ++x) {
      EXPECT_EQ(values[y * kWidth + x], values_turned[x * kHeight + y]);
    }
  }
}

}  // namespace
}  // namespace dynslam::geometry
