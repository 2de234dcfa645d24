// Tiny data sets for a test's own folder.
#pragma once

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "dynslam/core/errors.hpp"

#include "temp_folder.hpp"

namespace dynslam::dataset::testing {

namespace fs = std::filesystem;

using dynslam::testing::TempFolder;

inline void write_text(const fs::path& file, const std::string& text) {
  fs::create_directories(file.parent_path());
  std::ofstream(file, std::ios::binary) << text;
}

inline std::string read_text(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

inline void write_image(const fs::path& file, const cv::Mat& image) {
  fs::create_directories(file.parent_path());
  ASSERT_TRUE(cv::imwrite(file.string(), image)) << file;
}

/// A picture with some structure that depends on `seed`.
inline cv::Mat picture(int width, int height, int type, int seed) {
  cv::Mat image(height, width, type);
  cv::RNG rng(static_cast<std::uint64_t>(seed) + 1);
  rng.fill(image, cv::RNG::UNIFORM, 0, 256);
  return image;
}

inline bool same_pixels(const cv::Mat& a, const cv::Mat& b) {
  return a.size() == b.size() && a.type() == b.type() && cv::norm(a, b, cv::NORM_INF) == 0.0;
}

constexpr const char* kTinyCamera =
    "fx 10 fy 11 cx 3.5 cy 2.5 width 8 height 6 fps 20 depth_scale 1000\n";

inline std::string stamp(int i) {
  char text[32];
  std::snprintf(text, sizeof text, "%d.%06d", 100 + i / 20, (i % 20) * 50000);
  return text;
}

/// A TUM folder of `frames` frames of 8 x 6 pixels at 20 Hz from 100 s: depth (i + 1) m everywhere,
/// camera at (i, 0, 0).
inline void write_tiny_tum(const fs::path& folder, int frames) {
  std::string associations, truth = "# timestamp tx ty tz qx qy qz qw\n\n";
  for (int i = 0; i < frames; ++i) {
    const std::string t = stamp(i);
    write_image(folder / "rgb" / (t + ".png"), picture(8, 6, CV_8UC3, i));
    write_image(folder / "depth" / (t + ".png"),
                cv::Mat(6, 8, CV_16UC1, cv::Scalar(1000.0 * (i + 1))));
    associations += t + " rgb/" + t + ".png " + t + " depth/" + t + ".png\n";
    truth += t + " " + std::to_string(i) + " 0 0 0 0 0 1\n";
  }
  write_text(folder / "associations.txt", associations);
  write_text(folder / "groundtruth.txt", truth);
  write_text(folder / "camera.txt", kTinyCamera);
}

/// What `call` says when it throws IoError; fails if it does not.
template <typename Call>
std::string io_error_of(const Call& call) {
  try {
    call();
  } catch (const IoError& error) {
    return error.what();
  }
  ADD_FAILURE() << "expected an IoError";
  return {};
}

template <typename Call>
std::string invalid_argument_of(const Call& call) {
  try {
    call();
  } catch (const InvalidArgument& error) {
    return error.what();
  }
  ADD_FAILURE() << "expected an InvalidArgument";
  return {};
}

inline ::testing::AssertionResult holds(const std::string& text, const std::string& part) {
  if (text.find(part) != std::string::npos) return ::testing::AssertionSuccess();
  return ::testing::AssertionFailure() << "\"" << text << "\" does not hold \"" << part << "\"";
}

}  // namespace dynslam::dataset::testing
