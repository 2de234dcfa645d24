// The networks of the papers that are too large to lie here, on small graphs with their exact
// layers or output layouts (data/make_networks.py): YOLOv4-tiny, Mask R-CNN of TensorFlow and of
// torchvision; and what is no such network.
#include <algorithm>
#include <fstream>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/network_segmenters.hpp"
#include "dynslam/segmentation/segmenter_factory.hpp"

#include "segmentation/darknet_cfg.hpp"
#include "segmentation/masks.hpp"
#include "segmentation/onnxruntime_library.hpp"
#include "segmentation/test_paths.hpp"
#include "temp_folder.hpp"

namespace dynslam::segmentation {
namespace {

std::string bytes_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

int count_boxes(const Segmentation& found, cv::Size size) {
  return static_cast<int>(
      std::count_if(found.instances.begin(), found.instances.end(),
                    [&](const Instance& instance) { return instance.box.size() == size; }));
}

// ------------------------------------------------------------------------------ YOLOv4-tiny

TEST(YoloV4Tiny, ReadsBothOfItsHeads) {
  DarknetSegmenter segmenter(test_file("tiny_yolov4.cfg"), test_file("tiny_yolov4.weights"));
  const Segmentation found = segmenter.segment(grey(64, 64), {});
  // One head has 2 x 2 cells and sees things of 20 x 24, the other 4 x 4 cells and 8 x 12.
  EXPECT_EQ(found.instances.size(), 20U);
  EXPECT_EQ(count_boxes(found, {20, 24}), 4);
  EXPECT_EQ(count_boxes(found, {8, 12}), 16);
  EXPECT_EQ(segmenter.info().outputs.size(), 2U);
  EXPECT_EQ(segmenter.class_names().size(), 1U);
}

TEST(YoloV4Tiny, RefusesWeightsThatAreCutShort) {
  const std::string cfg = test_file("tiny_yolov4.cfg");
  const std::string whole = bytes_of(test_file("tiny_yolov4.weights"));
  const std::string cut = dynslam::testing::temp_path("short.weights");
  for (const std::size_t length : {whole.size() - 1, whole.size() / 2, std::size_t{20}}) {
    std::ofstream(cut, std::ios::binary) << whole.substr(0, length);
    const std::string message = message_of<IoError>([&] { DarknetSegmenter segmenter(cfg, cut); });
    EXPECT_NE(message.find("short.weights"), std::string::npos) << message;
    EXPECT_NE(message.find("cut short"), std::string::npos) << message;
  }
  std::ofstream(cut, std::ios::binary) << "abc";
  EXPECT_THROW(DarknetSegmenter(cfg, cut), IoError);
}

TEST(DarknetCfg, CountsTheWeightsOfARealNetwork) {
  const std::string cfg_file = shared_data("models/yolo-fastest-1.1-xl.cfg");
  const std::string weights_file = shared_data("models/yolo-fastest-1.1-xl.weights");
  if (cfg_file.empty() || weights_file.empty()) {
    GTEST_SKIP() << "needs the shared data (DYNSLAM_DATA)";
  }
  const DarknetCfg cfg = read_darknet_cfg(cfg_file, bytes_of(cfg_file));
  ASSERT_TRUE(cfg.weights.has_value());
  EXPECT_EQ(*cfg.weights * 4 + 20, bytes_of(weights_file).size());
}

TEST(DarknetCfg, SaysNothingOfWeightsWhereItDoesNotKnowALayer) {
  const std::string head = "[net]\nwidth=8\nheight=8\n[convolutional]\nfilters=6\nsize=1\n";
  const std::string tail = "[yolo]\nclasses=1\n";
  EXPECT_EQ(read_darknet_cfg("x", head + tail).weights, 6U * 3 + 6);
  EXPECT_FALSE(read_darknet_cfg("x", head + "[crnn]\n" + tail).weights.has_value());
  EXPECT_FALSE(read_darknet_cfg("x", head + "[route]\nlayers=-7\n" + tail).weights.has_value());
  EXPECT_FALSE(read_darknet_cfg("x", head + "[convolutional]\ngroups=0\n" + tail).weights);
}

// ------------------------------------------------------------------------------- Mask R-CNN

NetworkOptions size_32() {
  NetworkOptions options;
  options.input_width = options.input_height = 32;
  return options;
}

TEST(MaskRcnnTensorflow, PastesTheMaskOfTheClassIntoTheBox) {
  MaskRcnnTensorflowSegmenter segmenter(test_file("tiny_mask_rcnn_tensorflow.pb"), "", size_32());
  const Segmentation found = segmenter.segment(grey(128, 64), {});
  ASSERT_EQ(found.instances.size(), 2U) << "the third is too weak";
  const Instance& first = found.instances[0];
  EXPECT_EQ(first.class_id, 0);
  EXPECT_NEAR(first.score, 0.95F, 1e-5F);
  EXPECT_EQ(first.box, cv::Rect(32, 16, 64, 32)) << "shares of the image in each direction";
  EXPECT_EQ(cv::countNonZero(first.mask(cv::Rect(0, 0, 25, 32))), 25 * 32) << "left half";
  EXPECT_EQ(cv::countNonZero(first.mask(cv::Rect(36, 0, 28, 32))), 0) << "right half";
  const Instance& second = found.instances[1];
  EXPECT_EQ(second.class_id, 2);
  EXPECT_EQ(second.box, cv::Rect(0, 32, 32, 32));
  EXPECT_EQ(cv::countNonZero(second.mask(cv::Rect(0, 0, 12, 32))), 0);
  EXPECT_EQ(cv::countNonZero(second.mask(cv::Rect(20, 0, 12, 32))), 12 * 32);
  EXPECT_EQ(segmenter.info().kind, "mask-rcnn");
  EXPECT_EQ(segmenter.info().sha256.size(), 64U);
  EXPECT_EQ(segmenter.info().outputs.at(1).shape, (std::vector<std::int64_t>{3, 3, 15, 15}));
}

TEST(MaskRcnnTensorflow, IsMadeByName) {
  SegmenterFactoryOptions options;
  options.refine = false;
  const auto segmenter =
      make_segmenter("mask-rcnn:" + test_file("tiny_mask_rcnn_tensorflow.pb") + "@32x32", options);
  EXPECT_EQ(segmenter->segment(grey(64, 64), {}).instances.size(), 2U);
}

TEST(MaskRcnnTensorflow, RefusesOtherGraphsNamesAndBackends) {
  const std::string graph = test_file("tiny_mask_rcnn_tensorflow.pb");
  const auto refused = [](const std::string& file, const std::string& config) {
    return message_of<IoError>(
        [&] { MaskRcnnTensorflowSegmenter segmenter(file, config, size_32()); });
  };
  EXPECT_NE(refused(test_file("tiny_other_tensorflow.pb"), "").find("detection_out_final"),
            std::string::npos);
  EXPECT_NE(refused("none.pb", "").find("none.pb"), std::string::npos);
  EXPECT_NE(refused(graph, "none.pbtxt").find("none.pbtxt"), std::string::npos);
  const std::string half = dynslam::testing::temp_path("half.pb");
  std::ofstream(half, std::ios::binary) << bytes_of(graph).substr(0, 9000);
  EXPECT_NE(refused(half, "").find("half.pb"), std::string::npos);
  NetworkOptions options = size_32();
  options.class_names = {"one", "two"};
  EXPECT_THROW(MaskRcnnTensorflowSegmenter(graph, "", options), InvalidArgument);
  options = size_32();
  options.backend = Backend::kOnnxRuntime;
  EXPECT_THROW(MaskRcnnTensorflowSegmenter(graph, "", options), InvalidArgument);
  MaskRcnnTensorflowSegmenter segmenter(graph, "", size_32());
  EXPECT_THROW(segmenter.segment(cv::Mat(), {}), InvalidArgument);
}

TEST(MaskRcnnTorchvision, TakesMasksThatCoverTheInput) {
  if (!backend_available(Backend::kOnnxRuntime)) GTEST_SKIP() << "needs ONNX Runtime";
  NetworkOptions options;
  options.backend = Backend::kOnnxRuntime;
  const std::string file = test_file("tiny_mask_rcnn_pasted.onnx");
  EXPECT_THROW(MaskRcnnSegmenter(file, options), InvalidArgument)
      << "the file leaves its size open";
  options.input_width = 96;
  options.input_height = 64;
  MaskRcnnSegmenter segmenter(file, options);
  const Segmentation found = segmenter.segment(grey(192, 128), {});
  ASSERT_EQ(found.instances.size(), 2U);
  const Instance& person = found.instances[0];
  EXPECT_EQ(segmenter.class_names().at(static_cast<std::size_t>(person.class_id)), "person");
  EXPECT_EQ(person.box, cv::Rect(16, 16, 64, 96));
  EXPECT_EQ(cv::countNonZero(person.mask(cv::Rect(0, 0, 30, 96))), 30 * 96) << "left half";
  EXPECT_EQ(cv::countNonZero(person.mask(cv::Rect(34, 0, 30, 96))), 0) << "right half";
  EXPECT_EQ(cv::countNonZero(found.instances[1].mask), 0);
}

TEST(MaskRcnnTorchvision, SaysThatOpenCvCannotRunIt) {
  const std::string message =
      message_of<IoError>([] { MaskRcnnSegmenter segmenter(test_file("tiny_mask_rcnn.onnx")); });
  EXPECT_NE(message.find("tiny_mask_rcnn.onnx"), std::string::npos) << message;
}

// -------------------------------------------------------------------- what no network can help

TEST(EverySegmenter, RefusesWhatIsNotAnImage) {
  const std::vector<std::string> specs = {
      "none",
      "yolo-seg:" + test_file("tiny_yolov8_seg.onnx"),
      "yolo:" + test_file("tiny_yolov5.onnx"),
      "yolox:" + test_file("tiny_yolox.onnx"),
      "darknet:" + test_file("tiny_yolov4.cfg") + "," + test_file("tiny_yolov4.weights"),
      "mask-rcnn:" + test_file("tiny_mask_rcnn_tensorflow.pb") + "@32x32",
      "semantic:" + test_file("tiny_semantic.onnx")};
  for (const std::string& spec : specs) {
    const auto segmenter = make_segmenter(spec);
    EXPECT_THROW(segmenter->segment(cv::Mat(), {}), InvalidArgument) << spec << ", no image";
    EXPECT_THROW(segmenter->segment(cv::Mat(0, 7, CV_8UC3), {}), InvalidArgument) << spec;
    EXPECT_THROW(segmenter->segment(cv::Mat(8, 8, CV_16UC1), {}), InvalidArgument) << spec;
    EXPECT_THROW(segmenter->segment(cv::Mat(8, 8, CV_8UC2), {}), InvalidArgument) << spec;
    const int volume[3] = {4, 4, 4};
    EXPECT_THROW(segmenter->segment(cv::Mat(3, volume, CV_8UC1), {}), InvalidArgument) << spec;
    EXPECT_NO_THROW(segmenter->segment(grey(1, 1), {})) << spec << ", the smallest image";
  }
}

TEST(EveryNetwork, RefusesNamesOfAnotherNumber) {
  SegmenterFactoryOptions options;
  options.network.class_names = {"a", "b", "c", "d"};
  for (const std::string& spec :
       {"yolo-seg:" + test_file("tiny_yolov8_seg.onnx"), "yolo:" + test_file("tiny_yolov5.onnx"),
        "yolox:" + test_file("tiny_yolox.onnx"), "semantic:" + test_file("tiny_semantic.onnx"),
        "darknet:" + test_file("tiny_yolov4.cfg") + "," + test_file("tiny_yolov4.weights")}) {
    const std::string message = message_of<InvalidArgument>([&] { make_segmenter(spec, options); });
    EXPECT_NE(message.find("class_names"), std::string::npos) << spec << ": " << message;
  }
}

TEST(OnnxRuntime, IsMissedInWordsWhenItsLibraryIsGone) {
  const std::string problem = onnxruntime_problem({"/no/such/libonnxruntime.so"});
  EXPECT_NE(problem, "");
  if (!backend_available(Backend::kOnnxRuntime)) return;
  EXPECT_NE(problem.find("/no/such/libonnxruntime.so"), std::string::npos) << problem;
  EXPECT_NE(onnxruntime_problem({"libm.so.6"}).find("OrtGetApiBase"), std::string::npos);
}

}  // namespace
}  // namespace dynslam::segmentation
