#include "dynslam/dataset/tum_writer.hpp"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "dynslam/dataset/readers.hpp"

#include "dataset/tiny_folders.hpp"
#include "full_disk.hpp"

namespace dynslam::dataset {
namespace {

namespace fs = std::filesystem;
using dynslam::testing::FullDisk;
using testing::holds;
using testing::invalid_argument_of;
using testing::io_error_of;
using testing::picture;
using testing::read_text;
using testing::same_pixels;
using testing::TempFolder;

DepthCamera small_camera() {
  DepthCamera camera;
  camera.fx = 10.1;
  camera.fy = 1.0 / 3.0;
  camera.cx = 4.0;
  camera.cy = 3.0;
  camera.width = 8;
  camera.height = 6;
  camera.bf = 0.7;
  return camera;
}

Frame make_frame(int i) {
  Frame frame;
  frame.timestamp = 1305031102.175304 + 0.1 * i;
  frame.color = picture(8, 6, CV_8UC3, i);
  frame.depth = cv::Mat(6, 8, CV_32FC1, cv::Scalar(1.0 + i));
  frame.mask = cv::Mat(6, 8, CV_8UC1, cv::Scalar(i));
  Vector6d xi;
  xi << 1.0, 2.0, i, 0.1, -0.2, 0.3 * i;
  frame.T_world_cam = se3_exp(xi);
  return frame;
}

TEST(TumWriter, WritesWhatTheReaderReadsBack) {
  TempFolder folder;
  TumWriterOptions options;
  options.fps = 10.0;
  options.depth_scale = 4000.0;
  TumWriter writer(folder / "deep/sequence", small_camera(), options);
  for (int i = 0; i < 3; ++i) writer.add(make_frame(i));
  EXPECT_EQ(writer.size(), 3U);
  writer.finish();
  const auto sequence = open_tum(folder / "deep/sequence");
  ASSERT_EQ(sequence->size(), 3U);
  EXPECT_EQ(sequence->sensor(), SensorKind::kRgbd);
  EXPECT_EQ(sequence->fps(), 10.0);
  EXPECT_EQ(sequence->camera().fx, 10.1);
  EXPECT_EQ(sequence->camera().fy, 1.0 / 3.0);
  EXPECT_EQ(sequence->camera().bf, 0.7);
  for (int i = 0; i < 3; ++i) {
    const Frame written = make_frame(i), read = sequence->read(static_cast<std::size_t>(i));
    EXPECT_NEAR(read.timestamp, written.timestamp, 6e-7);
    EXPECT_TRUE(same_pixels(read.color, written.color));
    EXPECT_TRUE(same_pixels(read.mask, written.mask));
    EXPECT_LT(cv::norm(read.depth, written.depth, cv::NORM_INF), 1e-6);
    ASSERT_TRUE(read.T_world_cam);
    EXPECT_LT(se3_log(read.T_world_cam->inverse() * *written.T_world_cam).norm(), 1e-8);
  }
  EXPECT_EQ(sequence->frame_name(0), "1305031102.175304");
}

TEST(TumWriter, AlsoWritesTheListsOfTheOriginalLayout) {
  TempFolder folder;
  TumWriter writer(folder.path(), small_camera());
  writer.add(make_frame(0));
  writer.finish();
  fs::remove(folder / "associations.txt");
  EXPECT_EQ(open_tum(folder.path())->sensor(), SensorKind::kRgbd);
  EXPECT_TRUE(holds(read_text(folder / "depth.txt"), "1305031102.175304 depth/"));
}

TEST(TumWriter, WritesDepthThatDoesNotFitAsNone) {
  TempFolder folder;
  Frame frame = make_frame(0);
  const float inf = std::numeric_limits<float>::infinity();
  const float values[8] = {std::nanf(""), inf, -inf, -1.0F, 0.0F, 13.107F, 13.2F, 0.00011F};
  for (int x = 0; x < 8; ++x) frame.depth.at<float>(0, x) = values[x];
  TumWriter writer(folder.path(), small_camera());
  writer.add(frame);
  writer.finish();
  const cv::Mat read = open_tum(folder.path())->read(0).depth;
  const float expected[8] = {0, 0, 0, 0, 0, 13.107F, 0, 0.0002F};
  for (int x = 0; x < 8; ++x) EXPECT_FLOAT_EQ(read.at<float>(0, x), expected[x]) << x;
}

TEST(TumWriter, WritesGreyImagesWithoutDepthAsMonocular) {
  TempFolder folder;
  Frame frame;
  frame.timestamp = 0.0;
  frame.color = picture(8, 6, CV_8UC1, 0);
  TumWriter writer(folder.path(), small_camera());
  writer.add(frame);
  writer.finish();
  const auto sequence = open_tum(folder.path());
  EXPECT_EQ(sequence->sensor(), SensorKind::kMono);
  EXPECT_EQ(sequence->read(0).color.channels(), 1);
  EXPECT_FALSE(fs::exists(folder / "groundtruth.txt"));
  EXPECT_FALSE(fs::exists(folder / "mask"));
}

TEST(TumWriter, LeavesNothingThatAReaderTakesForAWholeBeforeFinish) {
  TempFolder folder;
  {
    TumWriter writer(folder.path(), small_camera());
    for (int i = 0; i < 3; ++i) writer.add(make_frame(i));
  }
  EXPECT_TRUE(fs::exists(folder / "rgb"));
  EXPECT_THROW(open_tum(folder.path()), IoError);
  EXPECT_EQ(guess_folder_kind(folder.path()), FolderKind::kUnknown);
}

TEST(TumWriter, LeavesNoTemporaryFiles) {
  TempFolder folder;
  TumWriter writer(folder.path(), small_camera());
  writer.add(make_frame(0));
  writer.finish();
  for (const auto& entry : fs::recursive_directory_iterator(folder.path())) {
    EXPECT_EQ(entry.path().filename().string().find(".tmp"), std::string::npos) << entry.path();
  }
}

TEST(TumWriter, ReplacesASequenceOnlyWhenAsked) {
  TempFolder folder;
  {
    TumWriter writer(folder.path(), small_camera());
    for (int i = 0; i < 3; ++i) writer.add(make_frame(i));
    writer.finish();
  }
  EXPECT_TRUE(holds(io_error_of([&] { TumWriter(folder.path(), small_camera()); }),
                    "holds a sequence already"));
  EXPECT_EQ(open_tum(folder.path())->size(), 3U);
  TumWriterOptions overwrite;
  overwrite.overwrite = true;
  TumWriter writer(folder.path(), small_camera(), overwrite);
  EXPECT_THROW(open_tum(folder.path()), IoError);  // the old one is no whole any more
  Frame frame = make_frame(1);
  frame.mask = cv::Mat();
  frame.T_world_cam.reset();
  writer.add(frame);
  writer.finish();
  const auto sequence = open_tum(folder.path());
  EXPECT_EQ(sequence->size(), 1U);
  EXPECT_TRUE(sequence->read(0).mask.empty());  // not the old one's
  EXPECT_TRUE(sequence->truth().empty());
}

TEST(TumWriter, RefusesFramesThatDoNotFit) {
  TempFolder folder;
  TumWriter writer(folder.path(), small_camera());
  writer.add(make_frame(5));
  const auto says = [&](auto change, const std::string& part) {
    Frame frame = make_frame(6);
    change(frame);
    return holds(invalid_argument_of([&] { writer.add(frame); }), "TumWriter::add: " + part);
  };
  EXPECT_TRUE(says([](Frame& f) { f.color = cv::Mat(); }, "color: got an empty image"));
  EXPECT_TRUE(
      says([](Frame& f) { f.color = picture(9, 6, CV_8UC3, 0); }, "color: got CV_8UC3 of 9"));
  EXPECT_TRUE(says([](Frame& f) { f.color = cv::Mat(6, 8, CV_32FC3); }, "color"));
  EXPECT_TRUE(says([](Frame& f) { f.depth = cv::Mat(6, 8, CV_16UC1); }, "depth: got CV_16UC1"));
  EXPECT_TRUE(says([](Frame& f) { f.depth = cv::Mat(6, 9, CV_32FC1); }, "depth"));
  EXPECT_TRUE(says([](Frame& f) { f.depth = cv::Mat(); }, "depth: got none"));
  EXPECT_TRUE(says([](Frame& f) { f.mask = cv::Mat(6, 8, CV_8UC3); }, "mask"));
  EXPECT_TRUE(says([](Frame& f) { f.T_world_cam->t.x() = std::nan(""); }, "T_world_cam"));
  EXPECT_TRUE(says([](Frame& f) { f.timestamp = std::nan(""); }, "timestamp"));
  EXPECT_TRUE(says([](Frame& f) { f.timestamp = 1e13; }, "timestamp"));
  EXPECT_TRUE(says([](Frame& f) { f.timestamp = make_frame(5).timestamp; }, "timestamp"));
  EXPECT_TRUE(says([](Frame& f) { f.timestamp = make_frame(4).timestamp; }, "timestamp"));
  EXPECT_EQ(writer.size(), 1U);
  writer.add(make_frame(6));  // still good for more
  writer.finish();
  EXPECT_TRUE(holds(invalid_argument_of([&] { writer.add(make_frame(7)); }), "after finish"));
  EXPECT_TRUE(holds(invalid_argument_of([&] { writer.finish(); }), "a second call"));
  EXPECT_EQ(open_tum(folder.path())->size(), 2U);
}

TEST(TumWriter, RefusesAnEmptySequenceABadCameraAndBadOptions) {
  TempFolder folder;
  TumWriter writer(folder.path(), small_camera());
  EXPECT_TRUE(holds(invalid_argument_of([&] { writer.finish(); }), "no frames"));
  EXPECT_THROW(TumWriter(folder.path(), DepthCamera()), InvalidArgument);
  const auto says = [](auto change, const std::string& part) {
    TumWriterOptions options;
    change(options);
    return holds(invalid_argument_of([&] { options.validate(); }), "TumWriterOptions: " + part);
  };
  EXPECT_TRUE(says([](TumWriterOptions& o) { o.depth_scale = 0; }, "depth_scale"));
  EXPECT_TRUE(says([](TumWriterOptions& o) { o.fps = std::nan(""); }, "fps"));
  EXPECT_TRUE(says([](TumWriterOptions& o) { o.png_compression = 10; }, "png_compression"));
}

TEST(TumWriter, RefusesAFolderThatCannotBeMade) {
  TempFolder folder;
  testing::write_text(folder / "file", "x");
  EXPECT_TRUE(holds(io_error_of([&] { TumWriter(folder / "file/sub", small_camera()); }), "file"));
}

TEST(TumWriter, ReportsAFullDiskAndLeavesNoHalfFile) {
  TempFolder folder;
  TumWriter writer(folder.path(), small_camera());
  std::string on_image, on_text;
  {
    const FullDisk full(64);  // no PNG is that small
    on_image = io_error_of([&] { writer.add(make_frame(0)); });
  }
  EXPECT_TRUE(holds(on_image, "rgb/1305031102.175304.png: cannot be written: "));
  EXPECT_TRUE(fs::is_empty(folder / "rgb"));
  EXPECT_EQ(writer.size(), 0U);
  writer.add(make_frame(0));
  {
    const FullDisk full(64);
    on_text = io_error_of([&] { writer.finish(); });
  }
  EXPECT_TRUE(holds(on_text, "groundtruth.txt: cannot be written: "));
  EXPECT_THROW(open_tum(folder.path()), IoError);
  writer.finish();  // there is room again
  EXPECT_EQ(open_tum(folder.path())->size(), 1U);
}

TEST(WriteTumFolder, CopiesASequence) {
  TempFolder folder;
  testing::write_tiny_tum(folder / "a", 4);
  const auto original = open_tum(folder / "a");
  EXPECT_EQ(write_tum_folder(*original, folder / "b"), 4U);
  const auto copy = open_tum(folder / "b");
  ASSERT_EQ(copy->size(), 4U);
  EXPECT_EQ(copy->fps(), original->fps());
  EXPECT_EQ(copy->camera().cx, original->camera().cx);
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_TRUE(same_pixels(copy->read(i).color, original->read(i).color));
    EXPECT_LT(cv::norm(copy->read(i).depth, original->read(i).depth, cv::NORM_INF), 1e-6);
    EXPECT_EQ(copy->frame_name(i), original->frame_name(i));
    EXPECT_EQ(copy->read(i).T_world_cam->t, original->read(i).T_world_cam->t);
  }
}

}  // namespace
}  // namespace dynslam::dataset
