// The layers beside libtorch, ONNX Runtime and oneDNN, one thread each, at the sizes of
// BENCHMARK.md. Graphs, weights, inputs and expected outputs come from PyTorch: the directory is
// the environment's DYNSLAM_ATTENTION_MODELS, filled by
//
//   python3 tests/attention/export_onnx.py <directory> --jit
//
// Every result is checked before it is timed.
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <benchmark/benchmark.h>

#include "dynslam/attention/cbam.hpp"
#include "dynslam/attention/dfc.hpp"
#include "dynslam/attention/ghost.hpp"
#include "dynslam/attention/safetensors.hpp"

#include "rivals.hpp"

namespace dynslam::attention::bench {

#ifndef DYNSLAM_BENCH_TORCH
std::unique_ptr<Rival> make_torch(const std::string&, const SafeTensors&) { return nullptr; }
#endif
#ifndef DYNSLAM_BENCH_ONNXRUNTIME
std::unique_ptr<Rival> make_onnxruntime(const std::string&, const SafeTensors&, bool) {
  return nullptr;
}
#endif
#ifndef DYNSLAM_BENCH_ONEDNN
std::unique_ptr<Rival> make_onednn_dfc(const SafeTensors&, bool) { return nullptr; }
#endif

namespace {

struct Model {
  std::string stem;
  SafeTensors data;
};

TensorBatch<const float> batch(const NamedTensor& t) {
  return {t.values.data(), static_cast<int>(t.shape[0]), static_cast<int>(t.shape[1]),
          static_cast<int>(t.shape[2]), static_cast<int>(t.shape[3])};
}

/// dynslam's own layer, workspace owned and warm.
class Ours final : public Rival {
 public:
  explicit Ours(const Model& model) : model_(model) {
    const NamedTensor& expected = model.data.at("output0");
    values_.resize(expected.values.size());
    const auto shape = batch(expected);
    output_ = {values_.data(), shape.batch, shape.channels, shape.height, shape.width};
    const std::string name = std::filesystem::path(model.stem).filename();
    const SafeTensors& file = model.data;
    const auto input = batch(file.at("input0"));
    if (name.rfind("dfc", 0) == 0) {
      run_ = [this, input, features = batch(file.at("input1")),
              layer = DfcAttention(load_dfc(file, "weights.dfc."))] {
        layer.run(input, features, output_, workspace_);
      };
    } else if (name.rfind("c3", 0) == 0) {
      run_ = [this, input, layer = GhostC3(load_ghost_c3(file, "weights."))] {
        layer.run(input, output_, workspace_);
      };
    } else {
      run_ = [this, input, layer = Cbam(load_cbam(file, "weights."))] {
        layer.run(input, output_, workspace_);
      };
    }
  }
  void run() override { run_(); }
  const float* output() override { return values_.data(); }

 private:
  const Model& model_;
  std::vector<float> values_;
  TensorBatch<float> output_;
  Workspace workspace_;
  std::function<void()> run_;
};

/// Three readings of the input and one writing of the output and nothing else.
class MemoryFloor final : public Rival {
 public:
  explicit MemoryFloor(const Model& model)
      : input_(model.data.at("input0").values), copy_(input_.size()) {}
  void run() override {
    sum();
    sum();
    std::memcpy(copy_.data(), input_.data(), input_.size() * sizeof(float));
    benchmark::ClobberMemory();
  }
  const float* output() override { return nullptr; }

 private:
  void sum() {
    float sums[32] = {};
    const float* at = input_.data();
    for (std::size_t i = 0; i + 32 <= input_.size(); i += 32) {
      for (std::size_t k = 0; k < 32; ++k) sums[k] += at[i + k];
    }
    benchmark::DoNotOptimize(sums);
  }
  Span<const float> input_;
  std::vector<float> copy_;
};

double worst_error(const float* got, const NamedTensor& expected) {
  double mean = 0.0;
  for (const float v : expected.values) mean += std::abs(v);
  mean /= static_cast<double>(expected.values.size());
  double worst = 0.0;
  for (std::size_t i = 0; i < expected.values.size(); ++i) {
    const double scale = std::max<double>(std::abs(expected.values[i]), mean);
    worst = std::max(worst, std::abs(static_cast<double>(got[i]) - expected.values[i]) / scale);
  }
  return worst;
}

using Maker = std::function<std::unique_ptr<Rival>(const Model&)>;

void time_one(benchmark::State& state, const std::string& stem, const Maker& make) {
  if (!std::filesystem::exists(stem + ".safetensors")) {
    state.SkipWithError("export the models first, see BENCHMARK.md");
    return;
  }
  const Model model{stem, SafeTensors::read(stem + ".safetensors")};
  const std::unique_ptr<Rival> rival = make(model);
  if (rival == nullptr) {
    state.SkipWithError("this build does not have it");
    return;
  }
  rival->run();
  if (const float* got = rival->output()) {
    const double error = worst_error(got, model.data.at("output0"));
    if (!(error < 2e-5)) {
      state.SkipWithError(("wrong result, error " + std::to_string(error)).c_str());
      return;
    }
  }
  for (auto _ : state) rival->run();
}

void add(const std::string& name, const std::string& who, const Maker& make) {
  const char* folder = std::getenv("DYNSLAM_ATTENTION_MODELS");
  const std::string stem =
      std::string(folder == nullptr ? "attention_models" : folder) + "/" + name;
  benchmark::RegisterBenchmark((name + "/" + who).c_str(), [stem, make](benchmark::State& state) {
    time_one(state, stem, make);
  })->Unit(benchmark::kMillisecond);
}

const bool registered = [] {
  const Maker ours = [](const Model& m) { return std::make_unique<Ours>(m); };
  const Maker floor = [](const Model& m) { return std::make_unique<MemoryFloor>(m); };
  const Maker torch = [](const Model& m) { return make_torch(m.stem, m.data); };
  const Maker ort = [](const Model& m) { return make_onnxruntime(m.stem, m.data, false); };
  const Maker ort_fused = [](const Model& m) { return make_onnxruntime(m.stem, m.data, true); };
  const Maker onednn = [](const Model& m) { return make_onednn_dfc(m.data, false); };
  const Maker onednn_all = [](const Model& m) { return make_onednn_dfc(m.data, true); };
  for (const char* name :
       {"dfc_64x80", "dfc_128x40", "dfc_256x20", "c3_64x80", "c3_64x40", "c3_128x80", "c3_128x40",
        "cbam_256x160", "cbam_512x80", "cbam_1024x40", "cbam_2048x20"}) {
    add(name, "dynslam", ours);
    add(name, "onnxruntime", ort);
    add(name, "onnxruntime_fused", ort_fused);
    add(name, "libtorch", torch);
    if (name[0] == 'd') {
      add(name, "onednn_blocked", onednn);
      add(name, "onednn_with_reorders", onednn_all);
    }
    if (std::string(name).rfind("cbam", 0) == 0) add(name, "memory_floor", floor);
  }
  return true;
}();

}  // namespace
}  // namespace dynslam::attention::bench
