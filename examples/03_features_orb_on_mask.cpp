// Extracts ORB features off a mask of what moves and finds them again in a shifted image by
// searching around where they are expected.
#include <cstdint>
#include <cstdio>
#include <vector>

#include <opencv2/core.hpp>

#include "dynslam/core/opencv.hpp"
#include "dynslam/features/matcher.hpp"
#include "dynslam/features/orb.hpp"

namespace {

/// A wall of tiles, each of another grey, shifted to the left.
cv::Mat wall(int shift) {
  cv::Mat image(480, 640, CV_8UC1);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      unsigned tile = static_cast<unsigned>((x + shift) / 13 * 640 + y / 11) * 2654435761U;
      tile = (tile ^ (tile >> 15)) * 2246822519U;
      image.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(tile >> 24);
    }
  }
  return image;
}

}  // namespace

int main() {
  namespace features = dynslam::features;
  const cv::Mat first_image = wall(0);
  const cv::Mat second_image = wall(6);
  cv::Mat mask = cv::Mat::zeros(480, 640, CV_8UC1);  // 0 static, 255 dynamic
  mask(cv::Rect(200, 100, 180, 380)) = 255;          // somebody stands there

  // [ten-line example]
  features::OrbExtractor extractor;
  std::vector<cv::KeyPoint> first, second;
  cv::Mat first_descriptors, second_descriptors;
  const auto gray = [](const cv::Mat& m) { return dynslam::as_view<const std::uint8_t>(m); };
  extractor.extract(gray(first_image), gray(mask), first, first_descriptors);
  extractor.extract(gray(second_image), {}, second, second_descriptors);

  features::KeypointGrid grid;
  grid.build(dynslam::field(second, &cv::KeyPoint::pt), second_image.cols, second_image.rows);
  const std::vector<float> radii(first.size(), 10.0F);
  std::vector<dynslam::Match> matches;
  features::match_windowed(
      {dynslam::field(first, &cv::KeyPoint::pt), radii, {}, {}, gray(first_descriptors)},
      {&grid, {}, gray(second_descriptors), {}}, {}, matches);
  // [ten-line example]

  std::size_t on_mask = 0;
  for (const cv::KeyPoint& k : first) on_mask += mask.at<std::uint8_t>(k.pt) != 0;
  double shift = 0.0;
  for (const dynslam::Match& m : matches) {
    shift += static_cast<double>(first[static_cast<std::size_t>(m.query)].pt.x -
                                 second[static_cast<std::size_t>(m.train)].pt.x);
  }
  std::printf("%zu features, %zu of them on the mask, which covers %.0f %% of the image\n",
              first.size(), on_mask, 100.0 * cv::countNonZero(mask) / (640.0 * 480.0));
  std::printf("%zu found again in the second image, moved by %.2f pixels on average (6 is true)\n",
              matches.size(), shift / static_cast<double>(matches.size()));
  return on_mask == 0 ? 0 : 1;
}
