#include "loop_check.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "dynslam/core/opencv.hpp"
#include "dynslam/features/matcher.hpp"

#include "loop_scale.hpp"
#include "visibility.hpp"

namespace dynslam::slam {
namespace {

constexpr double kFirstRadius = 8.0;   // pixels at the finest level, under the motion of a RANSAC
constexpr double kSecondRadius = 4.0;  // under the refined one
constexpr int kMaxPlaceDistance = 64;  // bits
constexpr std::size_t kMinPlaceMatches = 12;
constexpr int kColumns = 8, kRows = 6;  // cells of the image
constexpr double kCellShare = 0.2;      // of a cell's points that confirm the cell

template <typename Value>
Value not_a_point() {
  return Value::Constant(std::numeric_limits<double>::quiet_NaN());
}

}  // namespace

LoopCheck::LoopCheck(const DepthCamera& camera, const std::vector<float>& scale_factors,
                     const SystemOptions& options, SharedMap& shared,
                     const KeyframeDatabase& database)
    : camera_(camera),
      scale_factors_(scale_factors),
      options_(options.loops),
      with_scale_(options.sensor == Sensor::kMono),
      shared_(shared),
      database_(database),
      pose_(camera, scale_factors, factors::WeightMode::kFixed) {}

bool LoopCheck::copy(KeyframeId id, Side& side) const {
  const BackgroundLock lock(shared_.mutex);
  const Keyframe* keyframe = shared_.map.find_keyframe(id);
  if (keyframe == nullptr) return false;
  side.features = keyframe->features;
  side.T_cam_world = keyframe->T_cam_world;
  side.points.assign(side.features->size(), not_a_point<Eigen::Vector3d>());
  for (std::size_t i = 0; i < side.points.size(); ++i) {
    const MapPoint* point = shared_.map.find_point(keyframe->points[i]);
    const cv::Point2f pixel = side.features->keypoints[i].pt;
    if (point != nullptr) {
      side.points[i] = side.T_cam_world * point->position;
    } else if (side.features->depths[i] > 0.0F) {
      side.points[i] = camera_.unproject({pixel.x, pixel.y}, side.features->depths[i]);
    }
  }
  return true;
}

loop::Verification LoopCheck::find_motion(KeyframeId query, KeyframeId candidate) {
  std::vector<Match> matches;
  loop::match_by_nodes(database_.words(query).direct, query_.features->descriptors_view(),
                       database_.words(candidate).direct, candidate_.features->descriptors_view(),
                       {}, matches);
  const auto n = static_cast<Eigen::Index>(matches.size());
  Eigen::Matrix3Xd query_points(3, n), candidate_points(3, n);
  Eigen::Matrix2Xd query_pixels(2, n), candidate_pixels(2, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const auto q = static_cast<std::size_t>(matches[static_cast<std::size_t>(i)].query);
    const auto c = static_cast<std::size_t>(matches[static_cast<std::size_t>(i)].train);
    const cv::Point2f a = query_.features->keypoints[q].pt,
                      b = candidate_.features->keypoints[c].pt;
    query_points.col(i) = query_.points[q];
    candidate_points.col(i) = candidate_.points[c];
    query_pixels.col(i) << a.x, a.y;
    candidate_pixels.col(i) << b.x, b.y;
  }
  return loop::verify_similarity({query_points, query_pixels, candidate_points, candidate_pixels},
                                 camera_, camera_, with_scale_);
}

loop::Verification LoopCheck::verify(KeyframeId query, KeyframeId candidate, LoopMatch& found) {
  loop::Verification result;
  if (!copy(query, query_) || !copy(candidate, candidate_)) return result;
  result = find_motion(query, candidate);
  if (result.verdict != loop::Verdict::kVerified) return result;
  {
    const BackgroundLock lock(shared_.mutex);
    place_.collect(shared_.map, {}, candidate, kPlaceKeyframes);
  }
  found.query = query;
  found.match = candidate;
  refined_ = result.T_candidate_query.inverse() * candidate_.T_cam_world;
  const bool begun = confirm(refined_, kFirstRadius, found) >= static_cast<int>(kMinPlaceMatches);
  const int inliers = begun ? confirm(refined_, kSecondRadius, found) : 0;
  const RigidTransform T_query_match = refined_ * candidate_.T_cam_world.inverse();
  const std::optional<double> scale = with_scale_ ? agreed_scale(log_scales_) : 1.0;
  result.inliers = static_cast<std::size_t>(inliers);
  result.T_candidate_query = T_query_match.inverse();
  if (inliers < options_.min_inliers || !scale) {
    result.verdict = loop::Verdict::kNoGeometry;
  } else if (confirmed_share() < options_.min_confirmed) {
    result.verdict = loop::Verdict::kOtherScene;
  } else {
    found.S_query_match = {*scale, T_query_match.R, *scale * T_query_match.t};
    result.scale = 1.0 / *scale;
  }
  return result;
}

std::size_t LoopCheck::cell_of(cv::Point2f pixel) const {
  const int column =
      std::clamp(static_cast<int>(pixel.x) * kColumns / camera_.width, 0, kColumns - 1);
  const int row = std::clamp(static_cast<int>(pixel.y) * kRows / camera_.height, 0, kRows - 1);
  return static_cast<std::size_t>(row * kColumns + column);
}

// Of the cells that should show the place, those that do. Counting points instead would let an
// object of much texture speak for its surroundings.
double LoopCheck::confirmed_share() const {
  int visible = 0, confirmed = 0;
  for (std::size_t c = 0; c < visible_.size(); ++c) {
    if (visible_[c] == 0) continue;
    ++visible;
    if (confirmed_[c] >= kCellShare * visible_[c]) ++confirmed;
  }
  return visible == 0 ? 0.0 : static_cast<double>(confirmed) / visible;
}

// Looks for the place's points in the query and refines the pose on what is found.
int LoopCheck::confirm(const RigidTransform& T_query_world, double radius, LoopMatch& found) {
  const Visibility visible(camera_, scale_factors_, T_query_world);
  const std::size_t n = place_.size();
  std::vector<cv::Point2f> pixels(n);
  std::vector<float> radii(n, 0.0F);
  std::vector<int> min_octaves(n), max_octaves(n);
  found.visible = 0;
  visible_.assign(kColumns * kRows, 0);
  confirmed_.assign(kColumns * kRows, 0);
  for (std::size_t i = 0; i < n; ++i) {
    const auto sighting = visible(place_.positions[i], place_.normals[i], place_.min_distances[i],
                                  place_.max_distances[i]);
    if (!sighting) continue;
    ++found.visible;
    pixels[i] = {static_cast<float>(sighting->pixel.x()), static_cast<float>(sighting->pixel.y())};
    ++visible_[cell_of(pixels[i])];
    radii[i] =
        static_cast<float>(radius) * scale_factors_[static_cast<std::size_t>(sighting->octave)];
    min_octaves[i] = sighting->octave - 1;
    max_octaves[i] = sighting->octave + 1;
  }
  features::WindowFeatures features;
  features.grid = &query_.features->grid;
  features.octaves = field(query_.features->keypoints, &cv::KeyPoint::octave);
  features.descriptors = query_.features->descriptors_view();
  features::WindowOptions options;
  options.max_distance = kMaxPlaceDistance;
  std::vector<Match> matches;
  features::match_windowed({pixels, radii, min_octaves, max_octaves, place_.descriptors_view()},
                           features, options, matches);
  std::vector<PointMatch> pairs;
  for (const Match& match : matches) {
    const auto source = static_cast<std::uint32_t>(match.query);
    pairs.push_back({source, static_cast<std::uint32_t>(match.train), place_.positions[source],
                     place_.weights[source]});
  }
  found.points.clear();
  found.inliers = 0;
  log_scales_.clear();
  const factors::PoseResult pose = pose_.solve(pairs, *query_.features, T_query_world);
  if (!pose) return 0;
  refined_ = pose.T_cam_world;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    if (pose_.inliers()[i] == 0) continue;
    found.points.emplace_back(pairs[i].feature, place_.ids[pairs[i].source]);
    ++confirmed_[cell_of(pixels[pairs[i].source])];
    const double z = query_.points[pairs[i].feature].z();
    if (z > 0.0) log_scales_.push_back(std::log(z / (refined_ * pairs[i].position).z()));
  }
  found.inliers = pose.inliers;
  return pose.inliers;
}

}  // namespace dynslam::slam
