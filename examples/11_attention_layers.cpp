// Runs the attention layers on a made-up feature map, in one thread and in two, beside the plain
// loops that say what they compute.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <random>
#include <thread>
#include <vector>

#include "dynslam/attention/cbam.hpp"
#include "dynslam/attention/dfc.hpp"
#include "dynslam/attention/reference.hpp"

namespace attention = dynslam::attention;

namespace {

std::mt19937 random_bits(1);

std::vector<float> noise(int count, float scale) {
  std::normal_distribution<float> normal(0.0F, scale);
  std::vector<float> values(static_cast<std::size_t>(count));
  for (float& v : values) v = normal(random_bits);
  return values;
}

/// What a weights file would hold: attention::load_dfc(SafeTensors::read(path), "prefix.").
attention::DfcWeights made_up_dfc(int channels) {
  attention::DfcWeights weights;
  weights.pointwise = {channels, channels, 1, 1, noise(channels * channels, 0.1F), {}};
  weights.horizontal = {channels, 1, 1, 5, noise(channels * 5, 0.5F), {}};
  weights.vertical = {channels, 1, 5, 1, noise(channels * 5, 0.5F), {}};
  return weights;
}

attention::CbamWeights made_up_cbam(int channels) {
  attention::CbamWeights weights;
  weights.channels = channels;
  weights.reduced = channels / 16;
  weights.hidden_weight = noise(channels * weights.reduced, 0.1F);
  weights.output_weight = noise(channels * weights.reduced, 0.5F);
  weights.spatial = {1, 2, 7, 7, noise(98, 0.2F), {}};
  return weights;
}

float largest_difference(const std::vector<float>& a, const std::vector<float>& b) {
  float largest = 0.0F;
  for (std::size_t i = 0; i < a.size(); ++i) largest = std::max(largest, std::abs(a[i] - b[i]));
  return largest;
}

template <typename Run>
double milliseconds(const Run& run) {
  run();
  const auto start = std::chrono::steady_clock::now();
  for (int i = 0; i < 20; ++i) run();
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start)
             .count() /
         20;
}

}  // namespace

int main() {
  attention::reference::Map map(64, 40, 40);
  map.values = noise(64 * 40 * 40, 1.0F);
  std::vector<float> result(map.values.size());
  const attention::TensorBatch<float> output(result.data(), 1, 64, 40, 40);

  const attention::DfcAttention dfc(made_up_dfc(64));
  attention::Workspace workspace;
  workspace.reserve(dfc.workspace_size(40, 40));  // from here on nothing is allocated
  dfc.run(map.view(), map.view(), output, workspace);

  const auto plain = attention::reference::dfc(map, map, [] {
    random_bits.seed(1);
    noise(64 * 40 * 40, 1.0F);
    return made_up_dfc(64);
  }());
  std::printf("DFC 64x40x40: %.3f ms, largest difference from the plain loops %.1e\n",
              milliseconds([&] { dfc.run(map.view(), map.view(), output, workspace); }),
              static_cast<double>(largest_difference(result, plain.values)));

  // The caller's threads: anything that can run tasks.
  const auto two_threads = [](int count, attention::Task task) {
    std::vector<std::thread> threads;
    for (int i = 1; i < count; ++i) threads.emplace_back([task, i] { task(i); });
    task(0);
    for (std::thread& thread : threads) thread.join();
  };
  const std::vector<float> alone = result;
  dfc.run(map.view(), map.view(), output, workspace, attention::Executor(two_threads, 2));
  std::printf("on two threads: %s\n", result == alone ? "the same bits" : "other bits");

  const auto weights = made_up_cbam(64);
  for (const auto order :
       {attention::CbamOrder::kChannelFirst, attention::CbamOrder::kSpatialFirst}) {
    const attention::Cbam cbam(weights, order);
    const double ms = milliseconds([&] { cbam.run(map.view(), output, workspace); });
    std::printf("CBAM, %s attention first: %.3f ms, largest difference %.1e\n",
                order == attention::CbamOrder::kChannelFirst ? "channel" : "spatial", ms,
                static_cast<double>(largest_difference(
                    result, attention::reference::cbam(map, weights, order).values)));
  }
}
