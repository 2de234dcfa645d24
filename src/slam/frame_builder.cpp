#include "frame_builder.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"

#include "frame_images.hpp"

namespace dynslam::slam {
namespace {

constexpr const char* kTrack = "System::track";

// Shares of the features asked for: how many more for each share of the image that is hidden, at
// the most, and how many on what moved a frame ago.
constexpr double kMoreForHidden = 2.0;
constexpr double kMostMore = 0.3;
constexpr double kCrowdShare = 0.25;
constexpr int kStepsToCross = 80;  // frames in which a mover crosses the image: it has gone on

std::string describe(const cv::Mat& image) {
  return std::to_string(image.cols) + "x" + std::to_string(image.rows) + " " +
         cv::typeToString(image.type());
}

std::string expected(const DepthCamera& camera, const char* type) {
  return std::to_string(camera.width) + "x" + std::to_string(camera.height) + " " + type;
}

}  // namespace

FrameBuilder::FrameBuilder(const DepthCamera& camera, const SystemOptions& options)
    : camera_(camera),
      sensor_(options.sensor),
      geometry_(options.geometry),
      max_depth_(options.tracking.max_depth),
      max_stereo_depth_(options.tracking.max_depth_baselines * camera.baseline()),
      extractor_(options.tracking.orb) {
  if (sensor_ == Sensor::kStereo) {
    stereo_.emplace(camera, options.tracking.orb, options.tracking.stereo);
  }
}

void FrameBuilder::require_valid(const FrameInput& frame) const {
  const auto fits = [&](const cv::Mat& image) {
    return image.dims == 2 && image.cols == camera_.width && image.rows == camera_.height;
  };
  const auto check = [&](const char* name, const cv::Mat& image, bool type_fits, const char* type) {
    if (!fits(image) || !type_fits) {
      throw_invalid_argument(kTrack, name, describe(image), expected(camera_, type));
    }
  };
  check("image", frame.image, frame.image.type() == CV_8UC3 || frame.image.type() == CV_8UC1,
        "CV_8UC3 or CV_8UC1");
  if (!frame.depth.empty()) check("depth", frame.depth, frame.depth.type() == CV_32FC1, "CV_32FC1");
  if (sensor_ == Sensor::kStereo) {
    check("right", frame.right, frame.right.type() == frame.image.type(), "of the image's type");
  }
  if (!frame.mask.empty()) check("mask", frame.mask, frame.mask.type() == CV_8UC1, "CV_8UC1");
}

// What moves is of no use to the pose, and what it hides was. Some features stay on it, so that
// they tell when it stops, and that what was accused wrongly is seen again.
features::OrbBudget FrameBuilder::budget(double masked_share, const KnownMovers& movers) {
  features::OrbBudget budget;
  const int wanted = extractor_.options().max_features;
  budget.max_features = wanted;
  if (!geometry_) return budget;
  const double more = std::min(kMostMore, kMoreForHidden * (masked_share + movers.share));
  budget.max_features = static_cast<int>(std::lround(wanted * (1.0 + more)));
  if (movers.mask.empty()) return budget;
  const int side = 2 * (camera_.width / kStepsToCross) + 1;
  cv::dilate(movers.mask, crowd_, cv::getStructuringElement(cv::MORPH_RECT, {side, side}));
  budget.crowd = as_view<const std::uint8_t>(crowd_);
  budget.max_in_crowd = static_cast<int>(std::lround(kCrowdShare * wanted));
  return budget;
}

FrameFeaturesPtr FrameBuilder::build(const FrameInput& frame, const KnownMovers& movers) {
  auto features = std::make_shared<FrameFeatures>();
  if (frame.image.channels() == 3) {
    cv::cvtColor(frame.image, gray_, cv::COLOR_BGR2GRAY);
  } else {
    frame.image.copyTo(gray_);  // the caller's pixels are not kept
  }
  if (!frame.mask.empty()) {
    features->masked_share =
        static_cast<float>(cv::countNonZero(frame.mask)) / static_cast<float>(frame.mask.total());
  }
  extractor_.extract(as_view<const std::uint8_t>(gray_), as_view<const std::uint8_t>(frame.mask),
                     budget(features->masked_share, movers), features->keypoints,
                     features->descriptors);
  features->grid.build(field(features->keypoints, &cv::KeyPoint::pt), camera_.width,
                       camera_.height);
  features->colors.resize(features->size());
  for (std::size_t i = 0; i < features->size(); ++i) {
    const cv::Point at(features->keypoints[i].pt);
    const auto gray = gray_.at<std::uint8_t>(at);
    features->colors[i] =
        frame.image.channels() == 3 ? frame.image.at<cv::Vec3b>(at) : cv::Vec3b(gray, gray, gray);
  }
  features->depths.assign(features->size(), 0.0F);
  features->right_columns.assign(features->size(), std::numeric_limits<float>::quiet_NaN());
  if (sensor_ == Sensor::kRgbd && !frame.depth.empty()) add_depth(frame.depth, *features);
  if (sensor_ == Sensor::kStereo) add_stereo(frame.right, *features);
  mean_of_cells(gray_, gray_cells_);
  return features;
}

void FrameBuilder::view_levels(std::vector<GrayView>& levels) const {
  levels.clear();
  if (sensor_ == Sensor::kMono) return;
  for (int i = 0; i < extractor_.options().levels; ++i) levels.push_back(extractor_.level(i));
}

void FrameBuilder::copy_depth(const FrameInput& frame, TrackedFrame& copy) const {
  const bool deep = sensor_ == Sensor::kRgbd && !frame.depth.empty();
  if (geometry_ && deep && !frame.mask.empty()) {
    frame.mask.copyTo(copy.mask);
    split_depth(frame.depth, frame.mask, copy.depth, copy.hidden_depth);
    return;
  }
  copy.mask.release();
  copy.hidden_depth.release();
  if (!deep) {
    copy.depth.release();
    return;
  }
  frame.depth.copyTo(copy.depth);
  if (!frame.mask.empty()) copy.depth.setTo(0.0F, frame.mask);
}

void FrameBuilder::add_depth(const cv::Mat& depth, FrameFeatures& features) const {
  for (std::size_t i = 0; i < features.size(); ++i) {
    const cv::Point2f pt = features.keypoints[i].pt;
    const int x = std::min(static_cast<int>(std::lround(pt.x)), camera_.width - 1);
    const int y = std::min(static_cast<int>(std::lround(pt.y)), camera_.height - 1);
    const float z = depth.at<float>(y, x);
    if (!(z > static_cast<float>(kMinDepth) && z <= static_cast<float>(max_depth_))) continue;
    features.depths[i] = z;
    features.right_columns[i] = static_cast<float>(camera_.right_column(pt.x, z));
  }
}

void FrameBuilder::add_stereo(const cv::Mat& right, FrameFeatures& features) {
  if (right.channels() == 3) {
    cv::cvtColor(right, right_gray_, cv::COLOR_BGR2GRAY);
  } else {
    right_gray_ = right;
  }
  stereo_->match(as_view<const std::uint8_t>(gray_), as_view<const std::uint8_t>(right_gray_),
                 features.keypoints, features.descriptors_view(), features.right_columns);
  right_gray_.release();
  for (std::size_t i = 0; i < features.size(); ++i) {
    const double disparity = features.keypoints[i].pt.x - features.right_columns[i];
    const double z = camera_.bf / disparity;
    if (z <= max_stereo_depth_) features.depths[i] = static_cast<float>(z);  // NaN: no
  }
}

}  // namespace dynslam::slam
