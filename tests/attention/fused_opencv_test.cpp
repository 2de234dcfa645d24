// What PyTorch exports, fused, inside OpenCV's networks.
#include <chrono>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/dnn.hpp>

#include "dynslam/attention/onnx_fuse.hpp"
#include "dynslam/attention/opencv.hpp"
#include "dynslam/attention/safetensors.hpp"

#include "attention/exported.hpp"
#include "attention/support.hpp"

namespace dynslam::attention {
namespace {

using testing::exported;
using testing::kTolerance;
using testing::relative_error;
using testing::torch_is_here;

cv::Mat mat_of(const NamedTensor& tensor) {
  std::vector<int> sizes(tensor.shape.begin(), tensor.shape.end());
  return cv::Mat(static_cast<int>(sizes.size()), sizes.data(), CV_32F,
                 const_cast<float*>(tensor.values.data()))
      .clone();
}

std::vector<float> values_of(const NamedTensor& tensor) {
  return {tensor.values.begin(), tensor.values.end()};
}
std::vector<float> values_of(const cv::Mat& mat) {
  return {mat.ptr<float>(), mat.ptr<float>() + mat.total()};
}

cv::dnn::Net load(const std::string& bytes) {
  cv::dnn::Net net = cv::dnn::readNetFromONNX(bytes.data(), bytes.size());
  net.setPreferableBackend(cv::dnn::DNN_BACKEND_OPENCV);
  net.setPreferableTarget(cv::dnn::DNN_TARGET_CPU);
  return net;
}

std::vector<cv::Mat> forward(cv::dnn::Net& net, const SafeTensors& data) {
  const std::vector<std::string> names = {"input0", "input1"};
  if (data.contains("input1")) {
    for (const std::string& name : names) net.setInput(mat_of(data.at(name)), name);
  } else {
    net.setInput(mat_of(data.at("input0")));
  }
  std::vector<cv::Mat> outputs;
  std::vector<cv::Mat> copies;
  net.forward(outputs, net.getUnconnectedOutLayersNames());
  for (const cv::Mat& output : outputs) copies.push_back(output.clone());
  return copies;
}

struct Case {
  const char* name;
  int OnnxFusion::*count;
};

class FusedLayer : public ::testing::TestWithParam<Case> {};

TEST_P(FusedLayer, InOpenCvEqualsPyTorch) {
  if (!torch_is_here()) GTEST_SKIP() << "no python3 that can import torch was found";
  const std::string stem = exported(GetParam().name);
  ASSERT_FALSE(stem.empty());
  const OnnxFusion fusion = fuse_onnx(testing::bytes_of_file(stem + ".onnx"), stem + ".onnx");
  EXPECT_EQ(fusion.*GetParam().count, 1);
  EXPECT_EQ(fusion.total(), 1);
  EXPECT_EQ(fusion.nodes_after, 1);
  register_opencv_layers();
  const SafeTensors data = SafeTensors::read(stem + ".safetensors");
  cv::dnn::Net net = load(fusion.bytes);
  const std::vector<cv::Mat> outputs = forward(net, data);
  ASSERT_EQ(outputs.size(), 1U);
  EXPECT_LT(relative_error(values_of(outputs[0]), values_of(data.at("output0"))), kTolerance);
}

INSTANTIATE_TEST_SUITE_P(All, FusedLayer,
                         ::testing::Values(Case{"small_dfc", &OnnxFusion::dfc},
                                           Case{"small_ghost", &OnnxFusion::ghost_module},
                                           Case{"small_bottleneck", &OnnxFusion::ghost_bottleneck},
                                           Case{"small_c3", &OnnxFusion::ghost_c3},
                                           Case{"small_c3_silu", &OnnxFusion::ghost_c3},
                                           Case{"small_cbam", &OnnxFusion::cbam},
                                           Case{"small_cbam_spatial_first", &OnnxFusion::cbam}),
                         [](const auto& tested) { return std::string(tested.param.name); });

#if defined(NDEBUG)
double milliseconds(cv::dnn::Net& net, const SafeTensors& data) {
  const auto start = std::chrono::steady_clock::now();
  forward(net, data);
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start)
      .count();
}
#endif

TEST(FusedNetwork, OfGhostV2C3YoloEqualsTheUnfusedOneAndIsFaster) {
  if (!torch_is_here()) GTEST_SKIP() << "no python3 that can import torch was found";
  const std::string stem = exported("yolov5s_seg_ghost", "--size 160 224");
  ASSERT_FALSE(stem.empty());
  const std::vector<std::uint8_t> bytes = testing::bytes_of_file(stem + ".onnx");
  const OnnxFusion fusion = fuse_onnx(bytes, stem + ".onnx");
  EXPECT_EQ(fusion.ghost_c3, 8);
  EXPECT_EQ(fusion.total(), 8);
  EXPECT_LT(fusion.nodes_after, fusion.nodes_before);
  register_opencv_layers();
  const SafeTensors data = SafeTensors::read(stem + ".safetensors");
  cv::dnn::Net plain = load({bytes.begin(), bytes.end()});
  cv::dnn::Net fused = load(fusion.bytes);
  const std::vector<cv::Mat> expected = forward(plain, data);
  const std::vector<cv::Mat> outputs = forward(fused, data);
  ASSERT_EQ(outputs.size(), 2U);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_LT(relative_error(values_of(outputs[i]), values_of(expected[i])), 1e-4);
    EXPECT_LT(
        relative_error(values_of(outputs[i]), values_of(data.at("output" + std::to_string(i)))),
        1e-4);
  }
#if defined(NDEBUG)
  // By turns, the best of each, so that what else the machine does cancels.
  double best_plain = 1e9;
  double best_fused = 1e9;
  for (int i = 0; i < 7; ++i) {
    best_plain = std::min(best_plain, milliseconds(plain, data));
    best_fused = std::min(best_fused, milliseconds(fused, data));
  }
  EXPECT_LT(best_fused, best_plain);
  RecordProperty("plain_us", static_cast<int>(1000 * best_plain));
  RecordProperty("fused_us", static_cast<int>(1000 * best_fused));
#endif
}

}  // namespace
}  // namespace dynslam::attention
