// Vocabulary of 863,000 words: opening, describing an image, training.
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include <benchmark/benchmark.h>
#include <unistd.h>

#include "dynslam/loop/vocabulary_io.hpp"
#include "dynslam/loop/vocabulary_training.hpp"

#include "grown_vocabulary.hpp"

namespace dynslam::loop {
namespace {

constexpr std::size_t kWords = 863000;
constexpr std::size_t kFeatures = 1000;
constexpr std::size_t kImages = 64;

DescriptorsView view_of(const std::vector<std::uint8_t>& bytes) {
  return {bytes.data(), 32, static_cast<int>(bytes.size() / 32)};
}

/// The vocabulary in memory and in a file, and images.
struct Data {
  Data() : path("grown_" + std::to_string(::getpid()) + ".dynvoc") {
    const VocabularyTree tree = benchmark_data::grown_tree(kWords);
    vocabulary = make_vocabulary(tree);
    save_vocabulary(vocabulary, path);
    for (unsigned i = 0; i < kImages; ++i)
      images.push_back(benchmark_data::image_of(tree, kFeatures, 100 + i));
    // Mapped and made give the same, or there is nothing to time.
    if (open_vocabulary(path).transform({view_of(images[0])}) !=
        vocabulary.transform({view_of(images[0])}))
      std::abort();
  }
  ~Data() { std::remove(path.c_str()); }

  std::string path;
  Vocabulary vocabulary;
  std::vector<std::vector<std::uint8_t>> images;
};

const Data& data() {
  static const Data kData;
  return kData;
}

/// Reads enough other memory that nothing else is left in the core's own caches.
void evict() {
  static std::vector<std::uint64_t> other(std::size_t{64} << 17);
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < other.size(); i += 8) sum += other[i]++;
  benchmark::DoNotOptimize(sum);
}

void BM_OpenMapped(benchmark::State& state) {
  const Data& d = data();
  for (auto _ : state) {
    const Vocabulary vocabulary = open_vocabulary(d.path);
    benchmark::DoNotOptimize(vocabulary.transform({view_of(d.images[0])}));
  }
  state.counters["MB"] = static_cast<double>(d.vocabulary.bytes()) / 1e6;
}
BENCHMARK(BM_OpenMapped)->Unit(benchmark::kMillisecond);

void transform(benchmark::State& state, bool cold, bool direct) {
  const Data& d = data();
  TransformWorkspace workspace;
  BowVector bow;
  FeatureVector index;
  std::size_t i = 0;
  for (auto _ : state) {
    if (cold) {
      state.PauseTiming();
      evict();
      state.ResumeTiming();
    }
    d.vocabulary.transform({view_of(d.images[i++ % kImages])}, bow, direct ? &index : nullptr, 4,
                           workspace);
    benchmark::DoNotOptimize(bow);
  }
}
void BM_TransformCold(benchmark::State& state) { transform(state, true, state.range(0) != 0); }
void BM_TransformWarm(benchmark::State& state) { transform(state, false, state.range(0) != 0); }
BENCHMARK(BM_TransformCold)->ArgName("direct")->Arg(0)->Arg(1)->Unit(benchmark::kMicrosecond);
BENCHMARK(BM_TransformWarm)->ArgName("direct")->Arg(0)->Arg(1)->Unit(benchmark::kMicrosecond);

void BM_Train(benchmark::State& state) {
  const auto descriptors = benchmark_data::image_of(benchmark_data::grown_tree(kWords),
                                                    static_cast<std::size_t>(state.range(0)), 9);
  TrainingOptions options;
  options.threads = static_cast<int>(state.range(1));
  std::size_t words = 0;
  for (auto _ : state) words = train_vocabulary(view_of(descriptors), {}, options).words();
  state.counters["words"] = static_cast<double>(words);
}
BENCHMARK(BM_Train)
    ->ArgNames({"descriptors", "threads"})
    ->Args({100000, 1})
    ->Args({100000, 2})
    ->Args({1000000, 2})
    ->Iterations(1)
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace dynslam::loop
