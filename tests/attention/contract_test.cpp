// What the layers promise besides their results: threads, memory, aliasing, NaN and bad input.
#include <cmath>
#include <limits>
#include <string>
#include <thread>
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
using testing::Random;
using testing::refusal;
using testing::Result;

const float kNan = std::numeric_limits<float>::quiet_NaN();

TensorBatch<float> view(std::vector<float>& values, int batch, int c, int h, int w) {
  return {values.data(), batch, c, h, w};
}

bool says(const std::string& message, const std::string& part) {
  return message.find(part) != std::string::npos;
}

TEST(Layers, WorkInGivenMemoryOfTheStatedSizeAtAnyAlignment) {
  Random random(2);
  const Map map = random.map(6, 9, 11);
  const GhostC3 layer(random.c3(6, 4, 5, 1));
  const std::size_t size = layer.workspace_size(9, 11);
  Workspace owned;
  Result expected(1, 5, 9, 11);
  layer.run(map.view(), expected.view, owned);
  for (const std::size_t offset : {0U, 1U, 3U}) {
    std::vector<float> memory(size + offset + 1, 77.0F);
    Workspace given(Span<float>(memory.data() + offset, size));
    Result result(1, 5, 9, 11);
    layer.run(map.view(), result.view, given);
    EXPECT_EQ(result.values, expected.values);
    EXPECT_EQ(memory.back(), 77.0F);
  }
  std::vector<float> little(size - 1);
  Workspace too_small{Span<float>(little)};
  Result result(1, 5, 9, 11);
  EXPECT_TRUE(
      says(refusal([&] { layer.run(map.view(), result.view, too_small); }), "memory given"));
  EXPECT_EQ(result.values.front(), -12345.0F);
}

TEST(Layers, GiveTheSameBitsOnAnyNumberOfThreads) {
  Random random(3);
  const auto threads = [](int count, Task task) {
    std::vector<std::thread> running;
    for (int i = 0; i < count; ++i) running.emplace_back([task, i] { task(i); });
    for (std::thread& thread : running) thread.join();
  };
  const Map map = random.map(24, 40, 30);
  const DfcAttention dfc(random.dfc(24, 24));
  const GhostC3 c3(random.c3(24, 10, 24, 2));
  const GhostBottleneck bottleneck(random.bottleneck(24, 30, 24, 1));
  const CbamWeights weights = random.cbam(24, 5);
  const auto outputs = [&](Executor executor) {
    std::vector<std::vector<float>> all;
    Workspace workspace;
    Result result(1, 24, 40, 30);
    dfc.run(map.view(), map.view(), result.view, workspace, executor);
    all.push_back(result.values);
    c3.run(map.view(), result.view, workspace, executor);
    all.push_back(result.values);
    bottleneck.run(map.view(), result.view, workspace, executor);
    all.push_back(result.values);
    for (const CbamOrder order : {CbamOrder::kChannelFirst, CbamOrder::kSpatialFirst}) {
      Cbam(weights, order).run(map.view(), result.view, workspace, executor);
      all.push_back(result.values);
    }
    return all;
  };
  const auto alone = outputs({});
  for (const int tasks : {2, 3, 7}) EXPECT_EQ(outputs(Executor(threads, tasks)), alone) << tasks;
}

TEST(Layers, TreatABatchAsItsImages) {
  Random random(4);
  const int n = 3;
  std::vector<float> inputs = random.normals(static_cast<std::size_t>(n * 8 * 7 * 6));
  const GhostC3 layer(random.c3(8, 4, 8, 1));
  Workspace workspace;
  Result together(n, 8, 7, 6);
  const TensorBatch<float> batch = view(inputs, n, 8, 7, 6);
  layer.run(batch, together.view, workspace);
  for (int i = 0; i < n; ++i) {
    Result alone(1, 8, 7, 6);
    layer.run(batch.image(i), alone.view, workspace);
    const float* part = together.view.image(i).data;
    EXPECT_EQ(alone.values, std::vector<float>(part, part + alone.values.size()));
  }
}

TEST(Layers, MayWriteWhereTheyReadWhereTheySaySo) {
  Random random(5);
  const Map map = random.map(8, 12, 14);
  const DfcAttention dfc(random.dfc(8, 8));
  const GhostC3 c3(random.c3(8, 4, 8, 1));
  const CbamWeights weights = random.cbam(8, 2);
  Workspace workspace;
  const auto expect_in_place = [&](const auto& run) {
    Result apart(1, 8, 12, 14);
    run(map.view(), apart.view);
    std::vector<float> values = map.values;
    const TensorBatch<float> same = view(values, 1, 8, 12, 14);
    run(same, same);
    EXPECT_EQ(values, apart.values);
  };
  using In = TensorBatch<const float>;
  using Out = TensorBatch<float>;
  expect_in_place([&](In in, Out out) { dfc.run(in, in, out, workspace); });
  expect_in_place([&](In in, Out out) { dfc.run(map.view(), in, out, workspace); });
  expect_in_place([&](In in, Out out) { c3.run(in, out, workspace); });
  for (const CbamOrder order : {CbamOrder::kChannelFirst, CbamOrder::kSpatialFirst,
                                CbamOrder::kChannelOnly, CbamOrder::kNone}) {
    const Cbam cbam(weights, order);
    expect_in_place([&](In in, Out out) { cbam.run(in, out, workspace); });
  }
}

