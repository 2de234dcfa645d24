#include <cmath>

#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

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
using testing::stamp;
using testing::TempFolder;
using testing::write_image;
using testing::write_text;
using testing::write_tiny_tum;

std::string error_of_opening(const TempFolder& folder, const TumOptions& options = {}) {
  return io_error_of([&] { open_tum(folder.path(), options); });
}

TEST(OpenTum, ReadsImagesDepthInMetresAndTruth) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 3);
  const auto sequence = open_tum(folder.path());
  EXPECT_EQ(sequence->size(), 3U);
  EXPECT_EQ(sequence->sensor(), SensorKind::kRgbd);
  EXPECT_EQ(sequence->fps(), 20.0);
  EXPECT_EQ(sequence->name(), folder.path().filename().string());
  EXPECT_EQ(sequence->camera().fx, 10.0);
  EXPECT_EQ(sequence->camera().width, 8);
  EXPECT_EQ(sequence->truth().size(), 3U);
  EXPECT_EQ(sequence->timestamp(1), 100.05);
  EXPECT_EQ(sequence->frame_name(1), "100.050000");
  const Frame frame = sequence->read(1);
  EXPECT_EQ(frame.index, 1U);
  EXPECT_EQ(frame.timestamp, 100.05);
  EXPECT_EQ(frame.name, "100.050000");
  EXPECT_TRUE(same_pixels(frame.color, picture(8, 6, CV_8UC3, 1)));
  ASSERT_EQ(frame.depth.type(), CV_32FC1);
  EXPECT_FLOAT_EQ(frame.depth.at<float>(5, 7), 2.0F);
  EXPECT_TRUE(frame.mask.empty());
  EXPECT_TRUE(frame.right.empty());
  ASSERT_TRUE(frame.T_world_cam);
  EXPECT_EQ(frame.T_world_cam->t.x(), 1.0);
}

TEST(OpenTum, ReadsTheSameFrameTwiceIntoDifferentMemory) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 1);
  const auto sequence = open_tum(folder.path());
  const Frame first = sequence->read(0);
  Frame second = sequence->read(0);
  second.color.setTo(0);
  second.depth.setTo(0);
  EXPECT_TRUE(same_pixels(first.color, picture(8, 6, CV_8UC3, 0)));
  EXPECT_FLOAT_EQ(first.depth.at<float>(0, 0), 1.0F);
}

TEST(OpenTum, RefusesAnIndexPastTheEnd) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 2);
  const auto sequence = open_tum(folder.path());
  const std::string message = invalid_argument_of([&] { sequence->read(2); });
  EXPECT_EQ(message, "Sequence::read: index: got 2, expected less than 2");
  EXPECT_THROW(sequence->timestamp(2), InvalidArgument);
  EXPECT_THROW(sequence->frame_name(2), InvalidArgument);
}

TEST(OpenTum, AssociatesListsWithoutAnAssociationFile) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 3);
  fs::remove(folder / "associations.txt");
  // The second depth image is 10 ms late, the third 30 ms: too far.
  write_text(folder / "rgb.txt",
             "# color\n100.00 rgb/100.000000.png\n100.05 rgb/100.050000.png\n"
             "100.10 rgb/100.100000.png\n");
  write_text(folder / "depth.txt",
             "100.00 depth/100.000000.png\n100.06 depth/100.050000.png\n"
             "100.13 depth/100.100000.png\n");
  const auto sequence = open_tum(folder.path());
  ASSERT_EQ(sequence->size(), 2U);
  EXPECT_EQ(sequence->timestamp(1), 100.05);
  EXPECT_FLOAT_EQ(sequence->read(1).depth.at<float>(0, 0), 2.0F);
  EXPECT_EQ(sequence->report().unmatched_frames, 1U);

  TumOptions wide;
  wide.max_time_difference = 0.031;
  EXPECT_EQ(open_tum(folder.path(), wide)->size(), 3U);
  TumOptions none;
  none.max_time_difference = 0.0;
  write_text(folder / "depth.txt", "100.01 depth/100.000000.png\n");
  EXPECT_TRUE(holds(error_of_opening(folder, none), "rgb.txt: no image has a depth image"));
}

TEST(OpenTum, IsMonocularWithoutDepth) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 2);
  fs::remove(folder / "associations.txt");
  write_text(folder / "rgb.txt", "100 rgb/100.000000.png\n");
  const auto sequence = open_tum(folder.path());
  EXPECT_EQ(sequence->sensor(), SensorKind::kMono);
  EXPECT_TRUE(sequence->read(0).depth.empty());
}

TEST(OpenTum, NeedsNoTruth) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 2);
  fs::remove(folder / "groundtruth.txt");
  const auto sequence = open_tum(folder.path());
  EXPECT_TRUE(sequence->truth().empty());
  EXPECT_FALSE(sequence->read(0).T_world_cam);
}

TEST(OpenTum, InterpolatesTruthOnlyAcrossSmallGaps) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 2);
  write_text(folder / "groundtruth.txt", "99.95 0 0 0 0 0 0 1\n100.1 3 0 0 0 0 0 1\n");
  const Frame frame = open_tum(folder.path())->read(0);
  ASSERT_TRUE(frame.T_world_cam);
  EXPECT_NEAR(frame.T_world_cam->t.x(), 1.0, 1e-9);
  TumOptions strict;
  strict.max_truth_gap = 0.1;
  EXPECT_FALSE(open_tum(folder.path(), strict)->read(0).T_world_cam);
}

TEST(OpenTum, GivesMasksAsTheyAreInTheFile) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 2);
  cv::Mat mask(6, 8, CV_8UC1, cv::Scalar(0));
  mask.at<std::uint8_t>(2, 3) = 2;
  write_image(folder / "mask/100.050000.png", mask);
  const auto sequence = open_tum(folder.path());
  EXPECT_TRUE(sequence->read(0).mask.empty());
  EXPECT_TRUE(same_pixels(sequence->read(1).mask, mask));
}

TEST(OpenTum, TakesTheCameraFromOptionsThenFileThenFolderName) {
  TempFolder parent;
  const fs::path folder = parent / "rgbd_dataset_freiburg3_tiny";
  write_tiny_tum(folder, 1);
  TumOptions options;
  options.camera = DepthCamera();
  options.camera->fx = options.camera->fy = 99.0;
  options.depth_scale = 500.0;
  const auto by_options = open_tum(folder, options);
  EXPECT_EQ(by_options->camera().fx, 99.0);
  EXPECT_EQ(by_options->camera().width, 8);  // as the images are
  EXPECT_FLOAT_EQ(by_options->read(0).depth.at<float>(0, 0), 2.0F);
  EXPECT_EQ(open_tum(folder)->camera().fx, 10.0);
  fs::remove(folder / "camera.txt");
  const auto by_name = open_tum(folder / "");
  EXPECT_EQ(by_name->camera().fx, 535.4);
  EXPECT_EQ(by_name->fps(), 30.0);
}

TEST(OpenTum, TellsTheRateFromTheTimesIfNothingElseDoes) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 5);
  write_text(folder / "camera.txt", "fx 10 fy 10 cx 4 cy 3\n");
  const auto sequence = open_tum(folder.path());
  EXPECT_NEAR(sequence->fps(), 20.0, 1e-6);
  EXPECT_EQ(sequence->camera().height, 6);
}

TEST(OpenTum, AsksForACameraItCannotKnow) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 1);
  fs::remove(folder / "camera.txt");
  const std::string message = error_of_opening(folder);
  EXPECT_TRUE(holds(message, folder.path().string()));
  EXPECT_TRUE(holds(message, "the camera is not known, expected camera.txt"));
}

TEST(OpenTum, RefusesFoldersThatAreMissingOrEmptyOrFiles) {
  TempFolder folder;
  EXPECT_TRUE(holds(io_error_of([&] { open_tum(folder / "none"); }), "there is no such folder"));
  EXPECT_TRUE(holds(error_of_opening(folder), "there is neither associations.txt nor rgb.txt"));
  write_text(folder / "file", "x");
  EXPECT_TRUE(holds(io_error_of([&] { open_tum(folder / "file"); }), "is no folder"));
}

TEST(OpenTum, RefusesEmptyFiles) {
  for (const char* file : {"associations.txt", "groundtruth.txt", "camera.txt"}) {
    TempFolder folder;
    write_tiny_tum(folder.path(), 1);
    write_text(folder / file, "");
    EXPECT_TRUE(holds(error_of_opening(folder), file));
  }
  for (const char* file : {"rgb.txt", "depth.txt"}) {
    TempFolder folder;
    write_tiny_tum(folder.path(), 1);
    fs::remove(folder / "associations.txt");
    write_text(folder / "rgb.txt", "100 rgb/100.000000.png\n");
    write_text(folder / "depth.txt", "100 depth/100.000000.png\n");
    write_text(folder / file, "# nothing\n");
    EXPECT_TRUE(holds(error_of_opening(folder), std::string(file) + ": there are no images"));
  }
}

TEST(OpenTum, RefusesAFolderInThePlaceOfAFile) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 1);
  fs::remove(folder / "camera.txt");
  fs::create_directory(folder / "camera.txt");
  EXPECT_TRUE(holds(error_of_opening(folder), "camera.txt: is no regular file"));
}

TEST(OpenTum, NamesTheLineOfATimeThatRepeatsOrGoesBack) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 3);
  const std::string row = " rgb/100.000000.png 100 depth/100.000000.png\n";
  write_text(folder / "associations.txt", "100" + row + "\n100.0" + row);
  EXPECT_TRUE(holds(error_of_opening(folder), "associations.txt:3: the time repeats"));
  write_text(folder / "associations.txt", "100" + row + "99" + row);
  EXPECT_TRUE(holds(error_of_opening(folder), "associations.txt:2: the time goes back"));
}

TEST(OpenTum, CountsDisorderedRowsWhenAskedToSkipThem) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 2);
  const std::string row = " rgb/100.000000.png 100 depth/100.000000.png\n";
  write_text(folder / "associations.txt",
             "100" + row + "100" + row + "99" + row + "101" + row + "100.5" + row + "102" + row);
  write_text(folder / "groundtruth.txt",
             "100 0 0 0 0 0 0 1\n100 9 0 0 0 0 0 1\n101 0 0 0 0 0 0 1\n");
  TumOptions options;
  options.skip_disordered = true;
  const auto sequence = open_tum(folder.path(), options);
  ASSERT_EQ(sequence->size(), 3U);
  EXPECT_EQ(sequence->timestamp(2), 102.0);
  EXPECT_EQ(sequence->truth().size(), 2U);
  EXPECT_EQ(sequence->truth()[0].T_world_cam.t.x(), 0.0);
  const OpenReport report = sequence->report();
  EXPECT_EQ(report.disordered_frames, 3U);
  EXPECT_EQ(report.disordered_truth, 1U);
  EXPECT_TRUE(holds(report.first_disordered, "associations.txt:2: the time repeats"));
}

TEST(OpenTum, RefusesTruthThatIsNotANumberEvenWhenSkipping) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 1);
  write_text(folder / "groundtruth.txt", "100 0 0 0 0 0 0 1\n100.1 0 0 NaN 0 0 0 1\n");
  TumOptions options;
  options.skip_disordered = true;
  EXPECT_TRUE(holds(error_of_opening(folder, options), "groundtruth.txt:2: tz is \"NaN\""));
}

TEST(OpenTum, NamesAFrameWhoseImageIsMissing) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 2);
  fs::remove(folder / "rgb/100.000000.png");
  fs::remove(folder / "depth/100.050000.png");
  const auto sequence = open_tum(folder.path());
  EXPECT_TRUE(holds(io_error_of([&] { sequence->read(0); }), "rgb/100.000000.png: there is no"));
  EXPECT_TRUE(holds(io_error_of([&] { sequence->read(1); }), "depth/100.050000.png: there is no"));
}

TEST(OpenTum, RefusesImagesOfAnotherSizeOrType) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 6);
  write_image(folder / ("rgb/" + stamp(0) + ".png"), picture(9, 6, CV_8UC3, 0));
  write_image(folder / ("rgb/" + stamp(1) + ".png"), cv::Mat(6, 8, CV_16UC3, cv::Scalar::all(9)));
  write_image(folder / ("depth/" + stamp(2) + ".png"), cv::Mat(6, 8, CV_8UC1, cv::Scalar(9)));
  write_image(folder / ("depth/" + stamp(3) + ".png"), cv::Mat(3, 4, CV_16UC1, cv::Scalar(9)));
  write_image(folder / ("mask/" + stamp(4) + ".png"), cv::Mat(6, 8, CV_8UC3, cv::Scalar(9)));
  write_image(folder / ("mask/" + stamp(5) + ".png"), cv::Mat(6, 9, CV_8UC1, cv::Scalar(9)));
  const auto sequence = open_tum(folder.path());
  const auto says = [&](std::size_t i, const std::string& part) {
    return holds(io_error_of([&] { sequence->read(i); }), part);
  };
  EXPECT_TRUE(says(0, stamp(0) + ".png: the image has 9 x 6 pixels, expected the camera's 8 x 6"));
  EXPECT_TRUE(says(1, "is of type CV_16UC3, expected 8 bits a channel"));
  EXPECT_TRUE(says(2, "is of type CV_8UC1, expected 16-bit grey"));
  EXPECT_TRUE(says(3, "the image has 4 x 3 pixels"));
  EXPECT_TRUE(says(4, "expected 8-bit grey (CV_8UC1) for a mask"));
  EXPECT_TRUE(says(5, "the image has 9 x 6 pixels"));
}

TEST(OpenTum, TakesGreyAndTransparentImages) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 2);
  write_image(folder / ("rgb/" + stamp(0) + ".png"), picture(8, 6, CV_8UC1, 0));
  write_image(folder / ("rgb/" + stamp(1) + ".png"), picture(8, 6, CV_8UC4, 0));
  const auto sequence = open_tum(folder.path());
  EXPECT_EQ(sequence->read(0).color.type(), CV_8UC1);
  EXPECT_EQ(sequence->read(1).color.type(), CV_8UC3);
}

// A dot at the distorted image of a point must come out at its pinhole image.
TEST(OpenTum, RemovesThePublishedDistortionOfFreiburg1) {
  TempFolder parent;
  const fs::path folder = parent / "rgbd_dataset_freiburg1_dot";
  const cv::Matx33d K(517.3, 0, 318.6, 0, 516.5, 255.3, 0, 0, 1);
  const std::vector<double> d = {0.2624, -0.9531, -0.0054, 0.0026, 1.1633};
  const std::vector<cv::Point3d> point = {{0.35, -0.28, 1.0}};
  std::vector<cv::Point2d> bent, straight;
  cv::projectPoints(point, cv::Vec3d(), cv::Vec3d(), K, d, bent);
  cv::projectPoints(point, cv::Vec3d(), cv::Vec3d(), K, cv::noArray(), straight);
  ASSERT_GT(cv::norm(bent[0] - straight[0]), 2.0);
  cv::Mat image(480, 640, CV_8UC1, cv::Scalar(0)), depth(480, 640, CV_16UC1, cv::Scalar(0));
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      const double r2 = std::pow(x - bent[0].x, 2) + std::pow(y - bent[0].y, 2);
      image.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(250.0 * std::exp(-r2 / 18.0));
      if (r2 < 25.0) depth.at<std::uint16_t>(y, x) = 5000;
    }
  }
  write_image(folder / "rgb/1.png", image);
  write_image(folder / "depth/1.png", depth);
  write_image(folder / "mask/1.png", image);
  write_text(folder / "associations.txt", "1 rgb/1.png 1 depth/1.png\n");
  const Frame frame = open_tum(folder)->read(0);
  const cv::Moments color = cv::moments(frame.color);
  EXPECT_NEAR(color.m10 / color.m00, straight[0].x, 0.1);
  EXPECT_NEAR(color.m01 / color.m00, straight[0].y, 0.1);
  const cv::Moments z = cv::moments(frame.depth);
  EXPECT_NEAR(z.m10 / z.m00, straight[0].x, 0.6);
  EXPECT_NEAR(z.m01 / z.m00, straight[0].y, 0.6);
  double most = 0.0;
  cv::minMaxLoc(frame.depth, nullptr, &most);
  EXPECT_FLOAT_EQ(static_cast<float>(most), 1.0F);  // depths are never mixed
  // Nor are labels: every value of the mask is one of the file's.
  cv::Mat in_file(1, 256, CV_8UC1, cv::Scalar(0));
  image.forEach<std::uint8_t>([&](std::uint8_t v, const int*) { in_file.data[v] = 1; });
  frame.mask.forEach<std::uint8_t>(
      [&](const std::uint8_t& v, const int*) { EXPECT_EQ(in_file.data[v], 1); });
  EXPECT_NEAR(cv::moments(frame.mask).m10 / cv::moments(frame.mask).m00, straight[0].x, 0.6);

  TumOptions raw;
  raw.undistort = false;
  EXPECT_TRUE(same_pixels(open_tum(folder, raw)->read(0).color, image));
}

TEST(OpenTum, NeedsASizeToRemoveDistortion) {
  TempFolder folder;
  write_tiny_tum(folder.path(), 1);
  write_text(folder / "camera.txt", "fx 10 fy 10 cx 4 cy 3 k1 0.1\n");
  EXPECT_TRUE(holds(error_of_opening(folder), "expected width and height"));
  TumOptions raw;
  raw.undistort = false;
  EXPECT_EQ(open_tum(folder.path(), raw)->camera().width, 8);
}

TEST(TumOptions, RefuseEachValueThatBreaksItsRule) {
  const auto says = [](auto change, const std::string& part) {
    TumOptions options;
    change(options);
    return holds(invalid_argument_of([&] { options.validate(); }), "TumOptions: " + part);
  };
  EXPECT_NO_THROW(TumOptions().validate());
  EXPECT_TRUE(says([](TumOptions& o) { o.depth_scale = 0.0; }, "depth_scale"));
  EXPECT_TRUE(says([](TumOptions& o) { o.depth_scale = std::nan(""); }, "depth_scale"));
  EXPECT_TRUE(says([](TumOptions& o) { o.max_time_difference = -1; }, "max_time_difference"));
  EXPECT_TRUE(says([](TumOptions& o) { o.max_truth_gap = std::nan(""); }, "max_truth_gap"));
  DepthCamera camera;
  camera.fx = camera.fy = 1.0;
  camera.width = 8;
  EXPECT_TRUE(says([&](TumOptions& o) { o.camera = camera; }, "camera.width"));
  TumOptions no_focal_length;
  no_focal_length.camera = DepthCamera();
  EXPECT_TRUE(holds(invalid_argument_of([&] { no_focal_length.validate(); }), "fx"));
}

}  // namespace
}  // namespace dynslam::dataset
