// Every layer on every kind of vector instructions against the plain loops.
#include <algorithm>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/attention/cbam.hpp"
#include "dynslam/attention/dfc.hpp"
#include "dynslam/attention/ghost.hpp"
#include "dynslam/attention/mixed_fpn.hpp"
#include "dynslam/attention/reference.hpp"

#include "attention/support.hpp"

namespace dynslam::attention {
namespace {

using reference::Map;
using testing::for_each_target;
using testing::kTolerance;
using testing::Random;
using testing::relative_error;
using testing::Result;

struct Shape {
  int in, out, height, width;
};
std::string text(const Shape& s) {
  return std::to_string(s.in) + ">" + std::to_string(s.out) + " " + std::to_string(s.height) + "x" +
         std::to_string(s.width);
}

TEST(DfcAttention, EqualsThePlainLoopsForAnySize) {
  Random random(1);
  for (const Shape& s : {Shape{1, 1, 2, 2}, Shape{3, 5, 7, 9}, Shape{16, 16, 8, 64},
                         Shape{5, 8, 33, 2}, Shape{8, 17, 2, 67}, Shape{24, 12, 20, 20}}) {
    const DfcWeights weights = random.dfc(s.in, s.out);
    const Map input = random.map(s.in, s.height, s.width);
    const Map features = random.map(s.out, s.height, s.width);
    const Map expected = reference::dfc(input, features, weights);
    for_each_target([&](const std::string& target) {
      const DfcAttention layer(weights);
      Workspace workspace;
      Result result(1, s.out, s.height, s.width);
      layer.run(input.view(), features.view(), result.view, workspace);
      EXPECT_LT(relative_error(result.values, expected.values), kTolerance)
          << target << " " << text(s);
    });
  }
}

TEST(DfcAttention, TakesWindowsOtherThanFive) {
  Random random(2);
  for (const int kernel : {1, 3, 9}) {
    const DfcWeights weights = random.dfc(6, 6, kernel);
    const Map input = random.map(6, 11, 14);
    const Map expected = reference::dfc(input, input, weights);
    for_each_target([&](const std::string& target) {
      Workspace workspace;
      Result result(1, 6, 11, 14);
      DfcAttention(weights).run(input.view(), input.view(), result.view, workspace);
      EXPECT_LT(relative_error(result.values, expected.values), kTolerance) << target << kernel;
    });
  }
}

TEST(FullDfcAttention, EqualsThePlainLoopsSharedAndNot) {
  Random random(3);
  for (const bool shared : {true, false}) {
    for (const Shape& s : {Shape{1, 1, 1, 1}, Shape{3, 3, 5, 19}, Shape{2, 2, 17, 16}}) {
      FullDfcWeights weights{s.in, s.height, s.width, shared, {}, {}};
      const auto c = static_cast<std::size_t>(s.in);
      const auto h = static_cast<std::size_t>(s.height);
      const auto w = static_cast<std::size_t>(s.width);
      weights.vertical = random.normals(c * h * h * (shared ? 1 : w));
      weights.horizontal = random.normals(c * w * w * (shared ? 1 : h));
      const Map input = random.map(s.in, s.height, s.width);
      const Map expected = reference::full_dfc(input, weights);
      for_each_target([&](const std::string& target) {
        const FullDfcAttention layer(weights);
        Workspace workspace;
        Result result(1, s.in, s.height, s.width);
        layer.run(input.view(), result.view, workspace);
        EXPECT_LT(relative_error(result.values, expected.values), kTolerance)
            << target << " " << text(s) << shared;
      });
    }
  }
}

TEST(FullDfcAttention, WithBandedKernelsIsTheDeployedPairOfDepthwiseConvolutions) {
  Random random(4);
  const Map input = random.map(2, 9, 13);
  const Convolution vertical = random.convolution(2, 1, 5, 1, false);
  const Convolution horizontal = random.convolution(2, 1, 1, 5, false);
  FullDfcWeights weights{2, 9, 13, true, std::vector<float>(2 * 81), std::vector<float>(2 * 169)};
  for (int c = 0; c < 2; ++c) {
    for (int i = 0; i < 13; ++i) {
      for (int k = 0; k < 5; ++k) {
        const int j = i + k - 2;
        const auto tap = static_cast<std::size_t>(5 * c + k);
        if (i < 9 && j >= 0 && j < 9) {
          weights.vertical[static_cast<std::size_t>(81 * c + 9 * i + j)] = vertical.weight[tap];
        }
        if (j >= 0 && j < 13) {
          weights.horizontal[static_cast<std::size_t>(169 * c + 13 * i + j)] =
              horizontal.weight[tap];
        }
      }
    }
  }
  const Map expected = reference::convolve(reference::convolve(input, vertical), horizontal);
  Workspace workspace;
  Result result(1, 2, 9, 13);
  FullDfcAttention(weights).run(input.view(), result.view, workspace);
  EXPECT_LT(relative_error(result.values, expected.values), kTolerance);
}

TEST(GhostModule, EqualsThePlainLoopsForAnySize) {
  Random random(5);
  for (const Activation activation : {Activation::kNone, Activation::kRelu, Activation::kSilu}) {
    for (const Shape& s : {Shape{1, 1, 1, 1}, Shape{3, 7, 5, 11}, Shape{16, 32, 9, 50},
                           Shape{20, 18, 1, 65}, Shape{33, 40, 12, 3}}) {
      const GhostModuleWeights weights = random.ghost(s.in, s.out, activation);
      const Map input = random.map(s.in, s.height, s.width);
      const Map expected = reference::ghost_module(input, weights);
      for_each_target([&](const std::string& target) {
        Workspace workspace;
        Result result(1, s.out, s.height, s.width);
        GhostModule(weights).run(input.view(), result.view, workspace);
        EXPECT_LT(relative_error(result.values, expected.values), kTolerance)
            << target << " " << text(s);
      });
    }
  }
}

TEST(GhostBottleneck, EqualsThePlainLoopsWithBothStrides) {
  Random random(6);
  for (const int stride : {1, 2}) {
    for (const Shape& s :
         {Shape{4, 4, 6, 10}, Shape{3, 5, 7, 9}, Shape{12, 16, 20, 33}, Shape{5, 5, 2, 3}}) {
      const GhostBottleneckWeights weights = random.bottleneck(s.in, 2 * s.in + 1, s.out, stride);
      const Map input = random.map(s.in, s.height, s.width);
      const Map expected = reference::ghost_bottleneck(input, weights);
      for_each_target([&](const std::string& target) {
        const GhostBottleneck layer(weights);
        Workspace workspace;
        Result result(1, s.out, layer.output_size(s.height), layer.output_size(s.width));
        layer.run(input.view(), result.view, workspace);
        EXPECT_LT(relative_error(result.values, expected.values), kTolerance)
            << target << " " << text(s) << " stride " << stride;
      });
    }
  }
}

TEST(GhostBottleneck, WithoutAttentionOrShortcutIsStillTheEquation) {
  Random random(7);
  GhostBottleneckWeights weights = random.bottleneck(6, 10, 6);
  weights.attention.reset();
  weights.shortcut = false;
  const Map input = random.map(6, 1, 5);
  const Map expected = reference::ghost_bottleneck(input, weights);
  Workspace workspace;
  Result result(1, 6, 1, 5);
  GhostBottleneck(weights).run(input.view(), result.view, workspace);
  EXPECT_LT(relative_error(result.values, expected.values), kTolerance);
}

TEST(GhostC3, EqualsThePlainLoopsForAnySize) {
  Random random(8);
  for (const Activation activation : {Activation::kRelu, Activation::kSilu}) {
    for (const Shape& s : {Shape{8, 8, 6, 8}, Shape{5, 9, 15, 21}, Shape{32, 16, 20, 20}}) {
      GhostC3Weights weights = random.c3(s.in, s.out / 2 + 1, s.out, 2, activation);
      weights.bottlenecks.back().shortcut = false;
      const Map input = random.map(s.in, s.height, s.width);
      const Map expected = reference::ghost_c3(input, weights);
      for_each_target([&](const std::string& target) {
        Workspace workspace;
        Result result(1, s.out, s.height, s.width);
        GhostC3(weights).run(input.view(), result.view, workspace);
        EXPECT_LT(relative_error(result.values, expected.values), kTolerance)
            << target << " " << text(s);
      });
    }
  }
}

TEST(Cbam, EqualsThePlainLoopsInEveryOrder) {
  Random random(9);
  for (const CbamOrder order :
       {CbamOrder::kChannelFirst, CbamOrder::kSpatialFirst, CbamOrder::kChannelOnly,
        CbamOrder::kSpatialOnly, CbamOrder::kNone}) {
    for (const Shape& s :
         {Shape{1, 1, 1, 1}, Shape{3, 2, 5, 7}, Shape{18, 4, 20, 33}, Shape{67, 16, 3, 16}}) {
      const CbamWeights weights = random.cbam(s.in, std::min(s.in, s.out), s.height == 5 ? 3 : 7);
      const Map input = random.map(s.in, s.height, s.width);
      const Map expected = reference::cbam(input, weights, order);
      for_each_target([&](const std::string& target) {
        Workspace workspace;
        Result result(1, s.in, s.height, s.width);
        Cbam(weights, order).run(input.view(), result.view, workspace);
        EXPECT_LT(relative_error(result.values, expected.values), kTolerance)
            << target << " " << text(s) << " order " << static_cast<int>(order);
      });
    }
  }
}

TEST(Cbam, OfAMapLargerThanTheCachesIsTheSame) {
  // 64 x 200 x 200: several bands, and written past the caches.
  Random random(10);
  const CbamWeights weights = random.cbam(64, 4);
  const Map input = random.map(64, 200, 200);
  for (const CbamOrder order : {CbamOrder::kChannelFirst, CbamOrder::kSpatialFirst}) {
    const Map expected = reference::cbam(input, weights, order);
    std::vector<float> shifted(input.values.size() + 3);
    const TensorBatch<float> output(shifted.data() + 3, 1, 64, 200, 200);
    Workspace workspace;
    Cbam(weights, order).run(input.view(), output, workspace);
    EXPECT_LT(relative_error({shifted.begin() + 3, shifted.end()}, expected.values), kTolerance);
  }
}

TEST(MixedAttentionFpn, EqualsThePlainLoopsWithOddLevels) {
  Random random(11);
  const int channels = 12;
  std::vector<FpnLevelWeights> levels;
  std::vector<Map> inputs;
  const std::vector<Shape> shapes = {{5, 0, 25, 31}, {9, 0, 13, 16}, {17, 0, 7, 8}, {20, 0, 3, 4}};
  for (const Shape& s : shapes) {
    levels.push_back({random.convolution(channels, s.in, 1, 1), random.cbam(channels, 3),
                      random.convolution(channels, channels, 3, 3)});
    inputs.push_back(random.map(s.in, s.height, s.width));
  }
  const std::vector<Map> expected = reference::mixed_fpn(inputs, levels);
  for_each_target([&](const std::string& target) {
    const MixedAttentionFpn layer(levels);
    std::vector<TensorBatch<const float>> from;
    std::vector<Result> results;
    std::vector<TensorBatch<float>> to;
    for (const Map& map : inputs) from.emplace_back(map.view());
    for (const Map& map : expected) results.emplace_back(1, channels, map.height, map.width);
    for (Result& result : results) {
      to.emplace_back(result.values.data(), 1, channels, result.view.height, result.view.width);
    }
    Workspace workspace;
    layer.run(from, to, workspace);
    for (std::size_t n = 0; n < expected.size(); ++n) {
      EXPECT_LT(relative_error(results[n].values, expected[n].values), kTolerance) << target << n;
    }
  });
}

}  // namespace
}  // namespace dynslam::attention
