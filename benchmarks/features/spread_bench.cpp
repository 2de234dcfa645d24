// What spreading costs and gives: matches between two frames of a real sequence that a fundamental
// matrix explains, and the cells of a 16 x 12 grid that hold one. Times are of the extraction.
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <benchmark/benchmark.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>

#include "dynslam/core/opencv.hpp"
#include "dynslam/features/matcher.hpp"
#include "dynslam/features/orb.hpp"

#include "data_images.hpp"

namespace dynslam::features {
namespace {

constexpr std::size_t kPairs = 20;

std::vector<cv::Mat> sequence(const std::string& folder, std::size_t step) {
  const std::vector<std::string> names = benchmark_data::names_in(folder);
  std::vector<cv::Mat> images;
  for (std::size_t i = 0; i < names.size() && images.size() <= kPairs; i += step) {
    images.push_back(cv::imread(names[i], cv::IMREAD_GRAYSCALE));
  }
  return images;
}

struct Features {
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
};

using Extract = std::function<void(const cv::Mat&, Features&)>;

void score(benchmark::State& state, const Features& a, const Features& b, cv::Size size) {
  BruteForceOptions options;
  options.cross_check = true;
  options.max_distance = 64;
  std::vector<Match> matches;
  match_brute_force(as_view<const std::uint8_t>(a.descriptors),
                    as_view<const std::uint8_t>(b.descriptors), options, matches);
  std::vector<cv::Point2f> from, to;
  for (const Match& m : matches) {
    from.push_back(a.keypoints[static_cast<std::size_t>(m.query)].pt);
    to.push_back(b.keypoints[static_cast<std::size_t>(m.train)].pt);
  }
  std::vector<std::uint8_t> inlier(matches.size(), 0);
  cv::setRNGSeed(1);
  if (matches.size() >= 8) {
    cv::findFundamentalMat(from, to, cv::USAC_MAGSAC, 1.5, 0.999, 5000, inlier);
  }
  std::set<int> cells;
  for (std::size_t i = 0; i < inlier.size(); ++i) {
    if (inlier[i] == 0) continue;
    cells.insert(static_cast<int>(from[i].y * 12 / static_cast<float>(size.height)) * 16 +
                 static_cast<int>(from[i].x * 16 / static_cast<float>(size.width)));
  }
  state.counters["matches"] += static_cast<double>(matches.size());
  state.counters["inliers"] += static_cast<double>(cv::countNonZero(inlier));
  state.counters["inlier_cells"] += static_cast<double>(cells.size());
}

void run(benchmark::State& state, const std::string& folder, std::size_t step,
         const Extract& extract) {
  const std::vector<cv::Mat> images = sequence(folder, step);
  if (images.size() < 2) {
    state.SkipWithError("no data");
    return;
  }
  std::vector<Features> features(images.size());
  for (auto _ : state) {
    for (std::size_t i = 0; i < images.size(); ++i) extract(images[i], features[i]);
  }
  for (const char* name : {"matches", "inliers", "inlier_cells"}) {
    state.counters[name] = benchmark::Counter(0.0);
  }
  for (std::size_t i = 0; i + 1 < images.size(); ++i) {
    score(state, features[i], features[i + 1], images[i].size());
  }
  for (const char* name : {"matches", "inliers", "inlier_cells"}) {
    state.counters[name].value /= static_cast<double>(images.size() - 1);
  }
}

const bool kRegistered = [] {
  cv::setNumThreads(1);
  struct Source {
    const char* name;
    const char* folder;
    std::size_t step;
  };
  for (const Source& source : {Source{"kitti_06", "kitti_06_start/image_0", 1},
                               Source{"kitti_06_every_third", "kitti_06_start/image_0", 3},
                               Source{"kitchen_every_fifth", "kitchen_static/rgb", 5},
                               Source{"fr3_cabinet", "fr3_cabinet/rgb", 1}}) {
    const auto add = [&](const std::string& what, const Extract& extract) {
      benchmark::RegisterBenchmark(
          (std::string(source.name) + "/" + what).c_str(),
          [=](benchmark::State& state) { run(state, source.folder, source.step, extract); })
          ->Unit(benchmark::kMillisecond)
          ->Iterations(3);
    };
    add("cv_orb", [orb = cv::ORB::create(1000)](const cv::Mat& image, Features& out) {
      orb->detectAndCompute(image, cv::noArray(), out.keypoints, out.descriptors);
    });
    for (const int percent : {0, 25, 50, 75, 100}) {
      OrbOptions options;
      options.spread = static_cast<float>(percent) / 100.0F;
      const auto extractor = std::make_shared<OrbExtractor>(options);
      add("spread_" + std::to_string(percent), [extractor](const cv::Mat& image, Features& out) {
        extractor->extract(as_view<const std::uint8_t>(image), {}, out.keypoints, out.descriptors);
      });
    }
  }
  return true;
}();

}  // namespace
}  // namespace dynslam::features
