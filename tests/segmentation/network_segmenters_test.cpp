// The other networks, on tiny graphs with the real output layouts (data/make_networks.py).
#include "dynslam/segmentation/network_segmenters.hpp"

#include <algorithm>
#include <fstream>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/decoders/dense_mask.hpp"
#include "dynslam/segmentation/decoders/yolo.hpp"
#include "dynslam/segmentation/segmenter_factory.hpp"

#include "segmentation/masks.hpp"
#include "segmentation/test_paths.hpp"
#include "temp_folder.hpp"

// ONNX Runtime keeps a few bytes of its own at exit, which the leak sanitizer would count as ours.
extern "C" const char* __lsan_default_suppressions() { return "leak:libonnxruntime.so\n"; }

// OpenCV writes images with GDAL's help, whose own locks the thread sanitizer finds fault with.
extern "C" const char* __tsan_default_suppressions() { return "deadlock:libgdal.so\n"; }

namespace dynslam::segmentation {
namespace {

TEST(Yolox, DecodesGridsAndStrides) {
  BoxSegmenter segmenter(test_file("tiny_yolox.onnx"), BoxNetwork::kYolox);
  const Segmentation found = segmenter.segment(grey(128, 64), {});
  // 128 x 64 fits the 64 x 64 input at half size, in the upper left corner.
  ASSERT_EQ(found.instances.size(), 2U);
  EXPECT_EQ(found.instances[0].class_id, 1);
  EXPECT_EQ(found.instances[0].box, cv::Rect(32, 20, 48, 32));
  EXPECT_NEAR(found.instances[0].score, 0.81F, 1e-5F);
  EXPECT_EQ(found.instances[1].class_id, 0);
  EXPECT_EQ(found.instances[1].box, cv::Rect(64, 0, 64, 64));
  EXPECT_EQ(cv::countNonZero(found.instances[1].mask), 64 * 64);
  EXPECT_EQ(segmenter.class_names()[1], "ball");
  EXPECT_EQ(segmenter.info().kind, "yolox");
}

TEST(Yolox, RefusesAnotherNumberOfCandidates) {
  EXPECT_THROW(BoxSegmenter(test_file("tiny_yolov5.onnx"), BoxNetwork::kYolox), IoError);
  EXPECT_THROW(BoxSegmenter(test_file("tiny_classifier.onnx"), BoxNetwork::kYolo), IoError);
  const float rows[7] = {};
  std::vector<Detection> out;
  EXPECT_THROW(decode_yolox(MatrixView(rows, 7, 1), 2, 64, 64, 0.3F, out), InvalidArgument);
  EXPECT_THROW(decode_yolox(MatrixView(rows, 7, 1), 3, 8, 8, 0.3F, out), InvalidArgument);
  EXPECT_THROW(decode_yolox(MatrixView(rows, 7, 1), 0, 8, 8, 0.3F, out), InvalidArgument);
  EXPECT_THROW(decode_darknet(MatrixView(rows, 7, 1), 3, 8, 8, 0.3F, out), InvalidArgument);
  EXPECT_THROW(decode_darknet(MatrixView(rows, 7, 1), 0, 8, 8, 0.3F, out), InvalidArgument);
}

TEST(YoloBoxes, AreReadWithoutMasks) {
  BoxSegmenter segmenter(test_file("tiny_yolov5.onnx"), BoxNetwork::kYolo);
  const Segmentation found = segmenter.segment(grey(64, 64), {});
  ASSERT_EQ(found.instances.size(), 1U);
  EXPECT_EQ(found.instances[0].box, cv::Rect(22, 16, 20, 16));
  EXPECT_EQ(segmenter.class_names()[1], "class 1") << "the model has no names and not COCO's 80";
}

TEST(Darknet, StretchesTheImageToItsInput) {
  DarknetSegmenter segmenter(test_file("tiny_darknet.cfg"), test_file("tiny_darknet.weights"));
  const Segmentation found = segmenter.segment(grey(64, 32), {});
  // Every cell of 4 x 4 sees a thing of 16 x 16 network pixels around its own middle; in an image
  // of twice the width it is twice as wide.
  ASSERT_EQ(found.instances.size(), 16U);
  const bool second_cell =
      std::any_of(found.instances.begin(), found.instances.end(),
                  [](const Instance& instance) { return instance.box == cv::Rect(8, 4, 32, 16); });
  EXPECT_TRUE(second_cell);
  EXPECT_NEAR(found.instances[0].score, 0.982F * 0.982F, 0.001F);
  EXPECT_EQ(segmenter.info().kind, "darknet");
  EXPECT_EQ(segmenter.info().inputs[0].shape, (std::vector<std::int64_t>{1, 3, 32, 32}));
}

TEST(Darknet, RefusesWhatIsNotANetwork) {
  const std::string weights = test_file("tiny_darknet.weights");
  const auto refused = [&](const std::string& cfg) {
    const std::string bad = dynslam::testing::temp_path("bad.cfg");
    std::ofstream(bad) << cfg;
    return message_of<IoError>([&] { DarknetSegmenter segmenter(bad, weights); });
  };
  EXPECT_NE(refused("hello").find("[net]"), std::string::npos);
  EXPECT_NE(refused("[net]\nwidth=x\nheight=32\n").find("[net]"), std::string::npos);
  EXPECT_NE(refused("[net]\nwidth=32\nheight=32\n").find("[yolo]"), std::string::npos);
  EXPECT_NE(refused("").find("empty"), std::string::npos);
  EXPECT_THROW(DarknetSegmenter("none.cfg", weights), IoError);
  EXPECT_THROW(DarknetSegmenter(test_file("tiny_darknet.cfg"), "none.weights"), IoError);
  NetworkOptions options;
  options.backend = Backend::kOnnxRuntime;
  EXPECT_THROW(DarknetSegmenter(test_file("tiny_darknet.cfg"), weights, options), InvalidArgument);
}

TEST(Semantic, GivesAnInstanceForEachClass) {
  SemanticSegmenter segmenter(test_file("tiny_semantic.onnx"));
  cv::Mat image(128, 192, CV_8UC3, cv::Scalar(255, 255, 255));
  image(cv::Rect(16, 32, 64, 48)).setTo(cv::Scalar(0, 0, 255));
  image(cv::Rect(120, 64, 40, 40)).setTo(cv::Scalar(0, 255, 0));
  const Segmentation found = segmenter.segment(image, {});
  ASSERT_EQ(found.instances.size(), 2U);
  const Instance& person =
      found.instances[0].class_id == 1 ? found.instances[0] : found.instances[1];
  EXPECT_EQ(segmenter.class_names()[1], "person");
  EXPECT_LE(std::abs(person.box.x - 16), 8);
  EXPECT_LE(std::abs(person.box.width - 64), 16);
  EXPECT_NEAR(cv::countNonZero(person.mask), 64 * 48, 1000);
  EXPECT_GT(person.score, 0.3F);
}

TEST(MaskRcnn, PastesMasksIntoBoxes) {
  if (!backend_available(Backend::kOnnxRuntime)) GTEST_SKIP() << "needs ONNX Runtime";
  NetworkOptions options;
  options.backend = Backend::kOnnxRuntime;
  MaskRcnnSegmenter segmenter(test_file("tiny_mask_rcnn.onnx"), options);
  const Segmentation found = segmenter.segment(grey(192, 128), {});
  ASSERT_EQ(found.instances.size(), 2U);
  EXPECT_EQ(segmenter.class_names().at(static_cast<std::size_t>(found.instances[0].class_id)),
            "person");
  EXPECT_EQ(segmenter.class_names().at(static_cast<std::size_t>(found.instances[1].class_id)),
            "dog");
  const Instance& person = found.instances[0];
  EXPECT_EQ(person.box, cv::Rect(16, 16, 64, 96));
  EXPECT_EQ(cv::countNonZero(person.mask(cv::Rect(0, 0, 30, 96))), 30 * 96) << "left half";
  EXPECT_EQ(cv::countNonZero(person.mask(cv::Rect(34, 0, 30, 96))), 0) << "right half";
}

TEST(MaskRcnn, RefusesAModelWithOtherOutputs) {
  EXPECT_THROW(MaskRcnnSegmenter(test_file("tiny_yolov5_seg.onnx")), IoError);
  EXPECT_THROW(SemanticSegmenter(test_file("tiny_classifier.onnx")), IoError);
}

TEST(ClassLists, HaveTheNumbersOfTheirSources) {
  ASSERT_EQ(coco91_class_names().size(), 91U);
  EXPECT_EQ(coco91_class_names()[1], "person");
  EXPECT_EQ(coco91_class_names()[12], "n/a");
  EXPECT_EQ(coco91_class_names()[44], "bottle");
  EXPECT_EQ(coco91_class_names()[62], "chair");
  EXPECT_EQ(coco91_class_names()[90], "toothbrush");
  ASSERT_EQ(voc_class_names().size(), 21U);
  EXPECT_EQ(voc_class_names()[15], "person");
}

TEST(OnnxRuntime, GivesTheMasksOfOpenCv) {
  NetworkOptions options;
  options.backend = Backend::kOnnxRuntime;
  if (!backend_available(Backend::kOnnxRuntime)) {
    const std::string message = message_of<IoError>(
        [&] { YoloSegSegmenter segmenter(test_file("tiny_yolov5_seg.onnx"), options); });
    EXPECT_NE(message.find("onnxruntime"), std::string::npos) << message;
    return;
  }
  options.threads = 1;
  for (const char* model : {"tiny_yolov5_seg.onnx", "tiny_yolov8_seg.onnx"}) {
    YoloSegSegmenter opencv(test_file(model));
    YoloSegSegmenter onnxruntime(test_file(model), options);
    cv::Mat image(128, 192, CV_8UC3, cv::Scalar(255, 0, 0));
    cv::circle(image, {48, 64}, 24, cv::Scalar(0, 0, 255), cv::FILLED);
    const Segmentation a = opencv.segment(image, {});
    const Segmentation b = onnxruntime.segment(image, {});
    EXPECT_EQ(onnxruntime.info().backend, "onnxruntime");
    ASSERT_EQ(a.instances.size(), b.instances.size());
    for (std::size_t i = 0; i < a.instances.size(); ++i) {
      ASSERT_EQ(a.instances[i].box, b.instances[i].box);
      EXPECT_LE(cv::countNonZero(a.instances[i].mask != b.instances[i].mask), 2);
    }
  }
}

TEST(PasteMask, ChecksItsViews) {
  const Letterbox map = make_letterbox({10, 10}, {10, 10});
  const float one[1] = {1.0F};
  EXPECT_THROW(paste_mask({}, {}, map, {0, 0, 2, 2}), InvalidArgument);
  EXPECT_THROW(paste_mask({one, 1, 1}, {}, map, {}), InvalidArgument);
  EXPECT_THROW(decode_semantic({}, map), InvalidArgument);
  const std::vector<float> many(256);
  EXPECT_THROW(decode_semantic({many.data(), 256, 1, 1}, map), InvalidArgument);
}

}  // namespace
}  // namespace dynslam::segmentation