TEST(Layers, RefuseOutputsThatOverlapTheirInput) {
  Random random(6);
  std::vector<float> memory = random.normals(2 * 4 * 6 * 6);
  const std::vector<float> before = memory;
  const auto in = view(memory, 1, 4, 6, 6);
  const TensorBatch<float> shifted(memory.data() + 5, 1, 4, 6, 6);
  Workspace workspace;
  const GhostModule module(random.ghost(4, 4));
  const GhostBottleneck bottleneck(random.bottleneck(4, 6, 4));
  const GhostC3 c3(random.c3(4, 2, 4, 1));
  const Cbam cbam(random.cbam(4, 2));
  const DfcAttention dfc(random.dfc(4, 4));
  for (const auto& message : {refusal([&] { module.run(in, in, workspace); }),
                              refusal([&] { bottleneck.run(in, in, workspace); }),
                              refusal([&] { c3.run(in, shifted, workspace); }),
                              refusal([&] { cbam.run(in, shifted, workspace); }),
                              refusal([&] { dfc.run(in, in, shifted, workspace); })}) {
    EXPECT_TRUE(says(message, "overlaps")) << message;
  }
  EXPECT_EQ(memory, before);
}

TEST(Layers, RefuseEmptyAndMismatchedViewsByName) {
  Random random(7);
  const Map map = random.map(4, 6, 6);
  const Map wide = random.map(4, 6, 7);
  const Map thin = random.map(3, 6, 6);
  const Map flat = random.map(4, 1, 6);
  Workspace workspace;
  Result result(1, 4, 6, 6);
  const DfcAttention dfc(random.dfc(4, 4));
  const GhostC3 c3(random.c3(4, 2, 4, 1));
  const Cbam cbam(random.cbam(4, 2));
  EXPECT_TRUE(says(refusal([&] { dfc.run({}, map.view(), result.view, workspace); }),
                   "DfcAttention::run: input: got an empty view"));
  EXPECT_TRUE(says(refusal([&] { dfc.run(map.view(), wide.view(), result.view, workspace); }),
                   "features: got 1x4x6x7, expected 1x4x6x6"));
  EXPECT_TRUE(says(refusal([&] { dfc.run(thin.view(), map.view(), result.view, workspace); }),
                   "input.channels: got 3, expected 4"));
  EXPECT_TRUE(says(refusal([&] { dfc.run(flat.view(), flat.view(), result.view, workspace); }),
                   "at least 2"));
  EXPECT_TRUE(says(refusal([&] { c3.run(wide.view(), result.view, workspace); }), "output"));
  EXPECT_TRUE(says(refusal([&] { c3.run(flat.view(), result.view, workspace); }), "at least 2"));
  EXPECT_TRUE(says(refusal([&] { cbam.run(map.view(), {}, workspace); }), "Cbam::run: output"));
  const FullDfcAttention full({1, 2, 2, true, std::vector<float>(4), std::vector<float>(4)});
  EXPECT_TRUE(says(refusal([&] { full.run(map.view(), result.view, workspace); }), "input"));
  EXPECT_EQ(result.values, std::vector<float>(result.values.size(), -12345.0F));
}

TEST(MixedAttentionFpn, RefusesWrongNumbersSizesAndSharedOutputs) {
  Random random(8);
  const std::vector<FpnLevelWeights> levels(
      2, {random.convolution(4, 3, 1, 1), random.cbam(4, 2), random.convolution(4, 4, 3, 3)});
  const MixedAttentionFpn layer(levels);
  const Map fine = random.map(3, 8, 8);
  const Map coarse = random.map(3, 4, 4);
  Result p0(1, 4, 8, 8), p1(1, 4, 4, 4), p2(1, 4, 2, 2);
  Workspace workspace;
  using Ins = std::vector<TensorBatch<const float>>;
  using Outs = std::vector<TensorBatch<float>>;
  const auto message = [&](const Ins& ins, const Outs& outs) {
    return refusal([&] { layer.run(ins, outs, workspace); });
  };
  EXPECT_TRUE(says(message({fine.view()}, {p0.view, p1.view, p2.view}), "inputs.size()"));
  EXPECT_TRUE(says(message({fine.view(), coarse.view()}, {p0.view, p1.view}), "outputs.size()"));
  EXPECT_TRUE(says(message({coarse.view(), fine.view()}, {p1.view, p0.view, p2.view}),
                   "no larger than the level before"));
  EXPECT_TRUE(
      says(message({fine.view(), coarse.view()}, {p0.view, p1.view, p1.view}), "outputs[2]"));
  const TensorBatch<float> inside(p0.values.data(), 1, 4, 4, 4);
  EXPECT_TRUE(says(message({fine.view(), coarse.view()}, {p0.view, inside, p2.view}), "overlaps"));
  EXPECT_THROW(MixedAttentionFpn(Span<const FpnLevelWeights>{}), InvalidArgument);
  EXPECT_THROW(layer.in_channels(2), InvalidArgument);
}

