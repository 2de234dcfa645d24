#include "dynslam/slam/stereo_matcher.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <string>
#include <utility>

#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/features/hamming.hpp"

#include "median.hpp"

namespace dynslam::slam {
namespace {

constexpr float kRowSlack = 2.0F;       // pixels of the level that a match may be off its row
constexpr double kMinDisparity = 0.05;  // pixels: what is farther has no depth

// The image without a copy.
cv::Mat as_mat(GrayView image) {
  return cv::Mat(image.height, image.width, CV_8UC1, const_cast<std::uint8_t*>(image.data),
                 static_cast<std::size_t>(image.stride_bytes));
}

struct Patch {
  const cv::Mat* image;
  int x, y;
};

int patch_sum(const Patch& patch, int radius) {
  int sum = 0;
  for (int dy = -radius; dy <= radius; ++dy) {
    const auto* row = patch.image->ptr<std::uint8_t>(patch.y + dy) + patch.x;
    for (int dx = -radius; dx <= radius; ++dx) sum += row[dx];
  }
  return sum;
}

// Mean absolute difference of two patches, each less its mean.
float difference(const Patch& a, int sum_a, const Patch& b, int radius) {
  const int side = 2 * radius + 1;
  const int shift = (patch_sum(b, radius) - sum_a) / (side * side);
  int total = 0;
  for (int dy = -radius; dy <= radius; ++dy) {
    const auto* row_a = a.image->ptr<std::uint8_t>(a.y + dy) + a.x;
    const auto* row_b = b.image->ptr<std::uint8_t>(b.y + dy) + b.x;
    for (int dx = -radius; dx <= radius; ++dx) total += std::abs(row_b[dx] - row_a[dx] - shift);
  }
  return static_cast<float>(total) / static_cast<float>(side * side);
}

bool contains(const Patch& patch, int margin_x, int margin_y) {
  return patch.x >= margin_x && patch.y >= margin_y && patch.x < patch.image->cols - margin_x &&
         patch.y < patch.image->rows - margin_y;
}

}  // namespace

void StereoOptions::validate() const {
  constexpr const char* kName = "StereoOptions";
  require(min_depth_baselines > 0.0, kName, "min_depth_baselines", min_depth_baselines,
          "a positive number");
  require(max_distance >= 0, kName, "max_distance", max_distance, "at least 0");
  require(patch_radius >= 1 && patch_radius <= 20, kName, "patch_radius", patch_radius, "1 to 20");
  require(search_radius >= 1 && search_radius <= 20, kName, "search_radius", search_radius,
          "1 to 20");
  require(max_difference_ratio > 0.0, kName, "max_difference_ratio", max_difference_ratio,
          "a positive number");
}

StereoMatcher::StereoMatcher(const DepthCamera& camera, const features::OrbOptions& orb,
                             const StereoOptions& options)
    : camera_(camera), options_(options), extractor_(orb) {
  camera.validate();
  options.validate();
}

void StereoMatcher::build_pyramid(const cv::Mat& image, std::vector<cv::Mat>& pyramid) const {
  const std::vector<float>& scales = extractor_.scale_factors();
  pyramid.resize(scales.size());
  pyramid[0] = image;
  for (std::size_t level = 1; level < scales.size(); ++level) {
    const cv::Size size(cvRound(static_cast<float>(image.cols) / scales[level]),
                        cvRound(static_cast<float>(image.rows) / scales[level]));
    cv::resize(pyramid[level - 1], pyramid[level], size, 0, 0, cv::INTER_LINEAR);
  }
}

void StereoMatcher::sort_into_rows() {
  rows_.assign(static_cast<std::size_t>(camera_.height), {});
  for (std::size_t i = 0; i < right_keypoints_.size(); ++i) {
    const cv::KeyPoint& keypoint = right_keypoints_[i];
    const float slack =
        kRowSlack * extractor_.scale_factors()[static_cast<std::size_t>(keypoint.octave)];
    const int first = std::max(0, static_cast<int>(std::ceil(keypoint.pt.y - slack)));
    const int last = std::min(camera_.height - 1, static_cast<int>(keypoint.pt.y + slack));
    for (int row = first; row <= last; ++row) {
      rows_[static_cast<std::size_t>(row)].push_back(static_cast<int>(i));
    }
  }
}

// The right feature that looks most like a left one and may be the same, or -1.
int StereoMatcher::nearest(const cv::KeyPoint& left, const std::uint8_t* descriptor) const {
  const auto max_disparity =
      static_cast<float>(camera_.fx / options_.min_depth_baselines);  // bf / (k b)
  const auto row = static_cast<std::size_t>(std::clamp(cvRound(left.pt.y), 0, camera_.height - 1));
  const float slack = extractor_.scale_factors()[static_cast<std::size_t>(left.octave)];
  int best = options_.max_distance + 1, found = -1;
  for (const int i : rows_[row]) {
    const cv::KeyPoint& right = right_keypoints_[static_cast<std::size_t>(i)];
    if (std::abs(right.octave - left.octave) > 1) continue;
    const float disparity = left.pt.x - right.pt.x;
    if (disparity < -slack || disparity > max_disparity) continue;
    const int distance = features::hamming_distance(
        descriptor, right_descriptors_.ptr<std::uint8_t>(i), features::kOrbDescriptorBytes);
    if (distance >= best) continue;
    best = distance;
    found = i;
  }
  return found;
}

bool StereoMatcher::refine(const cv::KeyPoint& left, const cv::KeyPoint& right, Fit& fit) const {
  const auto level = static_cast<std::size_t>(left.octave);
  const float scale = extractor_.scale_factors()[level];
  const auto on_level = [&](float x) { return cvRound(features::to_level(x, scale)); };
  const int radius = options_.patch_radius, search = options_.search_radius;
  const Patch here{&left_pyramid_[level], on_level(left.pt.x), on_level(left.pt.y)};
  const Patch there{&right_pyramid_[level], on_level(right.pt.x), here.y};
  if (!contains(here, radius, radius) || !contains(there, radius + search, radius)) return false;
  const int sum = patch_sum(here, radius);
  std::vector<float> differences;
  for (int d = -search; d <= search; ++d) {
    differences.push_back(difference(here, sum, {there.image, there.x + d, there.y}, radius));
  }
  const auto best = std::min_element(differences.begin(), differences.end());
  if (best == differences.begin() || best + 1 == differences.end()) return false;
  // The least of the parabola through the three.
  const float before = best[-1] - *best, after = best[1] - *best;
  if (!(before + after > 0.0F)) return false;
  const float fraction = 0.5F * (before - after) / (before + after);
  const auto moved = static_cast<float>(there.x + (best - differences.begin()) - search - here.x);
  fit.column = left.pt.x + (moved + fraction) * scale;
  fit.difference = *best;
  return true;
}

void StereoMatcher::match(GrayView left, GrayView right, Span<const cv::KeyPoint> keypoints,
                          DescriptorsView descriptors, std::vector<float>& right_columns) {
  constexpr const char* kName = "StereoMatcher::match";
  for (const auto& [name, image] : {std::pair("left", left), std::pair("right", right)}) {
    require(image.width == camera_.width && image.height == camera_.height, kName, name,
            std::to_string(image.width) + "x" + std::to_string(image.height),
            std::to_string(camera_.width) + "x" + std::to_string(camera_.height));
  }
  require(static_cast<std::size_t>(descriptors.height) == keypoints.size(), kName, "descriptors",
          descriptors.height, std::to_string(keypoints.size()) + " rows");
  extractor_.extract(right, {}, right_keypoints_, right_descriptors_);
  build_pyramid(as_mat(left), left_pyramid_);
  build_pyramid(as_mat(right), right_pyramid_);
  sort_into_rows();
  right_columns.assign(keypoints.size(), std::numeric_limits<float>::quiet_NaN());
  std::vector<float> fits(keypoints.size(), 0.0F), sorted;
  for (std::size_t i = 0; i < keypoints.size(); ++i) {
    const int found = nearest(keypoints[i], descriptors.row(static_cast<int>(i)));
    Fit fit;
    if (found < 0 ||
        !refine(keypoints[i], right_keypoints_[static_cast<std::size_t>(found)], fit)) {
      continue;
    }
    const double disparity = keypoints[i].pt.x - fit.column;
    if (disparity < kMinDisparity || disparity > camera_.fx / options_.min_depth_baselines) {
      continue;
    }
    right_columns[i] = fit.column;
    fits[i] = fit.difference;
    sorted.push_back(fit.difference);
  }
  if (sorted.empty()) return;
  const auto bound = static_cast<float>(options_.max_difference_ratio) * median(sorted);
  for (std::size_t i = 0; i < fits.size(); ++i) {
    if (fits[i] > bound) right_columns[i] = std::numeric_limits<float>::quiet_NaN();
  }
}

}  // namespace dynslam::slam
