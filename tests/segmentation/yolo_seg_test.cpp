// YOLO segmentation from file to mask, on tiny networks with the real output layouts
// (data/make_networks.py), and on the real network where it is at hand.
#include <fstream>
#include <limits>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/yolo_seg_segmenter.hpp"

#include "segmentation/masks.hpp"
#include "segmentation/test_paths.hpp"
#include "temp_folder.hpp"

namespace dynslam::segmentation {
namespace {

// A red disc on the left, where the tiny networks see a person; everything else is blue.
cv::Mat red_disc(cv::Size size, cv::Mat* disc = nullptr) {
  cv::Mat image(size, CV_8UC3, cv::Scalar(255, 0, 0));
  const cv::Point centre(size.width / 4, size.height / 2);
  const int radius = size.width / 8;
  cv::circle(image, centre, radius, cv::Scalar(0, 0, 255), cv::FILLED);
  if (disc != nullptr) {
    *disc = cv::Mat::zeros(size, CV_8UC1);
    cv::circle(*disc, centre, radius, cv::Scalar(255), cv::FILLED);
  }
  return image;
}

cv::Mat pasted(const Instance& instance, cv::Size size) {
  cv::Mat whole = cv::Mat::zeros(size, CV_8UC1);
  instance.mask.copyTo(whole(instance.box));
  return whole;
}

class TinyYolo : public ::testing::TestWithParam<const char*> {
 protected:
  YoloSegSegmenter segmenter_{test_file(GetParam())};
};

TEST_P(TinyYolo, KeepsTheBestOfEachClassAboveTheThreshold) {
  const Segmentation found = segmenter_.segment(red_disc({96, 64}), {});
  ASSERT_EQ(found.instances.size(), 3U);
  EXPECT_EQ(found.width, 96);
  EXPECT_EQ(found.height, 64);
  EXPECT_EQ(found.instances[0].class_id, 0);
  EXPECT_NEAR(found.instances[0].score, 0.9F * 0.9F, 1e-6F);
  EXPECT_EQ(found.instances[0].box, cv::Rect(8, 12, 32, 40));
  EXPECT_EQ(found.instances[1].class_id, 2);
  EXPECT_EQ(found.instances[1].box, cv::Rect(8, 12, 32, 40)) << "another class is not suppressed";
  EXPECT_EQ(found.instances[2].class_id, 1);
  EXPECT_EQ(found.instances[2].box, cv::Rect(70, 40, 26, 24)) << "boxes are cut at the image";
}

TEST_P(TinyYolo, KnowsTheNamesOfItsClasses) {
  EXPECT_EQ(segmenter_.class_names(), (std::vector<std::string>{"person", "office chair", "dog"}));
}

TEST_P(TinyYolo, TellsWhatItIs) {
  const SegmenterInfo info = segmenter_.info();
  EXPECT_EQ(info.kind,
            std::string(GetParam()) == "tiny_yolov8_seg.onnx" ? "yolov8-seg" : "yolov5-seg");
  EXPECT_EQ(info.backend, "opencv");
  EXPECT_EQ(info.sha256.size(), 64U);
  ASSERT_EQ(info.inputs.size(), 1U);
  EXPECT_EQ(info.inputs[0].shape, (std::vector<std::int64_t>{1, 3, 64, 96}));
  EXPECT_EQ(info.outputs.size(), 2U);
}

TEST_P(TinyYolo, CutsTheMaskWhereTheImageHasIt) {
  cv::Mat disc;
  const cv::Mat image = red_disc({96, 64}, &disc);
  const Segmentation found = segmenter_.segment(image, {});
  ASSERT_EQ(found.instances.size(), 3U);
  EXPECT_GT(iou(pasted(found.instances[0], image.size()), disc), 0.9);
  EXPECT_EQ(cv::countNonZero(found.instances[1].mask), 0) << "nothing is green";
}

TEST_P(TinyYolo, TakesImagesOfAnySize) {
  for (const cv::Size size : {cv::Size(192, 128), cv::Size(480, 320), cv::Size(97, 65)}) {
    cv::Mat disc;
    const cv::Mat image = red_disc(size, &disc);
    const Segmentation found = segmenter_.segment(image, {});
    ASSERT_EQ(found.instances.size(), 3U);
    EXPECT_EQ(found.width, size.width);
    const cv::Rect image_rect(cv::Point(), size);
    for (const Instance& instance : found.instances) {
      EXPECT_EQ(instance.box & image_rect, instance.box);
      EXPECT_EQ(instance.mask.size(), instance.box.size());
    }
    EXPECT_GT(iou(pasted(found.instances[0], size), disc), 0.9) << size;
  }
}

TEST_P(TinyYolo, PutsTallImagesBetweenGreyBorders) {
  // 64 x 128 scaled by half is 32 wide, so it starts at network column 32: the person's box, 8 to
  // 40 there, reaches to image column 16.
  cv::Mat image(128, 64, CV_8UC3, cv::Scalar(0, 0, 255));
  const Segmentation found = segmenter_.segment(image, {});
  ASSERT_GE(found.instances.size(), 1U);
  EXPECT_EQ(found.instances[0].box, cv::Rect(0, 24, 16, 80));
  EXPECT_GT(cv::countNonZero(found.instances[0].mask), 0.9 * 16 * 80) << "all of it is red";
}

TEST_P(TinyYolo, TakesGreyImagesAndImagesWithAlpha) {
  cv::Mat disc;
  const cv::Mat image = red_disc({96, 64}, &disc);
  cv::Mat with_alpha;
  cv::cvtColor(image, with_alpha, cv::COLOR_BGR2BGRA);
  const Segmentation coloured = segmenter_.segment(image, {});
  const Segmentation alpha = segmenter_.segment(with_alpha, {});
  ASSERT_EQ(alpha.instances.size(), coloured.instances.size());
  EXPECT_EQ(cv::norm(alpha.instances[0].mask, coloured.instances[0].mask, cv::NORM_L1), 0.0);

  const Segmentation grey = segmenter_.segment(disc, {});
  ASSERT_EQ(grey.instances.size(), 3U);
  EXPECT_GT(iou(pasted(grey.instances[0], disc.size()), disc), 0.9);
}

TEST_P(TinyYolo, TakesImagesThatAreWindowsOfLargerOnes) {
  const cv::Mat image = red_disc({96, 64});
  cv::Mat larger(100, 200, CV_8UC3, cv::Scalar(9, 9, 9));
  image.copyTo(larger(cv::Rect(50, 20, 96, 64)));
  const Segmentation whole = segmenter_.segment(image, {});
  const Segmentation window = segmenter_.segment(larger(cv::Rect(50, 20, 96, 64)), {});
  ASSERT_EQ(window.instances.size(), whole.instances.size());
  EXPECT_EQ(cv::norm(window.instances[0].mask, whole.instances[0].mask, cv::NORM_L1), 0.0);
}

TEST_P(TinyYolo, GivesTheSameAnswerTwice) {
  const cv::Mat image = red_disc({192, 128});
  const Segmentation first = segmenter_.segment(image, {});
  const Segmentation second = segmenter_.segment(image, {});
  ASSERT_EQ(first.instances.size(), second.instances.size());
  for (std::size_t i = 0; i < first.instances.size(); ++i) {
    EXPECT_EQ(cv::norm(first.instances[i].mask, second.instances[i].mask, cv::NORM_L1), 0.0);
  }
}

INSTANTIATE_TEST_SUITE_P(Layouts, TinyYolo,
                         ::testing::Values("tiny_yolov5_seg.onnx", "tiny_yolov8_seg.onnx"),
                         [](const auto& test) { return std::string(test.param).substr(5, 6); });

TEST(YoloSegSegmenter, ObeysItsThresholds) {
  NetworkOptions options;
  options.score_threshold = 0.1F;
  options.nms_threshold = 1.0F;
  YoloSegSegmenter all(test_file("tiny_yolov5_seg.onnx"), options);
  EXPECT_EQ(all.segment(red_disc({96, 64}), {}).instances.size(), 5U);
  options.max_instances = 2;
  YoloSegSegmenter two(test_file("tiny_yolov5_seg.onnx"), options);
  EXPECT_EQ(two.segment(red_disc({96, 64}), {}).instances.size(), 2U);
}

TEST(YoloSegSegmenter, RunsAModelOfOpenSizeAtTheSizeOfTheOptions) {
  NetworkOptions options;
  options.input_width = 96;
  options.input_height = 64;
  YoloSegSegmenter segmenter(test_file("tiny_open_size.onnx"), options);
  cv::Mat disc;
  const cv::Mat image = red_disc({96, 64}, &disc);
  const Segmentation found = segmenter.segment(image, {});
  ASSERT_EQ(found.instances.size(), 3U);
  EXPECT_GT(iou(pasted(found.instances[0], image.size()), disc), 0.9);
}

TEST(YoloSegSegmenter, RefusesAModelOfOpenSizeWithoutASize) {
  const std::string message = message_of<InvalidArgument>(
      [] { YoloSegSegmenter segmenter(test_file("tiny_open_size.onnx")); });
  EXPECT_NE(message.find("input_width"), std::string::npos) << message;
  EXPECT_NE(message.find("tiny_open_size.onnx"), std::string::npos) << message;
}

TEST(YoloSegSegmenter, RefusesAnotherSizeThanTheModelHas) {
  NetworkOptions options;
  options.input_width = 100;
  options.input_height = 64;
  EXPECT_THROW(YoloSegSegmenter(test_file("tiny_yolov5_seg.onnx"), options), InvalidArgument);
}

TEST(YoloSegSegmenter, RefusesAModelWithOtherOutputs) {
  const std::string message =
      message_of<IoError>([] { YoloSegSegmenter segmenter(test_file("tiny_classifier.onnx")); });
  EXPECT_NE(message.find("tiny_classifier.onnx"), std::string::npos) << message;
  EXPECT_NE(message.find("1x4"), std::string::npos) << message;
  EXPECT_NE(message.find("prototypes"), std::string::npos) << message;
}

TEST(YoloSegSegmenter, RefusesAModelWithOtherInputs) {
  const std::string message =
      message_of<IoError>([] { YoloSegSegmenter segmenter(test_file("tiny_two_inputs.onnx")); });
  EXPECT_NE(message.find("left 1x3x8x8, right 1x3x8x8"), std::string::npos) << message;
}

TEST(YoloSegSegmenter, RefusesAListOfNamesOfAnotherLength) {
  const std::string own =
      message_of<IoError>([] { YoloSegSegmenter segmenter(test_file("tiny_wrong_names.onnx")); });
  EXPECT_NE(own.find("names 2 classes"), std::string::npos) << own;
  NetworkOptions options;
  options.class_names = {"one"};
  const std::string given = message_of<InvalidArgument>(
      [&] { YoloSegSegmenter segmenter(test_file("tiny_yolov5_seg.onnx"), options); });
  EXPECT_NE(given.find("class_names"), std::string::npos) << given;
}

TEST(YoloSegSegmenter, PrefersTheNamesItIsGiven) {
  NetworkOptions options;
  options.class_names = {"a", "b", "c"};
  YoloSegSegmenter segmenter(test_file("tiny_yolov5_seg.onnx"), options);
  EXPECT_EQ(segmenter.class_names(), options.class_names);
}

TEST(YoloSegSegmenter, RefusesWhatIsNotANetworkInOneSentence) {
  const auto refused = [](const std::string& content, const std::string& expected) {
    const std::string path = dynslam::testing::temp_path("not_a_network.onnx");
    std::ofstream(path, std::ios::binary) << content;
    const std::string message = message_of<IoError>([&] { YoloSegSegmenter segmenter(path); });
    EXPECT_NE(message.find(path), std::string::npos) << message;
    EXPECT_NE(message.find(expected), std::string::npos) << message;
    EXPECT_EQ(message.find('\n'), std::string::npos) << message;
  };
  ::testing::internal::CaptureStderr();
  refused("", "is empty");
  refused("<html>404</html>", "not a network");
  refused(std::string(1000, '\xff'), "not a network");
  refused(std::string("\x08\x07", 2), "ONNX model");
  std::ifstream file(test_file("tiny_yolov5_seg.onnx"), std::ios::binary);
  const std::string whole{std::istreambuf_iterator<char>(file), {}};
  for (const std::size_t length : {whole.size() - 1, whole.size() / 2, std::size_t{100}}) {
    refused(whole.substr(0, length), "cut short or damaged");
  }
  EXPECT_EQ(::testing::internal::GetCapturedStderr(), "") << "nobody else speaks about it";
  EXPECT_THROW(YoloSegSegmenter("there_is_no_such_file.onnx"), IoError);
  EXPECT_THROW(YoloSegSegmenter("."), IoError);
}

TEST(YoloSegSegmenter, RefusesWhatIsNotAnImage) {
  YoloSegSegmenter segmenter(test_file("tiny_yolov5_seg.onnx"));
  EXPECT_THROW(segmenter.segment(cv::Mat(), {}), InvalidArgument);
  EXPECT_THROW(segmenter.segment(cv::Mat(64, 96, CV_32FC3), {}), InvalidArgument);
  EXPECT_THROW(segmenter.segment(cv::Mat(64, 96, CV_16UC1), {}), InvalidArgument);
  const std::vector<float> depth(10 * 10);
  FrameInfo frame;
  frame.depth = DepthView(depth.data(), 10, 10);
  EXPECT_THROW(segmenter.segment(red_disc({96, 64}), frame), InvalidArgument);
}

TEST(NetworkOptions, AreCheckedByName) {
  const auto refused = [](const char* name, auto change) {
    NetworkOptions options;
    change(options);
    const std::string message = message_of<InvalidArgument>([&] { options.validate(); });
    EXPECT_NE(message.find(name), std::string::npos) << name << ": " << message;
  };
  EXPECT_NO_THROW(NetworkOptions().validate());
  refused("threads", [](NetworkOptions& o) { o.threads = -1; });
  refused("score_threshold", [](NetworkOptions& o) { o.score_threshold = 1.5F; });
  refused("score_threshold",
          [](NetworkOptions& o) { o.score_threshold = std::numeric_limits<float>::quiet_NaN(); });
  refused("nms_threshold", [](NetworkOptions& o) { o.nms_threshold = -0.1F; });
  refused("max_instances", [](NetworkOptions& o) { o.max_instances = 0; });
  refused("input_width, input_height", [](NetworkOptions& o) { o.input_width = 64; });
  refused("input_width", [](NetworkOptions& o) { o.input_width = o.input_height = -1; });
  refused("input_height", [](NetworkOptions& o) { o.input_width = 9, o.input_height = 9999; });
}

TEST(YoloSegSegmenter, FindsThePeopleOfARealImage) {
  const std::string model = shared_data("models/yolov5n-seg_256x320.onnx");
  const std::string folder = shared_data("kitchen_people");
  if (model.empty() || folder.empty()) GTEST_SKIP() << "needs the shared data (DYNSLAM_DATA)";
  YoloSegSegmenter segmenter(model);
  const cv::Mat image = cv::imread(folder + "/rgb/1006.600000.jpg");
  const cv::Mat truth = cv::imread(folder + "/mask/1006.600000.png", cv::IMREAD_UNCHANGED);
  ASSERT_FALSE(image.empty());
  ASSERT_FALSE(truth.empty());
  const Segmentation found = segmenter.segment(image, {});
  cv::Mat people = cv::Mat::zeros(image.size(), CV_8UC1);
  for (const Instance& instance : found.instances) {
    if (instance.class_id == 0) people |= pasted(instance, image.size());
  }
  EXPECT_EQ(segmenter.class_names().at(0), "person");
  EXPECT_GT(iou(people, truth == 1), 0.6);
}

}  // namespace
}  // namespace dynslam::segmentation
