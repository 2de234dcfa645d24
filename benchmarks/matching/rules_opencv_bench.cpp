// Every rule beside OpenCV's robust estimators on the same made-up matches, six of ten wrong.
#include <cstdint>
#include <string>
#include <vector>

#include <benchmark/benchmark.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

#include "dynslam/matching/named_rule.hpp"
#include "dynslam/matching/reject.hpp"

#include "../../tests/matching/synthetic_pairs.hpp"

namespace {

namespace dm = dynslam::matching;

synthetic::Pairs make(std::int64_t matches) {
  synthetic::Setup setup;
  setup.matches = static_cast<std::size_t>(matches);
  setup.outliers = 0.6;
  setup.camera.translation << -0.2, 0.02, 0.05;
  setup.camera.rotation = synthetic::turn(2, 1, 3);
  setup.camera.roll_degrees = 3;
  return synthetic::make_pairs(setup);
}

void report(benchmark::State& state, const std::vector<std::uint8_t>& keep,
            const synthetic::Pairs& pairs) {
  const synthetic::Score score = synthetic::score(keep, pairs.good);
  state.counters["precision"] = score.precision;
  state.counters["recall"] = score.recall;
}

void rule(benchmark::State& state, const std::string& name) {
  const synthetic::Pairs pairs = make(state.range(0));
  const dm::NamedRule rule = dm::make_rule(name);
  std::vector<std::uint8_t> keep(pairs.matches.size());
  std::vector<float> weight(pairs.matches.size());
  dm::Workspace workspace(pairs.matches.size());
  for (auto _ : state) {
    dm::reject(rule, pairs.matches, pairs.points1, pairs.points2, keep, weight, workspace);
    benchmark::DoNotOptimize(keep.data());
  }
  report(state, keep, pairs);
  const synthetic::Score score = synthetic::score(keep, pairs.good);
  if (name == "default" && !(score.precision > 0.9 && score.recall > 0.9)) {
    state.SkipWithError("the default rule is wrong");
  }
}

void opencv(benchmark::State& state, int method) {
  cv::setNumThreads(1);
  const synthetic::Pairs pairs = make(state.range(0));
  std::vector<cv::Point2f> points1, points2;
  for (std::size_t i = 0; i < pairs.matches.size(); ++i) {
    points1.emplace_back(pairs.points1[i].x, pairs.points1[i].y);
    points2.emplace_back(pairs.points2[i].x, pairs.points2[i].y);
  }
  std::vector<std::uint8_t> mask;
  for (auto _ : state) {
    cv::findFundamentalMat(points1, points2, method, 2.0, 0.999, 1000, mask);
    benchmark::DoNotOptimize(mask.data());
  }
  mask.resize(pairs.matches.size());
  report(state, mask, pairs);
}

const bool registered = [] {
  const auto sizes = [](benchmark::internal::Benchmark* b) {
    b->Arg(500)->Arg(2000)->Unit(benchmark::kMicrosecond);
  };
  for (const auto name : dm::kRuleNames) {
    const std::string text(name);
    sizes(benchmark::RegisterBenchmark(("matching/" + text).c_str(),
                                       [text](benchmark::State& state) { rule(state, text); }));
  }
  sizes(benchmark::RegisterBenchmark("matching/rival/usac_magsac", opencv, cv::USAC_MAGSAC));
  sizes(benchmark::RegisterBenchmark("matching/rival/usac_fast", opencv, cv::USAC_FAST));
  sizes(benchmark::RegisterBenchmark("matching/rival/fm_ransac", opencv, cv::FM_RANSAC));
  return true;
}();

}  // namespace
