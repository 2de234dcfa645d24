#include "dynslam/segmentation/simple_segmenters.hpp"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/segmenter_factory.hpp"

#include "segmentation/test_paths.hpp"
#include "temp_folder.hpp"

namespace dynslam::segmentation {
namespace {

namespace fs = std::filesystem;

// A folder of masks: frame "a" has the values 1 and 200, "b" nothing.
class Recorded : public ::testing::Test {
 protected:
  Recorded() {
    const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
    folder_ = dynslam::testing::temp_path(test->name());
    fs::remove_all(folder_);
    fs::create_directories(folder_);
    labels_ = cv::Mat::zeros(40, 60, CV_8UC1);
    cv::rectangle(labels_, cv::Rect(5, 6, 10, 12), cv::Scalar(200), cv::FILLED);
    cv::circle(labels_, {40, 20}, 8, cv::Scalar(1), cv::FILLED);
    save("a", labels_);
    save("b", cv::Mat::zeros(40, 60, CV_8UC1));
  }
  void save(const std::string& stem, const cv::Mat& image) {
    cv::imwrite((folder_ / (stem + ".png")).string(), image);
  }
  void write(const std::string& stem, const std::string& bytes) {
    std::ofstream(folder_ / (stem + ".png"), std::ios::binary) << bytes;
  }
  Segmentation segment(const std::string& name) {
    FrameInfo frame;
    frame.name = name;
    return RecordedSegmenter(folder_.string()).segment(image_, frame);
  }
  std::string error(const std::string& name) {
    return message_of<IoError>([&] { segment(name); });
  }

