// Aligning patches against OpenCV's Lucas-Kanade tracker, both from half a pixel beside.
#include <algorithm>
#include <cmath>
#include <vector>

#include <benchmark/benchmark.h>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "dynslam/core/opencv.hpp"
#include "dynslam/features/orb.hpp"
#include "dynslam/features/patch_alignment.hpp"

#include "features/support.hpp"

namespace dynslam::features {
namespace {

constexpr double kMostError = 0.1;  // pixels, root mean square

GrayView gray(const cv::Mat& image) { return as_view<const std::uint8_t>(image); }

/// 600 corners of an image and of the same image shifted by a fraction of a pixel.
struct Shifted {
  const cv::Point2f shift{0.37F, -0.28F};
  cv::Mat first = testing::texture(640, 480), second;
  std::vector<Patch> patches;
  std::vector<cv::Point2f> places, starts;

  Shifted() {
    cv::GaussianBlur(first, first, cv::Size(5, 5), 1.0);
    const cv::Matx23f map(1, 0, shift.x, 0, 1, shift.y);
    cv::warpAffine(first, second, map, first.size(), cv::INTER_CUBIC, cv::BORDER_REFLECT);
    OrbOptions options;
    options.max_features = 600;
    options.levels = 1;
    std::vector<cv::KeyPoint> corners;
    cv::Mat descriptors;
    OrbExtractor(options).extract(gray(first), {}, corners, descriptors);
    for (const cv::KeyPoint& corner : corners) {
      const auto patch = cut_patch(gray(first), {corner.pt.x, corner.pt.y});
      if (!patch) continue;
      patches.push_back(*patch);
      places.push_back(corner.pt);
      starts.push_back(corner.pt);
    }
  }

  double error(const std::vector<cv::Point2f>& found, const std::vector<std::uint8_t>& ok) const {
    double squares = 0.0;
    int count = 0;
    for (std::size_t i = 0; i < places.size(); ++i) {
      if (ok[i] == 0) continue;
      const cv::Point2f off = found[i] - places[i] - shift;
      squares += off.dot(off);
      ++count;
    }
    return count == 0 ? 1e9 : std::sqrt(squares / count);
  }
};

void report(benchmark::State& state, const Shifted& data, const std::vector<cv::Point2f>& found,
            const std::vector<std::uint8_t>& ok) {
  state.counters["error"] = data.error(found, ok);
  state.counters["aligned"] = static_cast<double>(std::count(ok.begin(), ok.end(), 1));
  state.counters["us_each"] = benchmark::Counter(
      1e-6 * static_cast<double>(data.places.size()),
      benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
  if (data.error(found, ok) > kMostError) state.SkipWithError("not where they are");
}

void BM_AlignPatch(benchmark::State& state) {
  const Shifted data;
  std::vector<cv::Point2f> found(data.places.size());
  std::vector<std::uint8_t> ok(data.places.size());
  const auto align_all = [&] {
    for (std::size_t i = 0; i < found.size(); ++i) {
      const PatchAlignment result =
          align_patch(data.patches[i], Eigen::Matrix2f::Identity(), gray(data.second),
                      {data.starts[i].x, data.starts[i].y});
      found[i] = {result.at.x(), result.at.y()};
      ok[i] = result.ok() ? 1 : 0;
    }
  };
  align_all();
  report(state, data, found, ok);
  for (auto _ : state) {
    align_all();
    benchmark::ClobberMemory();
  }
}
BENCHMARK(BM_AlignPatch)->Unit(benchmark::kMicrosecond);

/// With slopes of the first image computed beforehand, as our patches are cut beforehand.
void BM_OpenCvLucasKanade(benchmark::State& state) {
  cv::setNumThreads(1);
  const Shifted data;
  const cv::Size window(8, 8);
  std::vector<cv::Mat> first, second;
  cv::buildOpticalFlowPyramid(data.first, first, window, 0, true);
  cv::buildOpticalFlowPyramid(data.second, second, window, 0, false);
  const cv::TermCriteria criteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 6, 0.02);
  std::vector<cv::Point2f> found;
  std::vector<std::uint8_t> ok;
  cv::Mat errors;
  const auto track = [&] {
    found = data.starts;
    cv::calcOpticalFlowPyrLK(first, second, data.places, found, ok, errors, window, 0, criteria,
                             cv::OPTFLOW_USE_INITIAL_FLOW);
  };
  track();
  report(state, data, found, ok);
  for (auto _ : state) {
    track();
    benchmark::ClobberMemory();
  }
}
BENCHMARK(BM_OpenCvLucasKanade)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace dynslam::features
