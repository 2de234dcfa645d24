#include "tracker.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

#include "dynslam/core/opencv.hpp"
#include "dynslam/factors/static_weight.hpp"
#include "dynslam/features/matcher.hpp"

#include "stopwatch.hpp"
#include "visibility.hpp"

namespace dynslam::slam {
namespace {

constexpr int kMinPnpInliers = 12;
constexpr double kWeightMomentum = 0.5;  // share of the last frames in a point's weight
// Errors of neighbouring depth pixels are not independent: a grid of thousands is worth dozens.
constexpr double kAlignmentTrust = 0.01;

}  // namespace

void Tracker::Predictions::resize(std::size_t n) {
  ids.assign(n, kNoId);
  positions.resize(n);
  weights.assign(n, 1.0F);
  pixels.resize(n);
  radii.assign(n, 0.0F);
  min_octaves.resize(n);
  max_octaves.resize(n);
}

Tracker::Tracker(const DepthCamera& camera, const SystemOptions& options,
                 const std::vector<float>& scale_factors)
    : camera_(camera),
      options_(options.tracking),
      weighted_(options.weights != factors::WeightMode::kFixed),
      scale_factors_(scale_factors),
      pose_(camera, scale_factors, options.weights) {}

float Tracker::initial_weight(float remembered) const {
  if (!weighted_) return 1.0F;
  const factors::DetectorVote votes[] = {{1.0, 1.0}};
  factors::StaticWeightOptions options;
  options.momentum = kWeightMomentum;
  return static_cast<float>(factors::initial_weight(votes, remembered, options));
}

TrackerTimes Tracker::take_times() {
  const TrackerTimes times = times_;
  times_ = {};
  return times;
}

void Tracker::predict_from_last(const Map& map, const TrackedFrame& last, double radius,
                                const RigidTransform& T_cam_world) {
  const FrameFeatures& features = *last.features;
  const RigidTransform T_world_last = last.T_cam_world.inverse();
  predictions_.resize(features.size());
  for (std::size_t i = 0; i < features.size(); ++i) {
    if (last.rejected[i] != 0) continue;
    const cv::KeyPoint& keypoint = features.keypoints[i];
    if (const MapPoint* point = map.find_point(last.points[i])) {
      predictions_.ids[i] = last.points[i];
      predictions_.positions[i] = point->position;
      predictions_.weights[i] = point->static_weight;
    } else if (features.depths[i] > 0.0F) {
      predictions_.positions[i] =
          T_world_last * camera_.unproject({keypoint.pt.x, keypoint.pt.y}, features.depths[i]);
    } else {
      continue;
    }
    const auto pixel = camera_.project_into_image(T_cam_world * predictions_.positions[i]);
    if (!pixel) continue;
    predictions_.pixels[i] = {static_cast<float>(pixel->x()), static_cast<float>(pixel->y())};
    predictions_.radii[i] =
        static_cast<float>(radius) * scale_factors_[static_cast<std::size_t>(keypoint.octave)];
    predictions_.min_octaves[i] = keypoint.octave - 1;
    predictions_.max_octaves[i] = keypoint.octave + 1;
  }
}

void Tracker::match_predictions(DescriptorsView descriptors, float ratio,
                                const TrackedFrame& frame) {
  features::WindowPredictions windows;
  windows.positions = predictions_.pixels;
  windows.radii = predictions_.radii;
  windows.min_octaves = predictions_.min_octaves;
  windows.max_octaves = predictions_.max_octaves;
  windows.descriptors = descriptors;
  features::WindowFeatures features;
  features.grid = &frame.features->grid;
  features.octaves = field(frame.features->keypoints, &cv::KeyPoint::octave);
  features.descriptors = frame.features->descriptors_view();
  features.taken = taken_;
  features::WindowOptions options;
  options.ratio = ratio;
  options.ratio_within_octave = true;
  features::match_windowed(windows, features, options, found_);
}

int Tracker::optimize(TrackedFrame& frame, const std::vector<PointId>& ids) {
  const ScopedTimer timer(times_.optimize);
  const factors::PoseResult result =
      pose_.solve(matches_, *frame.features, frame.T_cam_world, prior_ ? &*prior_ : nullptr);
  if (!result) return 0;
  frame.T_cam_world = result.T_cam_world;
  const Span<const std::uint8_t> inliers = pose_.inliers();
  for (std::size_t i = 0; i < matches_.size(); ++i) {
    const PointMatch& match = matches_[i];
    frame.points[match.feature] = inliers[i] != 0 ? ids[match.source] : kNoId;
    frame.rejected[match.feature] = inliers[i] == 0;
  }
  return result.inliers;
}

bool Tracker::match_last_frame(const Map& map, const TrackedFrame& last, double radius,
                               TrackedFrame& frame) {
  {
    const ScopedTimer timer(times_.match);
    frame.T_cam_world = expected_pose(last);
    taken_.clear();
    predict_from_last(map, last, radius, frame.T_cam_world);
    match_predictions(last.features->descriptors_view(), 0.9F, frame);
    matches_.clear();
    for (const Match& match : found_) {
      const auto source = static_cast<std::uint32_t>(match.query);
      const auto feature = static_cast<std::uint32_t>(match.train);
      matches_.push_back({source, feature, predictions_.positions[source],
                          initial_weight(predictions_.weights[source])});
    }
  }
  return static_cast<int>(matches_.size()) >= options_.min_inliers &&
         optimize(frame, predictions_.ids) >= options_.min_inliers;
}

bool Tracker::track_last_frame(const Map& map, const TrackedFrame& last, TrackedFrame& frame) {
  if (match_last_frame(map, last, options_.frame_radius, frame)) return true;
  return match_last_frame(map, last, 2.0 * options_.frame_radius, frame);
}

bool Tracker::align_depth(const TrackedFrame& last, const TrackedFrame& frame) {
  const ScopedTimer timer(times_.match);
  if (last.depth.empty() || frame.depth.empty()) return false;
  build_surface_grid(as_view<const float>(last.depth), camera_, last_surface_);
  build_surface_grid(as_view<const float>(frame.depth), camera_, surface_);
  for (const RigidTransform& guess : {velocity_.inverse(), RigidTransform()}) {
    const auto alignment = align_surfaces(last_surface_, surface_, camera_, guess);
    if (!alignment) continue;
    velocity_ = alignment->T_from_to.inverse();
    factors::PosePrior prior;
    prior.mean = velocity_ * last.T_cam_world;
    // xi of T_from_to is -Ad(T_from_to) times that of T_cam_world.
    const Matrix6d ad = se3_adjoint(alignment->T_from_to);
    prior.information = kAlignmentTrust * ad.transpose() * alignment->information * ad;
    prior_ = prior;
    return true;
  }
  return false;
}

void Tracker::predict_from_map(const RigidTransform& T_cam_world, double radius) {
  const Visibility visible(camera_, scale_factors_, T_cam_world);
  predictions_.resize(local_map_.size());
  for (std::size_t i = 0; i < local_map_.size(); ++i) {
    const auto sighting = visible(local_map_.positions[i], local_map_.normals[i],
                                  local_map_.min_distances[i], local_map_.max_distances[i]);
    if (!sighting) continue;
    predictions_.ids[i] = local_map_.ids[i];
    predictions_.positions[i] = local_map_.positions[i];
    predictions_.weights[i] = local_map_.weights[i];
    predictions_.pixels[i] = {static_cast<float>(sighting->pixel.x()),
                              static_cast<float>(sighting->pixel.y())};
    predictions_.radii[i] = static_cast<float>(radius * (sighting->cosine > 0.998 ? 0.7 : 1.0)) *
                            scale_factors_[static_cast<std::size_t>(sighting->octave)];
    predictions_.min_octaves[i] = sighting->octave - 1;
    predictions_.max_octaves[i] = sighting->octave + 1;
  }
}

int Tracker::track_local_map(Map& map, KeyframeId reference, TrackedFrame& frame, bool wide) {
  {
    const ScopedTimer timer(times_.match);
    local_map_.collect(map, frame.points, reference, options_.local_keyframes);
    taken_.clear();
    predict_from_map(frame.T_cam_world, options_.map_radius * (wide ? 2.0 : 1.0));
    match_predictions(local_map_.descriptors_view(), 0.8F, frame);
    std::fill(frame.points.begin(), frame.points.end(), kNoId);
    matches_.clear();
    for (const Match& match : found_) {
      const auto source = static_cast<std::uint32_t>(match.query);
      const auto feature = static_cast<std::uint32_t>(match.train);
      matches_.push_back({source, feature, predictions_.positions[source],
                          initial_weight(predictions_.weights[source])});
    }
  }
  if (static_cast<int>(matches_.size()) < options_.min_inliers && !prior_) return 0;
  const int inliers = optimize(frame, predictions_.ids);
  for (const PointId id : predictions_.ids) {
    if (id != kNoId) ++map.point(id).visible;
  }
  for (const PointId id : frame.points) {
    if (id != kNoId) ++map.point(id).found;
  }
  if (weighted_) {
    const Span<const float> weights = pose_.weights();
    for (std::size_t i = 0; i < matches_.size(); ++i) {
      map.point(predictions_.ids[matches_[i].source]).static_weight = weights[i];
    }
  }
  return inliers;
}

bool Tracker::solve_pnp(const std::vector<Eigen::Vector3d>& points, const FrameFeatures& features,
                        const std::vector<Match>& matches, RigidTransform& T_cam_world,
                        std::vector<Match>& inliers) const {
  std::vector<cv::Point3d> object;
  std::vector<cv::Point2d> image;
  for (const Match& match : matches) {
    const Eigen::Vector3d& point = points[static_cast<std::size_t>(match.query)];
    const cv::Point2f pixel = features.keypoints[static_cast<std::size_t>(match.train)].pt;
    object.emplace_back(point.x(), point.y(), point.z());
    image.emplace_back(pixel.x, pixel.y);
  }
  const cv::Matx33d K(camera_.fx, 0, camera_.cx, 0, camera_.fy, camera_.cy, 0, 0, 1);
  cv::Vec3d rotation, translation;
  std::vector<int> chosen;
  if (!cv::solvePnPRansac(object, image, K, cv::noArray(), rotation, translation, false, 300, 4.0F,
                          0.999, chosen, cv::SOLVEPNP_AP3P)) {
    return false;
  }
  T_cam_world = {so3_exp({rotation[0], rotation[1], rotation[2]}),
                 {translation[0], translation[1], translation[2]}};
  inliers.clear();
  for (const int i : chosen) inliers.push_back(matches[static_cast<std::size_t>(i)]);
  return T_cam_world.all_finite() && static_cast<int>(inliers.size()) >= kMinPnpInliers;
}

bool Tracker::match_keyframe(const Map& map, KeyframeId id, TrackedFrame& frame) {
  const ScopedTimer timer(times_.match);
  const Keyframe& keyframe = map.keyframe(id);
  features::BruteForceOptions options;
  options.max_distance = 64;
  options.ratio = 0.8F;
  options.cross_check = true;
  std::vector<Match> matches;
  features::match_brute_force(keyframe.features->descriptors_view(),
                              frame.features->descriptors_view(), options, matches);
  std::vector<Eigen::Vector3d> positions(keyframe.points.size());
  const auto pointless = [&](const Match& match) {
    const auto feature = static_cast<std::size_t>(match.query);
    const MapPoint* point = map.find_point(keyframe.points[feature]);
    if (point != nullptr) positions[feature] = point->position;
    return point == nullptr;
  };
  matches.erase(std::remove_if(matches.begin(), matches.end(), pointless), matches.end());
  std::vector<Match> inliers;
  if (static_cast<int>(matches.size()) < kMinPnpInliers ||
      !solve_pnp(positions, *frame.features, matches, frame.T_cam_world, inliers)) {
    return false;
  }
  matches_.clear();
  for (const Match& match : inliers) {
    const auto source = static_cast<std::uint32_t>(match.query);
    matches_.push_back({source, static_cast<std::uint32_t>(match.train), positions[source], 1.0F});
  }
  std::fill(frame.points.begin(), frame.points.end(), kNoId);
  return optimize(frame, keyframe.points) >= kMinPnpInliers;
}

}  // namespace dynslam::slam
