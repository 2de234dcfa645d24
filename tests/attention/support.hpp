// Random layers and maps, and what it means for two maps to be equal.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include "dynslam/attention/reference.hpp"
#include "dynslam/attention/tensor_batch.hpp"
#include "dynslam/attention/weights.hpp"
#include "dynslam/core/errors.hpp"

namespace dynslam::attention::testing {

/// Largest error allowed, relative to the value or, where sums cancel, to the mean magnitude.
inline constexpr double kTolerance = 2e-5;

/// Runs `test(name)` once with each kind of vector instructions that was compiled and that this
/// machine has.
template <typename Test>
void for_each_target(const Test& test) {
  int targets = 0;
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().Update(target);
    test(std::string(hwy::TargetName(target)));
    ++targets;
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
  EXPECT_GT(targets, 0);
}

class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}
  float normal(float scale = 1.0F) { return scale * normal_(engine_); }
  std::vector<float> normals(std::size_t count, float scale = 1.0F) {
    std::vector<float> values(count);
    for (float& v : values) v = normal(scale);
    return values;
  }
  reference::Map map(int channels, int height, int width) {
    reference::Map map(channels, height, width);
    map.values = normals(map.values.size());
    return map;
  }
  Convolution convolution(int out, int group, int kh, int kw, bool bias = true) {
    Convolution c;
    c.out_channels = out;
    c.group_channels = group;
    c.kernel_height = kh;
    c.kernel_width = kw;
    const int taps = group * kh * kw;
    c.weight = normals(static_cast<std::size_t>(out) * static_cast<std::size_t>(taps),
                       1.5F / std::sqrt(static_cast<float>(taps)));
    if (bias) c.bias = normals(static_cast<std::size_t>(out), 0.3F);
    return c;
  }
  DfcWeights dfc(int in, int out, int kernel = 5) {
    return {convolution(out, in, 1, 1), convolution(out, 1, 1, kernel),
            convolution(out, 1, kernel, 1)};
  }
  GhostModuleWeights ghost(int in, int out, Activation activation = Activation::kRelu) {
    GhostModuleWeights w;
    w.primary = convolution((out + 1) / 2, in, 1, 1);
    w.cheap = convolution((out + 1) / 2, 1, 3, 3);
    w.out_channels = out;
    w.activation = activation;
    return w;
  }
  GhostBottleneckWeights bottleneck(int in, int mid, int out, int stride = 1,
                                    Activation activation = Activation::kRelu) {
    GhostBottleneckWeights w;
    w.expand = ghost(in, mid, activation);
    w.attention = dfc(in, mid);
    w.project = ghost(mid, out, Activation::kNone);
    w.stride = stride;
    if (stride == 2) w.downsample = convolution(mid, 1, 3, 3);
    if (stride == 2 || in != out) {
      w.shortcut_depthwise = convolution(in, 1, 3, 3);
      w.shortcut_pointwise = convolution(out, in, 1, 1);
    }
    return w;
  }
  GhostC3Weights c3(int in, int hidden, int out, int count,
                    Activation ghost_activation = Activation::kRelu) {
    GhostC3Weights w;
    w.cv1 = convolution(hidden, in, 1, 1);
    w.cv2 = convolution(hidden, in, 1, 1);
    w.cv3 = convolution(out, 2 * hidden, 1, 1);
    for (int i = 0; i < count; ++i) {
      w.bottlenecks.push_back(bottleneck(hidden, hidden, hidden, 1, ghost_activation));
    }
    return w;
  }
  CbamWeights cbam(int channels, int reduced, int kernel = 7) {
    CbamWeights w;
    w.channels = channels;
    w.reduced = reduced;
    const auto size = static_cast<std::size_t>(channels) * static_cast<std::size_t>(reduced);
    w.hidden_weight = normals(size, 1.0F / std::sqrt(static_cast<float>(channels)));
    w.hidden_bias = normals(static_cast<std::size_t>(reduced), 0.2F);
    w.output_weight = normals(size, 1.0F / std::sqrt(static_cast<float>(reduced)));
    w.output_bias = normals(static_cast<std::size_t>(channels), 0.2F);
    w.spatial = convolution(1, 2, kernel, kernel);
    return w;
  }

 private:
  std::mt19937 engine_;
  std::normal_distribution<float> normal_;
};

/// Largest |a - b| / max(|b|, mean |b|); infinite if one is NaN where the other is not.
inline double relative_error(const std::vector<float>& a, const std::vector<float>& b) {
  if (a.size() != b.size()) return std::numeric_limits<double>::infinity();
  double mean = 0.0;
  for (const float v : b) mean += std::isnan(v) ? 0.0 : std::abs(static_cast<double>(v));
  mean /= static_cast<double>(b.size());
  double worst = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (std::isnan(a[i]) || std::isnan(b[i])) {
      if (std::isnan(a[i]) != std::isnan(b[i])) return std::numeric_limits<double>::infinity();
      continue;
    }
    const double scale = std::max(std::abs(static_cast<double>(b[i])), mean);
    worst = std::max(worst, std::abs(static_cast<double>(a[i]) - b[i]) / scale);
  }
  return worst;
}

inline TensorBatch<const float> batch_of(const reference::Map& map) { return map.view(); }

/// A view of fresh memory for the result, filled with a value that no layer computes.
struct Result {
  std::vector<float> values;
  TensorBatch<float> view;
  Result(int batch, int channels, int height, int width)
      : values(static_cast<std::size_t>(batch) * static_cast<std::size_t>(channels) *
                   static_cast<std::size_t>(height) * static_cast<std::size_t>(width),
               -12345.0F),
        view(values.data(), batch, channels, height, width) {}
};

/// The message of the InvalidArgument that `call` throws; a failure if it throws none.
template <typename Call>
std::string refusal(const Call& call) {
  try {
    call();
  } catch (const InvalidArgument& error) {
    return error.what();
  }
  ADD_FAILURE() << "nothing was thrown";
  return {};
}

}  // namespace dynslam::attention::testing
