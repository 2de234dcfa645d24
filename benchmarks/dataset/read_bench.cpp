// Reading frames: what the checks and the undistortion cost beside plain OpenCV, and what reading
// ahead hides.
#include <chrono>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>

#include <benchmark/benchmark.h>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/dataset/read_ahead.hpp"
#include "dynslam/dataset/readers.hpp"
#include "dynslam/dataset/tum_writer.hpp"

#include "temp_folder.hpp"

namespace {

namespace ds = dynslam::dataset;
namespace fs = std::filesystem;

constexpr int kFrames = 8;

// 640 x 480 RGB-D frames with the texture and noise that make a PNG as large as a recorded one.
class Folder {
 public:
  Folder() {
    dynslam::DepthCamera camera;
    camera.fx = camera.fy = 525.0, camera.cx = 319.5, camera.cy = 239.5;
    camera.width = 640, camera.height = 480;
    ds::TumWriter writer(path_, camera);
    cv::RNG rng(1);
    for (int i = 0; i < kFrames; ++i) writer.add(make_frame(i, &rng));
    writer.finish();
    ds::TumOptions flat;
    sequence = ds::open_tum(path_, flat);
    fs::remove(path_ / "camera.txt");
    undistorting = ds::open_tum(path_, flat);
  }
  std::string file(const char* kind, std::size_t i) const {
    return (path_ / kind / (sequence->frame_name(i) + ".png")).string();
  }

  std::unique_ptr<ds::Sequence> sequence, undistorting;

 private:
  static ds::Frame make_frame(int i, cv::RNG* rng) {
    ds::Frame frame;
    frame.timestamp = 100.0 + i / 30.0;
    cv::Mat coarse(48, 64, CV_8UC3), noise(480, 640, CV_8UC3);
    rng->fill(coarse, cv::RNG::UNIFORM, 0, 200);
    rng->fill(noise, cv::RNG::UNIFORM, 0, 6);
    cv::resize(coarse, frame.color, cv::Size(640, 480), 0, 0, cv::INTER_CUBIC);
    frame.color += noise;
    cv::Mat steps(48, 64, CV_32FC1);
    rng->fill(steps, cv::RNG::UNIFORM, 0.5, 5.0);
    cv::resize(steps, frame.depth, cv::Size(640, 480), 0, 0, cv::INTER_LINEAR);
    return frame;
  }

  const dynslam::testing::TempFolder root_;
  const fs::path path_ = root_ / "rgbd_dataset_freiburg1_bench";  // a name with distortion
};

const Folder& folder() {
  static const Folder made;
  return made;
}

bool same(const cv::Mat& a, const cv::Mat& b) { return cv::norm(a, b, cv::NORM_INF) == 0.0; }

// The rival: the same two files through cv::imread and convertTo, nothing checked.
ds::Frame imread_pair(std::size_t i) {
  ds::Frame frame;
  frame.color = cv::imread(folder().file("rgb", i), cv::IMREAD_UNCHANGED);
  cv::imread(folder().file("depth", i), cv::IMREAD_UNCHANGED)
      .convertTo(frame.depth, CV_32F, 1.0 / 5000.0);
  return frame;
}

void BM_ReadRgbdFrame(benchmark::State& state) {
  const ds::Sequence& sequence = *folder().sequence;
  const ds::Frame ours = sequence.read(0), theirs = imread_pair(0);
  if (!same(ours.color, theirs.color) || !same(ours.depth, theirs.depth)) {
    state.SkipWithError("other pixels than cv::imread's");
  }
  std::size_t i = 0;
  for (auto _ : state) benchmark::DoNotOptimize(sequence.read(i++ % kFrames).color.data);
}
BENCHMARK(BM_ReadRgbdFrame)->Unit(benchmark::kMillisecond);

void BM_ReadRgbdFrame_rival_cv_imread(benchmark::State& state) {
  std::size_t i = 0;
  for (auto _ : state) benchmark::DoNotOptimize(imread_pair(i++ % kFrames).color.data);
}
BENCHMARK(BM_ReadRgbdFrame_rival_cv_imread)->Unit(benchmark::kMillisecond);

void BM_ReadAndUndistortRgbdFrame(benchmark::State& state) {
  const ds::Sequence& sequence = *folder().undistorting;
  std::size_t i = 0;
  for (auto _ : state) benchmark::DoNotOptimize(sequence.read(i++ % kFrames).color.data);
}
BENCHMARK(BM_ReadAndUndistortRgbdFrame)->Unit(benchmark::kMillisecond);

// A consumer whose 20 ms of work a frame are on another device. The time is that of 8 frames.
void work() { std::this_thread::sleep_for(std::chrono::milliseconds(20)); }

void BM_8FramesWith20msOfWork_ReadAhead(benchmark::State& state) {
  for (auto _ : state) {
    ds::ReadAhead ahead(*folder().sequence);
    int frames = 0;
    while (const auto result = ahead.next()) {
      frames += result->frame.has_value();
      work();
    }
    if (frames != kFrames) state.SkipWithError("frames are missing");
  }
}
BENCHMARK(BM_8FramesWith20msOfWork_ReadAhead)->Unit(benchmark::kMillisecond)->UseRealTime();

void BM_8FramesWith20msOfWork_rival_read(benchmark::State& state) {
  for (auto _ : state) {
    for (std::size_t i = 0; i < kFrames; ++i) {
      benchmark::DoNotOptimize(folder().sequence->read(i).color.data);
      work();
    }
  }
}
BENCHMARK(BM_8FramesWith20msOfWork_rival_read)->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace
