#include <gtest/gtest.h>

#include "dynslam/dataset/readers.hpp"

#include "dataset/tiny_folders.hpp"

namespace dynslam::dataset {
namespace {

namespace fs = std::filesystem;
using testing::holds;
using testing::invalid_argument_of;
using testing::io_error_of;
using testing::picture;
using testing::same_pixels;
using testing::TempFolder;
using testing::write_image;
using testing::write_text;

const std::string kP0 = "P0: 700 0 600 0 0 700 180 0 0 0 1 0\n";
const std::string kP1 = "P1: 700 0 600 -378 0 700 180 0 0 0 1 0\n";
const std::string kP2 = "P2: 700 0 600 42 0 700 180 0 0 0 1 0\n";
const std::string kP3 = "P3: 700 0 600 -336 0 700 180 0 0 0 1 0\n";

std::string number(int i) {
  char text[16];
  std::snprintf(text, sizeof text, "%06d", i);
  return text;
}

void write_images(const fs::path& folder, const char* camera, int frames, int type = CV_8UC1) {
  for (int i = 0; i < frames; ++i) {
    write_image(folder / camera / (number(i) + ".png"), picture(12, 7, type, i));
  }
}

std::string poses(int n) {
  std::string text;
  for (int i = 0; i < n; ++i) text += "1 0 0 0 0 1 0 0 0 0 1 " + std::to_string(i) + "\n";
  return text;
}

void write_tiny_kitti(const fs::path& folder, int frames) {
  write_images(folder, "image_0", frames);
  write_text(folder / "calib.txt", kP0 + kP1 + kP2 + kP3);
  write_text(folder / "poses.txt", poses(frames));
}

TEST(OpenKitti, IsMonocularAt10HertzWithLeftImagesOnly) {
  TempFolder folder;
  write_tiny_kitti(folder.path(), 12);
  const auto sequence = open_kitti(folder.path());
  EXPECT_EQ(sequence->size(), 12U);
  EXPECT_EQ(sequence->sensor(), SensorKind::kMono);
  EXPECT_EQ(sequence->fps(), 10.0);
  EXPECT_DOUBLE_EQ(sequence->timestamp(11), 1.1);
  EXPECT_EQ(sequence->frame_name(10), "000010");
  EXPECT_EQ(sequence->camera().fx, 700.0);
  EXPECT_EQ(sequence->camera().cx, 600.0);
  EXPECT_EQ(sequence->camera().width, 12);
  EXPECT_EQ(sequence->camera().height, 7);
  const Frame frame = sequence->read(10);
  EXPECT_TRUE(same_pixels(frame.color, picture(12, 7, CV_8UC1, 10)));
  EXPECT_EQ(frame.T_world_cam->t.z(), 10.0);
  EXPECT_EQ(sequence->truth().size(), 12U);
}

TEST(OpenKitti, IsStereoWithTheMeasuredBaseline) {
  TempFolder folder;
  write_tiny_kitti(folder.path(), 2);
  write_images(folder.path(), "image_1", 2);
  const auto sequence = open_kitti(folder.path());
  EXPECT_EQ(sequence->sensor(), SensorKind::kStereo);
  EXPECT_EQ(sequence->camera().bf, 378.0);
  EXPECT_TRUE(same_pixels(sequence->read(1).right, picture(12, 7, CV_8UC1, 1)));
  KittiOptions left;
  left.left_only = true;
  EXPECT_EQ(open_kitti(folder.path(), left)->sensor(), SensorKind::kMono);
  EXPECT_TRUE(open_kitti(folder.path(), left)->read(0).right.empty());
}

TEST(OpenKitti, MovesTheTruthToTheColourCamera) {
  TempFolder folder;
  write_tiny_kitti(folder.path(), 2);
  write_images(folder.path(), "image_2", 2, CV_8UC3);
  write_images(folder.path(), "image_3", 2, CV_8UC3);
  EXPECT_EQ(open_kitti(folder.path())->read(0).color.channels(), 1);  // grey unless asked
  KittiOptions color;
  color.prefer_color = true;
  const auto sequence = open_kitti(folder.path(), color);
  const Frame frame = sequence->read(1);
  EXPECT_EQ(frame.color.channels(), 3);
  EXPECT_EQ(frame.right.channels(), 3);
  EXPECT_EQ(sequence->camera().bf, 378.0);
  // P2 = K [I | (0.06, 0, 0)]: camera 2 is 6 cm to the left of camera 0.
  EXPECT_NEAR(frame.T_world_cam->t.x(), -0.06, 1e-12);
  fs::remove_all(folder / "image_0");
  EXPECT_EQ(open_kitti(folder.path())->read(0).color.channels(), 3);
}

TEST(OpenKitti, ReadsTheOfficialLayout) {
  TempFolder root;
  const fs::path folder = root / "sequences/06";
  write_tiny_kitti(folder, 3);
  fs::remove(folder / "poses.txt");
  write_text(root / "poses/06.txt", poses(3));
  write_text(folder / "times.txt", "0.0\n1.0e-01\n2.1e-01\n");
  const auto sequence = open_kitti(folder);
  EXPECT_EQ(sequence->name(), "06");
  EXPECT_EQ(sequence->timestamp(2), 0.21);
  EXPECT_EQ(sequence->read(2).T_world_cam->t.z(), 2.0);
}

TEST(OpenKitti, NeedsNoTruth) {
  TempFolder folder;
  write_tiny_kitti(folder.path(), 2);
  fs::remove(folder / "poses.txt");
  EXPECT_TRUE(open_kitti(folder.path())->truth().empty());
}

TEST(OpenKitti, FindsTheRowsOfACutSequenceByTheNamesOfItsImages) {
  TempFolder folder;
  write_tiny_kitti(folder.path(), 6);
  fs::remove(folder / "image_0/000000.png");
  fs::remove(folder / "image_0/000001.png");
  write_text(folder / "times.txt", "0\n1\n2\n3\n4\n5\n");
  const auto sequence = open_kitti(folder.path());
  ASSERT_EQ(sequence->size(), 4U);
  EXPECT_EQ(sequence->timestamp(0), 2.0);
  EXPECT_EQ(sequence->read(0).T_world_cam->t.z(), 2.0);
  write_text(folder / "poses.txt", poses(4) + poses(1));  // ends at image 4
  EXPECT_FALSE(open_kitti(folder.path())->read(3).T_world_cam);
  EXPECT_EQ(open_kitti(folder.path())->truth().size(), 3U);
}

TEST(OpenKitti, RefusesTimesThatDoNotBelongToTheImages) {
  TempFolder folder;
  write_tiny_kitti(folder.path(), 3);
  write_text(folder / "times.txt", "0\n1\n");
  EXPECT_TRUE(holds(io_error_of([&] { open_kitti(folder.path()); }),
                    "times.txt: there are 2 times, expected one for"));
  fs::rename(folder / "image_0/000002.png", folder / "image_0/last.png");
  EXPECT_TRUE(holds(io_error_of([&] { open_kitti(folder.path()); }), "rows for 3 images"));
}

TEST(OpenKitti, SkipsDisorderedTimesOnlyWhenAsked) {
  TempFolder folder;
  write_tiny_kitti(folder.path(), 3);
  write_text(folder / "times.txt", "0\n0\n1\n");
  EXPECT_TRUE(
      holds(io_error_of([&] { open_kitti(folder.path()); }), "times.txt:2: the time repeats"));
  KittiOptions options;
  options.skip_disordered = true;
  const auto sequence = open_kitti(folder.path(), options);
  ASSERT_EQ(sequence->size(), 2U);
  EXPECT_EQ(sequence->frame_name(1), "000002");
  EXPECT_EQ(sequence->read(1).T_world_cam->t.z(), 2.0);
  EXPECT_EQ(sequence->report().disordered_frames, 1U);
}

TEST(OpenKitti, RefusesWhatIsMissing) {
  TempFolder folder;
  const auto error = [&] { return io_error_of([&] { open_kitti(folder.path()); }); };
  EXPECT_TRUE(holds(error(), "there is neither image_0 nor image_2"));
  fs::create_directory(folder / "image_0");
  EXPECT_TRUE(holds(error(), "image_0: there are no images"));
  write_images(folder.path(), "image_0", 2);
  EXPECT_TRUE(holds(error(), "calib.txt: there is no such file"));
  write_text(folder / "calib.txt", kP0);
  EXPECT_EQ(open_kitti(folder.path())->size(), 2U);
  write_text(folder / "poses.txt", "# none\n");
  EXPECT_TRUE(holds(error(), "poses.txt: there are no poses"));
  fs::remove(folder / "poses.txt");
  write_images(folder.path(), "image_1", 1);
  EXPECT_TRUE(holds(error(), "image_1/000001.png: there is no such right image"));
  write_images(folder.path(), "image_1", 2);
  EXPECT_TRUE(holds(error(), "calib.txt: there is no matrix P1"));
}

TEST(OpenKitti, RefusesAPairThatIsNotRectified) {
  TempFolder folder;
  write_tiny_kitti(folder.path(), 1);
  write_images(folder.path(), "image_1", 1);
  const auto error = [&](const std::string& P1) {
    write_text(folder / "calib.txt", kP0 + P1);
    return io_error_of([&] { open_kitti(folder.path()); });
  };
  EXPECT_TRUE(holds(error("P1: 701 0 600 -378 0 700 180 0 0 0 1 0\n"), "other intrinsics"));
  EXPECT_TRUE(holds(error("P1: 700 0 600 378 0 700 180 0 0 0 1 0\n"), "to the left"));
}

TEST(OpenKitti, RefusesAFrameOfWhichOneImageIsInColour) {
  TempFolder folder;
  write_tiny_kitti(folder.path(), 2);
  write_images(folder.path(), "image_1", 2, CV_8UC3);
  const auto sequence = open_kitti(folder.path());
  EXPECT_TRUE(holds(io_error_of([&] { sequence->read(0); }), "in colour"));
}

TEST(OpenKitti, TakesTheSizeFromTheFirstImageThatCanBeRead) {
  TempFolder folder;
  write_tiny_kitti(folder.path(), 3);
  write_text(folder / "image_0/000000.png", "broken");
  const auto sequence = open_kitti(folder.path());
  EXPECT_EQ(sequence->camera().width, 12);
  EXPECT_THROW(sequence->read(0), IoError);
  EXPECT_NO_THROW(sequence->read(1));
  for (int i = 0; i < 3; ++i) write_text(folder / ("image_0/" + number(i) + ".png"), "broken");
  EXPECT_TRUE(holds(io_error_of([&] { open_kitti(folder.path()); }), "000002.png: is no image"));
}

TEST(OpenKitti, TakesACameraInThePlaceOfTheFile) {
  TempFolder folder;
  write_tiny_kitti(folder.path(), 1);
  fs::remove(folder / "calib.txt");
  KittiOptions options;
  options.camera = DepthCamera();
  options.camera->fx = options.camera->fy = 9.0;
  EXPECT_EQ(open_kitti(folder.path(), options)->camera().fx, 9.0);
  write_images(folder.path(), "image_1", 1);
  write_text(folder / "calib.txt", kP0 + kP1);
  const DepthCamera camera = open_kitti(folder.path(), options)->camera();
  EXPECT_EQ(camera.fx, 9.0);
  EXPECT_NEAR(camera.baseline(), 378.0 / 700.0, 1e-12);  // still that of the rig
  options.camera->fx = -1.0;
  EXPECT_TRUE(holds(invalid_argument_of([&] { open_kitti(folder.path(), options); }), "fx"));
}

}  // namespace
}  // namespace dynslam::dataset