  fs::path folder_;
  cv::Mat labels_;
  cv::Mat image_ = cv::Mat::zeros(40, 60, CV_8UC3);
};

TEST_F(Recorded, GivesAnInstanceForEveryValue) {
  const Segmentation found = segment("a");
  ASSERT_EQ(found.instances.size(), 2U);
  EXPECT_EQ(found.width, 60);
  EXPECT_EQ(found.instances[0].label, 1);
  EXPECT_EQ(found.instances[1].label, 200);
  EXPECT_EQ(found.instances[1].box, cv::Rect(5, 6, 10, 12));
  cv::Mat again = cv::Mat::zeros(labels_.size(), CV_8UC1);
  for (const Instance& instance : found.instances) {
    EXPECT_EQ(instance.class_id, 0);
    EXPECT_EQ(instance.score, 1.0F);
    again(instance.box).setTo(instance.label, instance.mask);
  }
  EXPECT_EQ(cv::norm(again, labels_, cv::NORM_L1), 0.0);
}

TEST_F(Recorded, FindsNothingInAnEmptyMask) { EXPECT_TRUE(segment("b").instances.empty()); }

TEST_F(Recorded, FindsAFrameByFileNameAndByStem) {
  EXPECT_EQ(segment("rgb/a.jpg").instances.size(), 2U);
  EXPECT_EQ(segment("a.png").instances.size(), 2U);
  save("1000.066667", labels_);
  EXPECT_EQ(segment("1000.066667").instances.size(), 2U) << "the dot is no extension";
  EXPECT_EQ(segment("rgb/1000.066667.png").instances.size(), 2U);
}

TEST_F(Recorded, ReadsMasksOf16BitsAndOfThreeEqualChannels) {
  cv::Mat wide;
  labels_.convertTo(wide, CV_16U, 300.0);
  save("wide", wide);
  EXPECT_EQ(segment("wide").instances.at(1).label, 60000);
  cv::Mat three;
  cv::cvtColor(labels_, three, cv::COLOR_GRAY2BGR);
  save("three", three);
  EXPECT_EQ(segment("three").instances.at(1).label, 200);
}

TEST_F(Recorded, NamesTheFileThatIsMissing) {
  EXPECT_NE(error("c").find("c.png"), std::string::npos) << error("c");
  FrameInfo frame;
  frame.name = "c";
  RecordedOptions options;
  options.missing_is_empty = true;
  RecordedSegmenter lenient(folder_.string(), options);
  EXPECT_TRUE(lenient.segment(image_, frame).instances.empty());
}

TEST_F(Recorded, NamesTheFileThatIsNotAMask) {
  ::testing::internal::CaptureStderr();
  write("text", "this is no image");
  EXPECT_NE(error("text").find("text.png: is not a PNG"), std::string::npos) << error("text");
  write("empty", "");
  EXPECT_NE(error("empty").find("is empty"), std::string::npos) << error("empty");
  std::ifstream file(folder_ / "a.png", std::ios::binary);
  const std::string whole{std::istreambuf_iterator<char>(file), {}};
  write("cut", whole.substr(0, whole.size() / 2));
  EXPECT_NE(error("cut").find("cut short"), std::string::npos) << error("cut");
  EXPECT_EQ(::testing::internal::GetCapturedStderr(), "");
  save("small", labels_(cv::Rect(0, 0, 30, 30)));
  EXPECT_NE(error("small").find("30x30"), std::string::npos) << error("small");
  cv::Mat colour(40, 60, CV_8UC3, cv::Scalar(1, 2, 3));
  save("colour", colour);
  EXPECT_NE(error("colour").find("colour image"), std::string::npos) << error("colour");
  cv::Mat four(40, 60, CV_8UC4, cv::Scalar(1, 2, 3, 4));
  save("four", four);
  EXPECT_NE(error("four").find("expected labels"), std::string::npos) << error("four");
}

TEST_F(Recorded, NeedsANameAndAFolderWithMasks) {
  EXPECT_THROW(segment(""), InvalidArgument);
  EXPECT_THROW(RecordedSegmenter("there/is/no/such/folder"), IoError);
  fs::remove(folder_ / "a.png");
  fs::remove(folder_ / "b.png");
  EXPECT_THROW(RecordedSegmenter(folder_.string()), IoError);
}

TEST_F(Recorded, IsMadeByName) {
  const auto segmenter = make_segmenter("recorded:" + folder_.string());
  EXPECT_EQ(segmenter->info().kind, "recorded");
  EXPECT_EQ(segmenter->info().source, folder_.string());
  EXPECT_EQ(segmenter->class_names(), std::vector<std::string>{"mover"});
}

TEST(InstancesOfLabels, RefusesOtherTypes) {
  EXPECT_TRUE(instances_of_labels(cv::Mat()).empty());
  EXPECT_THROW(instances_of_labels(cv::Mat(4, 4, CV_32F)), InvalidArgument);
  EXPECT_THROW(instances_of_labels(cv::Mat(4, 4, CV_8UC3)), InvalidArgument);
}

TEST(NullSegmenter, FindsNothing) {
  const auto segmenter = make_segmenter("none");
  const Segmentation found = segmenter->segment(cv::Mat::zeros(4, 5, CV_8UC1), {});
  EXPECT_TRUE(found.instances.empty());
  EXPECT_EQ(found.width, 5);
  EXPECT_EQ(found.height, 4);
  EXPECT_EQ(segmenter->info().kind, "none");
  EXPECT_TRUE(segmenter->class_names().empty());
  EXPECT_THROW(segmenter->segment(cv::Mat(), {}), InvalidArgument);
}

TEST(SegmenterFactory, MakesWhatTheNameSays) {
  EXPECT_EQ(make_segmenter("yolo-seg:" + test_file("tiny_yolov5_seg.onnx"))->info().kind,
            "yolov5-seg");
}

TEST(SegmenterFactory, MakesEveryKindOfNetwork) {
  const std::string darknet =
      test_file("tiny_darknet.cfg") + "," + test_file("tiny_darknet.weights");
  const std::vector<std::pair<std::string, std::string>> kinds = {
      {"yolo-seg:" + test_file("tiny_yolov8_seg.onnx"), "yolov8-seg"},
      {"yolo-seg:" + test_file("tiny_open_size.onnx") + "@96x64", "yolov5-seg"},
      {"yolo:" + test_file("tiny_yolov5.onnx"), "yolov5"},
      {"yolox:" + test_file("tiny_yolox.onnx"), "yolox"},
      {"darknet:" + darknet, "darknet"},
      {"semantic:" + test_file("tiny_semantic.onnx"), "semantic"}};
  for (const auto& [spec, kind] : kinds) {
    for (const bool refine : {true, false}) {
      SegmenterFactoryOptions options;
      options.refine = refine;
      EXPECT_EQ(make_segmenter(spec, options)->info().kind, kind) << spec;
    }
  }
}

TEST(SegmenterFactory, ListsTheKindsForAnUnknownName) {
  for (const char* spec :
       {"", "yolo", "yolo-seg", "yolo-seg:", "none:x", "recorded", "Recorded:x", "darknet:a.cfg"}) {
    const std::string message = message_of<InvalidArgument>([&] { make_segmenter(spec); });
    EXPECT_NE(message.find("yolo-seg:MODEL.onnx"), std::string::npos) << spec << ": " << message;
  }
}

TEST(SegmenterFactory, KnowsTheBackends) {
  EXPECT_EQ(backend_from_name("opencv"), Backend::kOpenCv);
  EXPECT_EQ(backend_from_name("onnxruntime"), Backend::kOnnxRuntime);
  EXPECT_THROW(backend_from_name("tensorrt"), InvalidArgument);
  EXPECT_TRUE(backend_available(Backend::kOpenCv));
}

TEST(FrameStem, DropsFoldersAndTheExtensionsOfImages) {
  EXPECT_EQ(frame_stem("rgb/1000.066667.jpg"), "1000.066667");
  EXPECT_EQ(frame_stem("1000.066667"), "1000.066667");
  EXPECT_EQ(frame_stem("C:\\x\\a.PNG"), "a");
  EXPECT_EQ(frame_stem(""), "");
}

}  // namespace
}  // namespace dynslam::segmentation
