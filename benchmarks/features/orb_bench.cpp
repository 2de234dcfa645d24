// OrbExtractor against cv::ORB: same image, same budget, one thread, alternating in the same run.
#include <algorithm>
#include <chrono>
#include <functional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <benchmark/benchmark.h>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>

#include "dynslam/core/opencv.hpp"
#include "dynslam/features/orb.hpp"

#include "data_images.hpp"
#include "features/support.hpp"

namespace dynslam::features {
namespace {

struct Picture {
  std::string name;
  cv::Mat image;
};

/// The n-th picture of a folder in the order of the names; empty if there is none.
cv::Mat picture_of(const std::string& folder, std::size_t n) {
  const std::vector<std::string> names = benchmark_data::names_in(folder);
  return n < names.size() ? cv::imread(names[n], cv::IMREAD_GRAYSCALE) : cv::Mat();
}

std::vector<Picture> pictures() {
  std::vector<Picture> all;
  all.push_back({"texture_640x480", testing::texture(640, 480)});
  all.push_back({"kitchen_static_50", picture_of("kitchen_static/rgb", 50)});
  all.push_back({"kitchen_static_200", picture_of("kitchen_static/rgb", 200)});
  all.push_back({"kitchen_static_300", picture_of("kitchen_static/rgb", 300)});
  all.push_back({"fr3_cabinet_10", picture_of("fr3_cabinet/rgb", 10)});
  all.push_back({"kitti_06_0", picture_of("kitti_06_start/image_0", 0)});
  all.push_back({"kitti_06_30", picture_of("kitti_06_start/image_0", 30)});
  all.push_back({"corridor_28", picture_of("loops_corridor", 20)});
  const auto is_missing = [](const Picture& picture) { return picture.image.empty(); };
  all.erase(std::remove_if(all.begin(), all.end(), is_missing), all.end());
  return all;
}

int occupied_cells(const std::vector<cv::KeyPoint>& keypoints, cv::Size size) {
  std::set<std::pair<int, int>> cells;
  for (const cv::KeyPoint& k : keypoints) {
    cells.insert({static_cast<int>(k.pt.x * 16 / static_cast<float>(size.width)),
                  static_cast<int>(k.pt.y * 12 / static_cast<float>(size.height))});
  }
  return static_cast<int>(cells.size());
}

double milliseconds(const std::function<void()>& run) {
  const auto start = std::chrono::steady_clock::now();
  run();
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start)
      .count();
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

struct Extracted {
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
};

/// Both extractors by turns, so that a busy machine is busy for both. The time reported is ours.
void compare(benchmark::State& state, const Picture& picture, int budget) {
  cv::setNumThreads(1);
  OrbOptions options;
  options.max_features = budget;
  OrbExtractor extractor(options);
  const cv::Ptr<cv::ORB> opencv = cv::ORB::create(budget);
  Extracted ours, theirs;
  const auto run_ours = [&] {
    extractor.extract(as_view<const std::uint8_t>(picture.image), {}, ours.keypoints,
                      ours.descriptors);
  };
  const auto run_theirs = [&] {
    opencv->detectAndCompute(picture.image, cv::noArray(), theirs.keypoints, theirs.descriptors);
  };
  run_ours();
  run_theirs();
  if (ours.keypoints.size() < theirs.keypoints.size() ||
      ours.descriptors.rows != static_cast<int>(ours.keypoints.size())) {
    state.SkipWithError("fewer features than cv::ORB");
    return;
  }
  std::vector<double> our_times, their_times;
  for (auto _ : state) {
    our_times.push_back(milliseconds(run_ours));
    their_times.push_back(milliseconds(run_theirs));
    state.SetIterationTime(our_times.back() / 1e3);
  }
  const double our_cells = occupied_cells(ours.keypoints, picture.image.size());
  const double their_cells = occupied_cells(theirs.keypoints, picture.image.size());
  state.counters["ms"] = median(our_times);
  state.counters["cv_ms"] = median(their_times);
  state.counters["time_ratio"] = median(our_times) / median(their_times);
  state.counters["features"] = static_cast<double>(ours.keypoints.size());
  state.counters["cv_features"] = static_cast<double>(theirs.keypoints.size());
  state.counters["cells"] = our_cells;
  state.counters["cv_cells"] = their_cells;
  if (their_cells > 0) state.counters["cell_ratio"] = our_cells / their_cells;
}

/// Ours alone with one kind of vector instructions.
void on_target(benchmark::State& state, const Picture& picture, std::int64_t target) {
  hwy::SetSupportedTargetsForTest(target);
  hwy::GetChosenTarget().Update(target);
  OrbExtractor extractor;
  Extracted ours;
  for (auto _ : state) {
    extractor.extract(as_view<const std::uint8_t>(picture.image), {}, ours.keypoints,
                      ours.descriptors);
    benchmark::DoNotOptimize(ours.descriptors.data);
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}

const bool kRegistered = [] {
  for (const Picture& picture : pictures()) {
    for (const int budget : {1000, 2000}) {
      const std::string name = "orb/" + picture.name + "/" + std::to_string(budget);
      benchmark::RegisterBenchmark(
          name.c_str(), [=](benchmark::State& state) { compare(state, picture, budget); })
          ->UseManualTime()
          ->Unit(benchmark::kMillisecond)
          ->MinTime(0.4);
    }
  }
  const Picture picture = {"texture_640x480", testing::texture(640, 480)};
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    const std::string name = "orb_target/" + std::string(hwy::TargetName(target));
    benchmark::RegisterBenchmark(
        name.c_str(), [=](benchmark::State& state) { on_target(state, picture, target); })
        ->Unit(benchmark::kMillisecond)
        ->MinTime(0.3);
  }
  return true;
}();

}  // namespace
}  // namespace dynslam::features
