// Matching against cv::BFMatcher, and windowed matching against loops without a grid.
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <benchmark/benchmark.h>
#include <opencv2/features2d.hpp>

#include "dynslam/core/opencv.hpp"
#include "dynslam/features/hamming.hpp"
#include "dynslam/features/hamming_reference.hpp"
#include "dynslam/features/matcher.hpp"

#include "features/support.hpp"

namespace dynslam::features {
namespace {

DescriptorsView view(const cv::Mat& m) { return as_view<const std::uint8_t>(m); }

/// Random descriptors, and copies of them with bits turned.
struct Pair {
  cv::Mat train, query;
  explicit Pair(int rows, int bytes) : train(testing::noise(bytes, rows, 1)), query(train.clone()) {
    std::mt19937 random(2);
    for (int i = 0; i < rows; ++i) {
      for (int bit = 0; bit < 30; ++bit) {
        query.at<std::uint8_t>(i, testing::uniform(random, 0, bytes - 1)) ^=
            static_cast<std::uint8_t>(1 << testing::uniform(random, 0, 7));
      }
    }
  }
};

void brute_force(benchmark::State& state, const BruteForceOptions& options) {
  const Pair pair(static_cast<int>(state.range(0)), static_cast<int>(state.range(1)));
  std::vector<Match> matches;
  match_brute_force(view(pair.query), view(pair.train), options, matches);
  for (const Match& m : matches) {
    if (m.query != m.train) state.SkipWithError("a wrong match");
  }
  for (auto _ : state) {
    match_brute_force(view(pair.query), view(pair.train), options, matches);
    benchmark::DoNotOptimize(matches.data());
  }
  state.counters["ns_a_pair"] = benchmark::Counter(
      static_cast<double>(state.range(0) * state.range(0)) * 1e-9,
      benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

void BM_BruteForce(benchmark::State& state) { brute_force(state, {}); }

void BM_BruteForceCrossCheck(benchmark::State& state) {
  BruteForceOptions options;
  options.cross_check = true;
  brute_force(state, options);
}

void BM_BruteForceRatio(benchmark::State& state) {
  BruteForceOptions options;
  options.ratio = 0.8F;
  brute_force(state, options);
}

void BM_OpenCvBFMatcher(benchmark::State& state) {
  cv::setNumThreads(1);
  const Pair pair(static_cast<int>(state.range(0)), static_cast<int>(state.range(1)));
  const cv::BFMatcher matcher(cv::NORM_HAMMING);
  std::vector<cv::DMatch> matches;
  for (auto _ : state) {
    matcher.match(pair.query, pair.train, matches);
    benchmark::DoNotOptimize(matches.data());
  }
}

void BM_OpenCvBFMatcherCrossCheck(benchmark::State& state) {
  cv::setNumThreads(1);
  const Pair pair(static_cast<int>(state.range(0)), static_cast<int>(state.range(1)));
  const cv::BFMatcher matcher(cv::NORM_HAMMING, true);
  std::vector<cv::DMatch> matches;
  for (auto _ : state) {
    matcher.match(pair.query, pair.train, matches);
    benchmark::DoNotOptimize(matches.data());
  }
}

void BM_OpenCvBFMatcherTwoNearest(benchmark::State& state) {
  cv::setNumThreads(1);
  const Pair pair(static_cast<int>(state.range(0)), static_cast<int>(state.range(1)));
  const cv::BFMatcher matcher(cv::NORM_HAMMING);
  std::vector<std::vector<cv::DMatch>> matches;
  for (auto _ : state) {
    matcher.knnMatch(pair.query, pair.train, matches, 2);
    benchmark::DoNotOptimize(matches.data());
  }
}

void sizes(benchmark::internal::Benchmark* b) {
  b->Args({500, 32})
      ->Args({1000, 32})
      ->Args({2000, 32})
      ->Args({1000, 64})
      ->Unit(benchmark::kMillisecond);
}
BENCHMARK(BM_BruteForce)->Apply(sizes);
BENCHMARK(BM_OpenCvBFMatcher)->Apply(sizes);
BENCHMARK(BM_BruteForceRatio)->Apply(sizes);
BENCHMARK(BM_OpenCvBFMatcherTwoNearest)->Apply(sizes);
BENCHMARK(BM_BruteForceCrossCheck)->Apply(sizes);
BENCHMARK(BM_OpenCvBFMatcherCrossCheck)->Apply(sizes);

/// 1000 features of a 640 x 480 frame and as many predictions a few pixels beside them.
struct Frame {
  Pair descriptors{1000, 32};
  std::vector<cv::KeyPoint> keypoints;
  std::vector<cv::Point2f> positions;
  std::vector<float> radii;
  std::vector<int> min_octaves, max_octaves;

  explicit Frame(float radius) : radii(1000, radius) {
    std::mt19937 random(3);
    for (int i = 0; i < 1000; ++i) {
      const cv::Point2f at(static_cast<float>(testing::uniform(random, 0, 6399)) / 10.0F,
                           static_cast<float>(testing::uniform(random, 0, 4799)) / 10.0F);
      keypoints.emplace_back(at, 31.0F, 0.0F, 1.0F, testing::uniform(random, 0, 7));
      positions.emplace_back(at.x + static_cast<float>(testing::uniform(random, -4, 4)),
                             at.y + static_cast<float>(testing::uniform(random, -4, 4)));
      min_octaves.push_back(keypoints.back().octave - 1);
      max_octaves.push_back(keypoints.back().octave + 1);
    }
  }
};

void BM_GridBuild(benchmark::State& state) {
  const Frame frame(10.0F);
  KeypointGrid grid;
  for (auto _ : state) {
    grid.build(field(frame.keypoints, &cv::KeyPoint::pt), 640, 480);
    benchmark::ClobberMemory();
  }
}
BENCHMARK(BM_GridBuild)->Unit(benchmark::kMicrosecond);

void BM_Windowed(benchmark::State& state) {
  const Frame frame(static_cast<float>(state.range(0)));
  KeypointGrid grid;
  grid.build(field(frame.keypoints, &cv::KeyPoint::pt), 640, 480);
  const WindowPredictions predictions = {frame.positions, frame.radii, frame.min_octaves,
                                         frame.max_octaves, view(frame.descriptors.query)};
  const WindowFeatures features = {
      &grid, field(frame.keypoints, &cv::KeyPoint::octave), view(frame.descriptors.train), {}};
  std::vector<Match> matches;
  match_windowed(predictions, features, {}, matches);
  if (matches.size() != 1000) state.SkipWithError("not every feature was found");
  for (auto _ : state) {
    match_windowed(predictions, features, {}, matches);
    benchmark::DoNotOptimize(matches.data());
  }
}
BENCHMARK(BM_Windowed)->Arg(7)->Arg(15)->Arg(40)->Unit(benchmark::kMicrosecond);

/// What one writes first: every prediction asks every feature whether it lies in the window.
void BM_WindowedWithoutGrid(benchmark::State& state) {
  const Frame frame(static_cast<float>(state.range(0)));
  std::vector<Match> matches;
  for (auto _ : state) {
    matches.clear();
    for (std::size_t i = 0; i < 1000; ++i) {
      Match best = {static_cast<std::int32_t>(i), -1, 101.0F};
      for (std::size_t j = 0; j < 1000; ++j) {
        const cv::KeyPoint& k = frame.keypoints[j];
        if (std::abs(k.pt.x - frame.positions[i].x) > frame.radii[i] ||
            std::abs(k.pt.y - frame.positions[i].y) > frame.radii[i] ||
            k.octave < frame.min_octaves[i] || k.octave > frame.max_octaves[i]) {
          continue;
        }
        const auto distance = static_cast<float>(
            hamming_distance(frame.descriptors.query.ptr(static_cast<int>(i)),
                             frame.descriptors.train.ptr(static_cast<int>(j)), 32));
        if (distance < best.distance) {
          best.distance = distance;
          best.train = static_cast<std::int32_t>(j);
        }
      }
      if (best.train >= 0) matches.push_back(best);
    }
    benchmark::DoNotOptimize(matches.data());
  }
}
BENCHMARK(BM_WindowedWithoutGrid)->Arg(15)->Unit(benchmark::kMicrosecond);

void BM_Distances(benchmark::State& state) {
  const Pair pair(1000, static_cast<int>(state.range(0)));
  std::vector<std::int32_t> distances(1000);
  const Span<const std::uint8_t> query(pair.query.ptr(0), static_cast<std::size_t>(state.range(0)));
  for (auto _ : state) {
    hamming_distances(query, view(pair.train), distances);
    benchmark::DoNotOptimize(distances.data());
  }
}
BENCHMARK(BM_Distances)->Arg(32)->Arg(48)->Arg(64)->Unit(benchmark::kMicrosecond);

void BM_OpenCvNorm(benchmark::State& state) {
  const Pair pair(1000, static_cast<int>(state.range(0)));
  std::vector<std::int32_t> distances(1000);
  for (auto _ : state) {
    for (int i = 0; i < 1000; ++i) {
      distances[static_cast<std::size_t>(i)] = static_cast<std::int32_t>(
          cv::norm(pair.query.row(0), pair.train.row(i), cv::NORM_HAMMING));
    }
    benchmark::DoNotOptimize(distances.data());
  }
}
BENCHMARK(BM_OpenCvNorm)->Arg(32)->Arg(64)->Unit(benchmark::kMicrosecond);

const bool kRegistered = [] {
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    const std::string name = "BM_BruteForceOn/" + std::string(hwy::TargetName(target));
    benchmark::RegisterBenchmark(name.c_str(),
                                 [target](benchmark::State& state) {
                                   hwy::SetSupportedTargetsForTest(target);
                                   hwy::GetChosenTarget().Update(target);
                                   brute_force(state, {});
                                   hwy::SetSupportedTargetsForTest(0);
                                   hwy::GetChosenTarget().Update(hwy::SupportedTargets());
                                 })
        ->Args({1000, 32})
        ->Unit(benchmark::kMillisecond);
  }
  return true;
}();

}  // namespace
}  // namespace dynslam::features
