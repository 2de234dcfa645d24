// GhostV2C3-YOLOv5s-seg in OpenCV's networks, as exported and fused, and YOLOv5s-seg with its own
// blocks; one thread each. The models are those of layers_bench.cpp.
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include <benchmark/benchmark.h>
#include <opencv2/core.hpp>
#include <opencv2/dnn.hpp>

#include "dynslam/attention/onnx_fuse.hpp"
#include "dynslam/attention/opencv.hpp"
#include "dynslam/attention/safetensors.hpp"

namespace dynslam::attention {
namespace {

cv::Mat mat_of(const NamedTensor& tensor) {
  const std::vector<int> sizes(tensor.shape.begin(), tensor.shape.end());
  return cv::Mat(sizes, CV_32F, const_cast<float*>(tensor.values.data())).clone();
}

double worst_error(const cv::Mat& got, const NamedTensor& expected) {
  double mean = 0.0;
  for (const float v : expected.values) mean += std::abs(v);
  mean /= static_cast<double>(expected.values.size());
  double worst = 0.0;
  for (std::size_t i = 0; i < expected.values.size(); ++i) {
    const double scale = std::max<double>(std::abs(expected.values[i]), mean);
    worst = std::max(
        worst, std::abs(static_cast<double>(got.ptr<float>()[i]) - expected.values[i]) / scale);
  }
  return worst;
}

void run_network(benchmark::State& state, const std::string& name, bool fuse) {
  const char* folder = std::getenv("DYNSLAM_ATTENTION_MODELS");
  const std::string stem =
      std::string(folder == nullptr ? "attention_models" : folder) + "/" + name;
  if (!std::filesystem::exists(stem + ".safetensors")) {
    state.SkipWithError("export the models first, see BENCHMARK.md");
    return;
  }
  cv::setNumThreads(1);
  register_opencv_layers();
  std::string path = stem + ".onnx";
  if (fuse) {
    path = (std::filesystem::temp_directory_path() / "dynslam_fused.onnx").string();
    fuse_onnx_file(stem + ".onnx", path);
  }
  cv::dnn::Net net = cv::dnn::readNetFromONNX(path);
  net.setPreferableBackend(cv::dnn::DNN_BACKEND_OPENCV);
  const SafeTensors data = SafeTensors::read(stem + ".safetensors");
  const cv::Mat image = mat_of(data.at("input0"));
  const std::vector<std::string> names = net.getUnconnectedOutLayersNames();
  std::vector<cv::Mat> outputs;
  const auto forward = [&] {
    net.setInput(image);
    net.forward(outputs, names);
  };
  forward();
  for (std::size_t i = 0; i < outputs.size(); ++i) {
    if (!(worst_error(outputs[i], data.at("output" + std::to_string(i))) < 1e-4)) {
      state.SkipWithError("wrong result");
      return;
    }
  }
  for (auto _ : state) forward();
}

BENCHMARK_CAPTURE(run_network, ghost_unfused, "yolov5s_seg_ghost", false)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(run_network, ghost_fused, "yolov5s_seg_ghost", true)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(run_network, c3_own_blocks, "yolov5s_seg", false)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace dynslam::attention
