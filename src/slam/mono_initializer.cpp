#include "mono_initializer.hpp"

#include <cstdint>

#include <Eigen/Core>

#include "dynslam/core/opencv.hpp"
#include "dynslam/features/matcher.hpp"
#include "dynslam/matching/motion_consensus.hpp"
#include "dynslam/matching/opencv.hpp"
#include "dynslam/matching/reject.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kMinFeatures = 100;      // of a frame to start from
constexpr std::size_t kMinStartMatches = 100;  // with the frame held; fewer: hold the present one
constexpr float kWindowShare = 0.1F;  // of the image's width: how far a feature may move in a frame
constexpr int kMaxStartDistance = 64;  // bits
constexpr float kStartRatio = 0.9F;

}  // namespace

MonoInitializer::MonoInitializer(const PinholeCamera& camera,
                                 const std::vector<float>& scale_factors)
    : camera_(camera), scale_factors_(scale_factors) {}

void MonoInitializer::hold(const TrackedFrame& frame, std::size_t index) {
  holding_ = frame.features->size() >= kMinFeatures;
  start_.first = frame;
  start_.first_index = index;
  last_seen_.clear();
  for (const cv::KeyPoint& keypoint : frame.features->keypoints) last_seen_.push_back(keypoint.pt);
}

bool MonoInitializer::offer(const TrackedFrame& frame, std::size_t index) {
  if (!holding_) {
    hold(frame, index);
    return false;
  }
  match(frame);
  if (start_.matches.size() < kMinStartMatches) {
    hold(frame, index);
    return false;
  }
  reconstruct(frame);
  return start_.reconstruction.ok();
}

void MonoInitializer::match(const TrackedFrame& frame) {
  const FrameFeatures& first = *start_.first.features;
  const FrameFeatures& now = *frame.features;
  const std::vector<float> radii(first.size(), kWindowShare * static_cast<float>(camera_.width));
  std::vector<int> min_octaves, max_octaves;
  for (const cv::KeyPoint& keypoint : first.keypoints) {
    min_octaves.push_back(keypoint.octave - 1);
    max_octaves.push_back(keypoint.octave + 1);
  }
  features::WindowPredictions windows;
  windows.positions = last_seen_;
  windows.radii = radii;
  windows.min_octaves = min_octaves;
  windows.max_octaves = max_octaves;
  windows.descriptors = first.descriptors_view();
  features::WindowFeatures features;
  features.grid = &now.grid;
  features.octaves = field(now.keypoints, &cv::KeyPoint::octave);
  features.descriptors = now.descriptors_view();
  features::WindowOptions options;
  options.max_distance = kMaxStartDistance;
  options.ratio = kStartRatio;
  options.ratio_within_octave = true;
  features::match_windowed(windows, features, options, start_.matches);
  keep_.resize(start_.matches.size());
  matching::reject(matching::DefaultRule(), start_.matches, first.keypoints, now.keypoints, keep_,
                   {}, rejection_);
  matching::erase_rejected(start_.matches, keep_);
  for (const Match& match : start_.matches) {
    last_seen_[static_cast<std::size_t>(match.query)] =
        now.keypoints[static_cast<std::size_t>(match.train)].pt;
  }
}

void MonoInitializer::reconstruct(const TrackedFrame& frame) {
  std::vector<Eigen::Vector2d> first, second;
  std::vector<float> first_scales, second_scales;
  for (const Match& match : start_.matches) {
    const cv::KeyPoint& a = start_.first.features->keypoints[static_cast<std::size_t>(match.query)];
    const cv::KeyPoint& b = frame.features->keypoints[static_cast<std::size_t>(match.train)];
    first.emplace_back(a.pt.x, a.pt.y);
    second.emplace_back(b.pt.x, b.pt.y);
    first_scales.push_back(scale_factors_[static_cast<std::size_t>(a.octave)]);
    second_scales.push_back(scale_factors_[static_cast<std::size_t>(b.octave)]);
  }
  start_.reconstruction = reconstruct_two_views(
      camera_, as_points<double>(first), as_points<double>(second), first_scales, second_scales);
}

}  // namespace dynslam::slam
