#include <random>

#include <gtest/gtest.h>

#include "dynslam/dataset/readers.hpp"

#include "dataset/tiny_folders.hpp"

namespace dynslam::dataset {
namespace {

namespace fs = std::filesystem;
using testing::holds;
using testing::io_error_of;
using testing::picture;
using testing::read_text;
using testing::TempFolder;
using testing::write_image;
using testing::write_text;

DepthCamera any_camera() {
  DepthCamera camera;
  camera.fx = camera.fy = 10.0;
  camera.width = 24;
  camera.height = 16;
  return camera;
}

// One image file with changing content, read through a plain folder.
class OneImage {
 public:
  explicit OneImage(const std::string& name) : file_(folder_ / name) {
    write_image(file_, picture(24, 16, CV_8UC3, 1));
    bytes_ = read_text(file_);
    sequence_ = open_image_folder(folder_.path(), any_camera());
  }
  const std::string& bytes() const { return bytes_; }
  Frame read(const std::string& bytes) const {
    write_text(file_, bytes);
    return sequence_->read(0);
  }
  std::string error_of(const std::string& bytes) const {
    return io_error_of([&] { read(bytes); });
  }

 private:
  TempFolder folder_;
  fs::path file_;
  std::string bytes_;
  std::unique_ptr<Sequence> sequence_;
};

TEST(ImageFiles, APngCutAnywhereIsRefused) {
  const OneImage image("a.png");
  EXPECT_NO_THROW(image.read(image.bytes()));
  for (std::size_t n = 0; n < image.bytes().size(); n += n < 60 ? 1 : 37) {
    EXPECT_TRUE(holds(image.error_of(image.bytes().substr(0, n)), "a.png: ")) << n;
  }
  EXPECT_TRUE(holds(image.error_of(image.bytes().substr(0, 500)), "the PNG file is cut short"));
  EXPECT_TRUE(
      holds(image.error_of(image.bytes().substr(0, image.bytes().size() - 1)), "cut short"));
}

TEST(ImageFiles, AJpegCutAnywhereIsRefused) {
  const OneImage image("a.jpg");
  EXPECT_NO_THROW(image.read(image.bytes()));
  for (std::size_t n = 0; n < image.bytes().size(); n += n < 60 ? 1 : 37) {
    EXPECT_TRUE(holds(image.error_of(image.bytes().substr(0, n)), "a.jpg: ")) << n;
  }
  EXPECT_TRUE(
      holds(image.error_of(image.bytes().substr(0, image.bytes().size() - 1)), "cut short"));
}

TEST(ImageFiles, EveryFlippedBitOfAPngIsNoticed) {
  const OneImage image("a.png");
  std::mt19937 rng(5);
  for (int trial = 0; trial < 200; ++trial) {
    std::string bytes = image.bytes();
    const std::size_t at = 8 + rng() % (bytes.size() - 8);  // behind the signature
    bytes[at] = static_cast<char>(bytes[at] ^ (1 << rng() % 8));
    EXPECT_TRUE(holds(image.error_of(bytes), "the PNG file")) << at;
  }
}

TEST(ImageFiles, AWholeFileWithBytesBehindItIsRead) {
  for (const char* name : {"a.png", "a.jpg"}) {
    const OneImage image(name);
    EXPECT_EQ(image.read(image.bytes() + std::string(100, 'x')).color.cols, 24);
  }
}

TEST(ImageFiles, ReadsProgressiveJpegAndJpegWithRestarts) {
  TempFolder folder;
  const cv::Mat original(16, 24, CV_8UC3, cv::Scalar(10, 100, 200));
  ASSERT_TRUE(
      cv::imwrite((folder / "1.jpg").string(), original, {cv::IMWRITE_JPEG_PROGRESSIVE, 1}));
  ASSERT_TRUE(
      cv::imwrite((folder / "2.jpg").string(), original, {cv::IMWRITE_JPEG_RST_INTERVAL, 1}));
  const auto sequence = open_image_folder(folder.path(), any_camera());
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_LE(cv::norm(sequence->read(i).color, original, cv::NORM_INF), 4.0);
  }
}

TEST(ImageFiles, AHeaderThatAsksForGigabytesIsRefusedWithoutAllocating) {
  const OneImage png("a.png");
  std::string bytes = png.bytes();
  bytes[16] = bytes[20] = 0x7f;  // width and height; the checksum is wrong, too
  EXPECT_TRUE(holds(png.error_of(bytes), "the PNG file"));
  const OneImage jpeg("a.jpg");
  bytes = jpeg.bytes();
  const std::size_t header = bytes.find("\xFF\xC0");
  ASSERT_NE(header, std::string::npos);
  bytes.replace(header + 5, 4, "\xFF\xFF\xFF\xFF");
  EXPECT_TRUE(holds(jpeg.error_of(bytes), "more than 2^27 pixels"));
}

TEST(ImageFiles, WhatIsNoImageIsRefused) {
  const OneImage image("a.png");
  EXPECT_TRUE(holds(image.error_of(""), "a.png: the image file is empty"));
  EXPECT_TRUE(holds(image.error_of("hello"), "is no image that can be decoded"));
  EXPECT_TRUE(holds(image.error_of(image.bytes().substr(0, 8)), "cut short"));
  EXPECT_TRUE(holds(image.error_of(std::string("\xFF\xD8\xFF\xD9", 4)), "holds no image"));
  EXPECT_TRUE(holds(image.error_of(std::string("\xFF\xD8\xFF\xE0\x00\x01", 6)), "corrupt"));
}

TEST(ImageFiles, ReadsTheOtherCommonFormats) {
  for (const char* name : {"a.bmp", "a.ppm", "a.tiff", "a.webp"}) {
    const OneImage image(name);
    EXPECT_EQ(image.read(image.bytes()).color.size(), cv::Size(24, 16)) << name;
    if (std::string(name) != "a.tiff" && std::string(name) != "a.webp") {
      EXPECT_EQ(
          cv::norm(image.read(image.bytes()).color, picture(24, 16, CV_8UC3, 1), cv::NORM_INF),
          0.0);
    }
  }
}

}  // namespace
}  // namespace dynslam::dataset
