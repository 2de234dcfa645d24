#include <cmath>

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
using testing::TempFolder;
using testing::write_image;
using testing::write_text;

DepthCamera ten_pixel_camera() {
  DepthCamera camera;
  camera.fx = camera.fy = 10.0;
  return camera;
}

TEST(OpenImageFolder, TakesImagesInTheOrderInWhichPeopleCount) {
  TempFolder folder;
  for (const char* name : {"f10.png", "f9.PNG", "f1.jpg", "f100.png"}) {
    write_image(folder / "x.png", picture(8, 6, CV_8UC3, 0));
    fs::copy(folder / "x.png", folder / name);
  }
  fs::remove(folder / "x.png");
  write_text(folder / "notes.txt", "no image");
  fs::create_directory(folder / "f2.png");
  const auto sequence = open_image_folder(folder.path(), ten_pixel_camera(), 4.0);
  ASSERT_EQ(sequence->size(), 4U);
  EXPECT_EQ(sequence->frame_name(0), "f1");
  EXPECT_EQ(sequence->frame_name(1), "f9");
  EXPECT_EQ(sequence->frame_name(2), "f10");
  EXPECT_EQ(sequence->frame_name(3), "f100");
  EXPECT_EQ(sequence->timestamp(3), 0.75);
  EXPECT_EQ(sequence->fps(), 4.0);
  EXPECT_EQ(sequence->camera().width, 8);
  EXPECT_EQ(sequence->sensor(), SensorKind::kMono);
}

TEST(OpenImageFolder, RefusesAnEmptyFolderABadCameraAndABadRate) {
  TempFolder folder;
  EXPECT_TRUE(holds(io_error_of([&] { open_image_folder(folder.path(), ten_pixel_camera()); }),
                    "there are no frames"));
  EXPECT_TRUE(
      holds(invalid_argument_of([&] { open_image_folder(folder.path(), DepthCamera()); }), "fx"));
  EXPECT_TRUE(
      holds(invalid_argument_of([&] { open_image_folder(folder.path(), ten_pixel_camera(), 0.0); }),
            "fps"));
  EXPECT_THROW(open_image_folder(folder / "none", ten_pixel_camera()), IoError);
}

TEST(OpenSequence, KnowsEachKindOfFolder) {
  TempFolder root;
  EXPECT_EQ(guess_folder_kind(root.path()), FolderKind::kUnknown);
  testing::write_tiny_tum(root / "tum", 2);
  EXPECT_EQ(guess_folder_kind(root / "tum"), FolderKind::kTum);
  EXPECT_EQ(open_sequence(root / "tum")->sensor(), SensorKind::kRgbd);

  write_image(root / "kitti/image_0/000000.png", picture(8, 6, CV_8UC1, 0));
  write_text(root / "kitti/calib.txt", "P0: 7 0 4 0 0 7 3 0 0 0 1 0\n");
  EXPECT_EQ(guess_folder_kind(root / "kitti"), FolderKind::kKitti);
  EXPECT_EQ(open_sequence(root / "kitti")->camera().fx, 7.0);

  fs::create_directories(root / "euroc/mav0/cam0");
  EXPECT_EQ(guess_folder_kind(root / "euroc"), FolderKind::kEuroc);
  EXPECT_EQ(guess_folder_kind(root / "euroc/mav0"), FolderKind::kEuroc);
  EXPECT_TRUE(holds(io_error_of([&] { open_sequence(root / "euroc"); }), "sensor.yaml"));

  OpenOptions options;
  options.camera = ten_pixel_camera();
  options.fps = 5.0;
  EXPECT_EQ(guess_folder_kind(root / "kitti/image_0"), FolderKind::kImages);
  EXPECT_EQ(open_sequence(root / "kitti/image_0", options)->fps(), 5.0);
}

TEST(OpenSequence, PassesItsOptionsOn) {
  TempFolder folder;
  testing::write_tiny_tum(folder.path(), 2);
  OpenOptions options;
  options.camera = ten_pixel_camera();
  options.depth_scale = 2000.0;
  const auto sequence = open_sequence(folder.path(), options);
  EXPECT_EQ(sequence->camera().fy, 10.0);
  EXPECT_FLOAT_EQ(sequence->read(0).depth.at<float>(0, 0), 0.5F);
  options.camera->width = options.camera->height = 8;
  write_text(folder / "rgb.txt", "2 a\n1 b\n");
  fs::remove(folder / "associations.txt");
  EXPECT_THROW(open_sequence(folder.path(), options), IoError);
  options.skip_disordered = true;
  EXPECT_EQ(open_sequence(folder.path(), options)->report().disordered_frames, 1U);
}

TEST(OpenSequence, SaysWhatItCannotDo) {
  TempFolder root;
  EXPECT_TRUE(
      holds(io_error_of([&] { open_sequence(root.path()); }), "is no sequence that is known"));
  EXPECT_TRUE(holds(io_error_of([&] { open_sequence(root / "none"); }), "there is no such folder"));
  write_image(root / "images/a.png", picture(8, 6, CV_8UC1, 0));
  EXPECT_TRUE(holds(io_error_of([&] { open_sequence(root / "images"); }), "expected one in the"));
  fs::create_directories(root / "euroc/cam0");
  OpenOptions options;
  options.camera = ten_pixel_camera();
  EXPECT_TRUE(
      holds(invalid_argument_of([&] { open_sequence(root / "euroc", options); }), "camera"));
}

}  // namespace
}  // namespace dynslam::dataset
