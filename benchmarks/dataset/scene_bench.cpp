// Rendering: a whole frame, the truth alone, and the plain ray caster that is the oracle beside it.
#include <cmath>
#include <stdexcept>

#include <benchmark/benchmark.h>
#include <opencv2/core.hpp>

#include "dynslam/dataset/scene.hpp"

namespace {

namespace ds = dynslam::dataset;

const ds::RenderedScene& scene(int threads) {
  const auto make = [](int count) {
    ds::SceneOptions options;
    options.threads = count;
    return options;
  };
  static const ds::RenderedScene one(make(1)), two(make(2));
  // The same bits from one thread and from two, and the depth of the oracle.
  static const bool checked = [] {
    const ds::Frame a = one.render(100), b = two.render(100);
    if (cv::norm(a.color, b.color, cv::NORM_INF) != 0.0) throw std::runtime_error("colours differ");
    const cv::Mat depth = one.exact_depth(100);
    for (int y = 10; y < depth.rows; y += 40) {
      for (int x = 10; x < depth.cols; x += 40) {
        const auto z = static_cast<double>(depth.at<float>(y, x));
        if (std::abs(one.cast(100, {x, y})->depth - z) > 2e-3) {
          throw std::runtime_error("depth is not that of the oracle");
        }
      }
    }
    return true;
  }();
  static_cast<void>(checked);
  return threads == 1 ? one : two;
}

void render(benchmark::State& state) {
  const ds::RenderedScene& s = scene(static_cast<int>(state.range(0)));
  std::size_t i = 0;
  for (auto _ : state) benchmark::DoNotOptimize(s.render(i += 7).color.data);
  state.SetItemsProcessed(state.iterations());
}
BENCHMARK(render)->Arg(1)->Arg(2)->ArgName("threads")->Unit(benchmark::kMillisecond)->UseRealTime();

void truth(benchmark::State& state) {
  const ds::RenderedScene& s = scene(1);
  std::size_t i = 0;
  for (auto _ : state) benchmark::DoNotOptimize(s.truth(i += 7).depth.data);
}
BENCHMARK(truth)->Unit(benchmark::kMillisecond);

// Depth and label of every 16th pixel of every 16th row, 1200 rays: times 256 for a frame.
void truth_by_the_oracle_1200_rays(benchmark::State& state) {
  const ds::RenderedScene& s = scene(1);
  std::size_t i = 0;
  for (auto _ : state) {
    i += 7;
    for (int y = 8; y < 480; y += 16) {
      for (int x = 8; x < 640; x += 16) benchmark::DoNotOptimize(s.cast(i, {x, y}));
    }
  }
}
BENCHMARK(truth_by_the_oracle_1200_rays)->Unit(benchmark::kMillisecond);

void paint_and_render_first_frame(benchmark::State& state) {
  ds::SceneOptions options;
  for (auto _ : state) {
    ++options.seed;
    benchmark::DoNotOptimize(ds::RenderedScene(options).render(0).color.data);
  }
}
BENCHMARK(paint_and_render_first_frame)->Unit(benchmark::kMillisecond);

}  // namespace
