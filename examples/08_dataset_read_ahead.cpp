// Writes a tiny data set in TUM layout, spoils one of its images, and reads it back ahead of a
// consumer: frames come in order, with depth, pose and mask, and the bad one is a value.
#include <cstdio>
#include <filesystem>
#include <memory>
#include <random>
#include <string>
#include <system_error>

#include "dynslam/dataset/read_ahead.hpp"
#include "dynslam/dataset/readers.hpp"
#include "dynslam/dataset/tum_writer.hpp"

namespace {

namespace ds = dynslam::dataset;
namespace fs = std::filesystem;

constexpr int kWidth = 64, kHeight = 48, kFrames = 8;

// A slanted wall, seen by a camera that goes to the right; a block of four columns moves.
ds::Frame make_frame(int i) {
  ds::Frame frame;
  frame.timestamp = 100.0 + i / 30.0;
  frame.color.create(kHeight, kWidth, CV_8UC3);
  frame.depth.create(kHeight, kWidth, CV_32FC1);
  frame.mask.create(kHeight, kWidth, CV_8UC1);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const bool moves = x / 4 == i;
      auto* pixel = frame.color.ptr<unsigned char>(y, x);
      for (int c = 0; c < 3; ++c) pixel[c] = static_cast<unsigned char>((x + i) * (c + 2) ^ y);
      frame.depth.at<float>(y, x) = moves ? 1.0F : 2.0F + 0.01F * static_cast<float>(x);
      frame.mask.at<unsigned char>(y, x) = moves ? 255 : 0;
    }
  }
  frame.T_world_cam = dynslam::RigidTransform();
  frame.T_world_cam->t.x() = 0.02 * i;
  return frame;
}

void write_folder(const fs::path& folder) {
  dynslam::DepthCamera camera;
  camera.fx = camera.fy = 60.0, camera.cx = 31.5, camera.cy = 23.5;
  camera.width = kWidth, camera.height = kHeight;
  ds::TumWriterOptions options;
  options.overwrite = true;
  ds::TumWriter writer(folder, camera, options);
  for (int i = 0; i < kFrames; ++i) writer.add(make_frame(i));
  writer.finish();
}

double share_moving(const cv::Mat& mask) {
  int moving = 0;
  for (int y = 0; y < mask.rows; ++y) {
    for (int x = 0; x < mask.cols; ++x) moving += mask.at<unsigned char>(y, x) != 0;
  }
  return static_cast<double>(moving) / static_cast<double>(mask.total());
}

void print(const ds::Frame& frame) {
  std::printf(
      "  frame %zu at %.3f s: %d x %d, depth in the middle %.2f m, %.0f %% moving, x = %.2f m\n",
      frame.index, frame.timestamp, frame.color.cols, frame.color.rows,
      static_cast<double>(frame.depth.at<float>(kHeight / 2, kWidth / 2)),
      100.0 * share_moving(frame.mask), frame.T_world_cam->t.x());
}

}  // namespace

int main() {
  const fs::path folder =
      fs::temp_directory_path() / ("dynslam_example_08_" + std::to_string(std::random_device{}()));
  write_folder(folder);
  // A copy that was cut short: half an image is no image.
  const fs::path victim = folder / "rgb" / "100.100000.png";
  fs::resize_file(victim, fs::file_size(victim) / 2);

  int read = 0, bad = 0;
  // [ten-line example]
  const std::unique_ptr<ds::Sequence> sequence = ds::open_sequence(folder);
  std::printf("%zu frames, %s, fx = %g, %zu true poses\n", sequence->size(),
              ds::to_string(sequence->sensor()), sequence->camera().fx, sequence->truth().size());
  ds::ReadAhead ahead(*sequence);  // one thread, at most four frames ahead
  while (const auto result = ahead.next()) {
    if (result->frame) {
      print(*result->frame), ++read;
    } else {
      std::printf("  frame %zu left out: %s\n", result->index, result->error.c_str()), ++bad;
    }
  }
  // [ten-line example]

  std::error_code ignored;
  fs::remove_all(folder, ignored);
  return read == kFrames - 1 && bad == 1 ? 0 : 1;
}
