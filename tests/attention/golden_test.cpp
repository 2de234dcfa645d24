// Layers with PyTorch's weights on PyTorch's inputs give PyTorch's outputs, on every kind of vector
// instructions. data/golden.safetensors is written by make_golden.py.
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/attention/cbam.hpp"
#include "dynslam/attention/dfc.hpp"
#include "dynslam/attention/ghost.hpp"
#include "dynslam/attention/mixed_fpn.hpp"
#include "dynslam/attention/reference.hpp"
#include "dynslam/attention/safetensors.hpp"

#include "attention/support.hpp"

namespace dynslam::attention {
namespace {

using testing::for_each_target;
using testing::kTolerance;
using testing::relative_error;
using testing::Result;

const SafeTensors& golden() {
  static const SafeTensors file =
      SafeTensors::read(std::string(DYNSLAM_TEST_DATA_DIR) + "/golden.safetensors");
  return file;
}

TensorBatch<const float> batch(const std::string& name) {
  const NamedTensor& t = golden().at(name);
  return {t.values.data(), static_cast<int>(t.shape.at(0)), static_cast<int>(t.shape.at(1)),
          static_cast<int>(t.shape.at(2)), static_cast<int>(t.shape.at(3))};
}

std::vector<float> values(const std::string& name) {
  const NamedTensor& t = golden().at(name);
  return {t.values.begin(), t.values.end()};
}

/// Runs `layer(result, workspace)` on every target against <name>.output0.
template <typename Layer>
void expect_golden(const std::string& name, const Layer& layer) {
  const TensorBatch<const float> expected = batch(name + ".output0");
  for_each_target([&](const std::string& target) {
    Workspace workspace;
    Result result(expected.batch, expected.channels, expected.height, expected.width);
    layer(result.view, workspace);
    EXPECT_LT(relative_error(result.values, values(name + ".output0")), kTolerance)
        << name << " on " << target;
  });
}

TEST(Golden, DfcAttentionIsPyTorchs) {
  for (const std::string name : {"dfc", "dfc_even"}) {
    const DfcAttention layer(load_dfc(golden(), name + ".weights.dfc."));
    expect_golden(name, [&](TensorBatch<float> out, Workspace& workspace) {
      layer.run(batch(name + ".input0"), batch(name + ".input1"), out, workspace);
    });
  }
}

TEST(Golden, GhostModuleIsPyTorchs) {
  for (const std::string name : {"ghost_relu", "ghost_silu"}) {
    const bool relu = name == "ghost_relu";
    const GhostModule layer(load_ghost_module(
        golden(), name + ".weights.", relu ? Activation::kRelu : Activation::kSilu, relu ? 9 : 0));
    expect_golden(name, [&](TensorBatch<float> out, Workspace& workspace) {
      layer.run(batch(name + ".input0"), out, workspace);
    });
  }
}

TEST(Golden, GhostBottleneckIsPyTorchs) {
  for (const std::string name : {"bottleneck_s1", "bottleneck_s2", "bottleneck_wide"}) {
    const GhostBottleneck layer(load_ghost_bottleneck(golden(), name + ".weights."));
    EXPECT_EQ(layer.stride(), name == "bottleneck_s2" ? 2 : 1);
    expect_golden(name, [&](TensorBatch<float> out, Workspace& workspace) {
      layer.run(batch(name + ".input0"), out, workspace);
    });
  }
}

TEST(Golden, GhostC3IsPyTorchs) {
  for (const std::string name : {"c3_relu", "c3_silu"}) {
    const bool relu = name == "c3_relu";
    const GhostC3 layer(load_ghost_c3(golden(), name + ".weights.",
                                      relu ? Activation::kRelu : Activation::kSilu, relu));
    expect_golden(name, [&](TensorBatch<float> out, Workspace& workspace) {
      layer.run(batch(name + ".input0"), out, workspace);
    });
  }
}

TEST(Golden, CbamIsPyTorchsInBothOrders) {
  for (const std::string name : {"cbam", "cbam_spatial_first", "cbam_plain"}) {
    const Cbam layer(load_cbam(golden(), name + ".weights."), name == "cbam_spatial_first"
                                                                  ? CbamOrder::kSpatialFirst
                                                                  : CbamOrder::kChannelFirst);
    expect_golden(name, [&](TensorBatch<float> out, Workspace& workspace) {
      layer.run(batch(name + ".input0"), out, workspace);
    });
  }
}

TEST(Golden, MixedAttentionPyramidIsPyTorchs) {
  std::vector<FpnLevelWeights> levels;
  std::vector<TensorBatch<const float>> inputs;
  for (int n = 0; n < 3; ++n) {
    levels.push_back(load_fpn_level(golden(), "fpn.weights.levels." + std::to_string(n) + "."));
    inputs.push_back(batch("fpn.input" + std::to_string(n)));
  }
  const MixedAttentionFpn layer(levels);
  for_each_target([&](const std::string& target) {
    std::vector<Result> results;
    std::vector<TensorBatch<float>> outputs;
    for (int n = 0; n < 4; ++n) {
      const TensorBatch<const float> expected = batch("fpn.output" + std::to_string(n));
      results.emplace_back(1, expected.channels, expected.height, expected.width);
    }
    for (Result& result : results) {
      outputs.emplace_back(result.values.data(), 1, result.view.channels, result.view.height,
                           result.view.width);
    }
    Workspace workspace;
    layer.run(inputs, outputs, workspace);
    for (std::size_t n = 0; n < 4; ++n) {
      EXPECT_LT(relative_error(results[n].values, values("fpn.output" + std::to_string(n))),
                kTolerance)
          << target << " P" << n;
    }
  });
}

TEST(Golden, ThePlainLoopsArePyTorchsToo) {
  const auto map = [](const std::string& name) { return reference::Map(batch(name).image(0)); };
  const auto first = [](const std::string& name) {
    return reference::Map(batch(name).image(0)).values;
  };
  EXPECT_LT(relative_error(reference::dfc(map("dfc.input0"), map("dfc.input1"),
                                          load_dfc(golden(), "dfc.weights.dfc."))
                               .values,
                           first("dfc.output0")),
            kTolerance);
  EXPECT_LT(relative_error(reference::ghost_c3(map("c3_relu.input0"),
                                               load_ghost_c3(golden(), "c3_relu.weights."))
                               .values,
                           first("c3_relu.output0")),
            kTolerance);
  EXPECT_LT(relative_error(reference::ghost_bottleneck(
                               map("bottleneck_s2.input0"),
                               load_ghost_bottleneck(golden(), "bottleneck_s2.weights."))
                               .values,
                           first("bottleneck_s2.output0")),
            kTolerance);
  EXPECT_LT(relative_error(reference::cbam(map("cbam.input0"), load_cbam(golden(), "cbam.weights."),
                                           CbamOrder::kChannelFirst)
                               .values,
                           first("cbam.output0")),
            kTolerance);
}

}  // namespace
}  // namespace dynslam::attention