TEST(Weights, ThatDoNotFitTogetherAreRefusedByName) {
  Random random(9);
  const auto expect = [](const std::string& part, const auto& make) {
    const std::string message = refusal(make);
    EXPECT_TRUE(says(message, part)) << message;
  };
  CbamWeights cbam = random.cbam(4, 2);
  cbam.reduced = 5;
  expect("weights.reduced: got 5, expected 1..4", [&] { Cbam{cbam}; });
  cbam = random.cbam(4, 2);
  cbam.output_bias.pop_back();
  expect("weights.output_bias", [&] { Cbam{cbam}; });
  cbam = random.cbam(4, 2);
  cbam.spatial = random.convolution(1, 2, 4, 4);
  expect("odd", [&] { Cbam{cbam}; });
  DfcWeights dfc = random.dfc(3, 4);
  dfc.vertical = random.convolution(4, 1, 1, 5);
  expect("weights.vertical.kernel", [&] { DfcAttention{dfc}; });
  dfc = random.dfc(3, 4);
  dfc.horizontal = random.convolution(5, 1, 1, 5);
  expect("weights.horizontal.out_channels", [&] { DfcAttention{dfc}; });
  dfc = random.dfc(3, 4);
  dfc.pointwise.weight.pop_back();
  expect("weights.pointwise.weight", [&] { DfcAttention{dfc}; });
  GhostModuleWeights ghost = random.ghost(3, 4);
  ghost.out_channels = 5;
  expect("weights.out_channels", [&] { GhostModule{ghost}; });
  GhostBottleneckWeights bottleneck = random.bottleneck(4, 6, 4, 2);
  bottleneck.downsample.reset();
  expect("weights.downsample", [&] { GhostBottleneck{bottleneck}; });
  bottleneck = random.bottleneck(4, 6, 4);
  bottleneck.stride = 3;
  expect("weights.stride", [&] { GhostBottleneck{bottleneck}; });
  bottleneck = random.bottleneck(4, 6, 5);
  bottleneck.shortcut_depthwise.reset();
  bottleneck.shortcut_pointwise.reset();
  expect("channels of the shortcut", [&] { GhostBottleneck{bottleneck}; });
  GhostC3Weights c3 = random.c3(4, 3, 4, 1);
  c3.cv3 = random.convolution(4, 5, 1, 1);
  expect("weights.cv3.group_channels", [&] { GhostC3{c3}; });
  FullDfcWeights full{1, 2, 3, true, std::vector<float>(4), std::vector<float>(8)};
  expect("weights.horizontal", [&] { FullDfcAttention{full}; });
  Convolution conv = random.convolution(2, 1, 1, 1);
  const std::vector<float> two(2, 1.0F), one(1, 1.0F);
  expect("norm.mean", [&] { fold_batch_norm(conv, {two, two, one, two}); });
  expect("norm.epsilon", [&] { fold_batch_norm(conv, {two, two, two, two, 0.0F}); });
  const std::vector<float> negative(2, -1.0F);
  expect("norm.variance", [&] { fold_batch_norm(conv, {two, two, two, negative}); });
}

TEST(Nan, PropagatesAsTheEquationsCarryIt) {
  Random random(10);
  const CbamWeights weights = random.cbam(5, 2);
  const DfcWeights dfc = random.dfc(5, 5);
  const GhostC3Weights c3 = random.c3(5, 4, 5, 1);
  Map map = random.map(5, 12, 14);
  map(3, 4, 5) = kNan;
  const Map clean = random.map(5, 12, 14);
  testing::for_each_target([&](const std::string& target) {
    Workspace workspace;
    Result result(1, 5, 12, 14);
    const auto nans = [&] {
      long count = 0;
      for (const float v : result.values) count += std::isnan(v) ? 1 : 0;
      return count;
    };
    Cbam(weights).run(map.view(), result.view, workspace);
    EXPECT_EQ(nans(), 5 * 12 * 14) << target;
    Cbam(weights, CbamOrder::kSpatialOnly).run(map.view(), result.view, workspace);
    EXPECT_EQ(nans(), 5 * 7 * 7) << target << ": a window of 7x7 around the pixel";
    DfcAttention(dfc).run(map.view(), clean.view(), result.view, workspace);
    EXPECT_EQ(nans(), 5 * (2 * 5) * (2 * 5)) << target << ": 5x5 of the halved map";
    GhostC3(c3).run(map.view(), result.view, workspace);
    EXPECT_LT(testing::relative_error(result.values, reference::ghost_c3(map, c3).values),
              testing::kTolerance)
        << target << ": NaN exactly where the plain loops have it";
  });
}

}  // namespace
}  // namespace dynslam::attention
