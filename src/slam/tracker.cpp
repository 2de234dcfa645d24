#include "tracker.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

#include "dynslam/core/opencv.hpp"
#include "dynslam/factors/static_weight.hpp"
#include "dynslam/features/matcher.hpp"
#include "dynslam/matching/motion_consensus.hpp"
#include "dynslam/matching/opencv.hpp"
#include "dynslam/matching/reject.hpp"

#include "median.hpp"
#include "stopwatch.hpp"
#include "visibility.hpp"

namespace dynslam::slam {
namespace {

constexpr int kMinPnpInliers = 12;
constexpr double kWeightMomentum = 0.5;  // share of the last frames in a point's weight

constexpr double kAlignedTranslation = 0.02;  // metres that aligned surfaces may be off
constexpr double kAlignedRotation = 0.01;     // radians
constexpr double kContradiction = 10.6;       // squared, by these: 10 % of 6 degrees of freedom
constexpr float kTrialWeight = 0.05F;         // of a point on trial beside one that is proven
constexpr double kLeastSurface = 0.25;  // times that, of a near one, whose feature covers little
constexpr double kMostSurface = 4.0;    // and of a far one
constexpr double kContradicted = 2.0;   // times as much weight agrees without what is expected
constexpr double kAgrees = 0.15;        // log-odds of standing still that a fitting match adds
constexpr double kUsualStep = 0.1;      // seconds; the longer, the more it says
constexpr double kMostSteps = 10.0;     // and at most as many times
// Seconds between frames, beyond which no points are sought without a corner: few keyframes have
// seen them, from far apart. (fr3_cabinet, 1.5 Hz, has up to 0.1 m with them.)
constexpr double kSeekingStep = 0.3;
constexpr double kDisagrees = -1.0;  // and one that does not
constexpr double kSurest = 4.0;      // most that is remembered

// Squared, of two poses, by what aligned surfaces may be off.
double distance(const RigidTransform& a, const RigidTransform& b) {
  const Vector6d xi = se3_log(a * b.inverse());
  return xi.head<3>().squaredNorm() / (kAlignedTranslation * kAlignedTranslation) +
         xi.tail<3>().squaredNorm() / (kAlignedRotation * kAlignedRotation);
}

double log_odds(double p) {
  const double clamped = std::clamp(p, 0.01, 0.99);
  return std::log(clamped / (1.0 - clamped));
}

}  // namespace

void Tracker::Predictions::resize(std::size_t n) {
  ids.assign(n, kNoId);
  positions.resize(n);
  weights.assign(n, 1.0F);
  pixels.resize(n);
  radii.assign(n, 0.0F);
  octaves.resize(n);
  min_octaves.resize(n);
  max_octaves.resize(n);
}

void Tracker::MotionProblem::clear() {
  world.clear();
  pixels.clear();
  depths.clear();
  scales.clear();
  weights.clear();
  ages.clear();
}

void Tracker::MotionProblem::add(const Eigen::Vector3d& point, cv::Point2f pixel, float depth,
                                 float scale, float weight, float age) {
  world.push_back(point);
  pixels.push_back(pixel);
  depths.push_back(depth);
  scales.push_back(scale);
  weights.push_back(weight);
  ages.push_back(age);
}

geometry::PoseProblem Tracker::MotionProblem::problem() const {
  return {world, pixels, depths, scales, weights, ages};
}

Tracker::Tracker(const DepthCamera& camera, const SystemOptions& options,
                 const std::vector<float>& scale_factors)
    : camera_(camera),
      options_(options.tracking),
      weighted_(options.weights != factors::WeightMode::kFixed || options.geometry),
      geometry_(options.geometry),
      reject_matches_(options.reject_matches),
      learns_(!options.localize_only),
      metric_(options.sensor != Sensor::kMono),
      scale_factors_(scale_factors),
      pose_(camera, scale_factors, options.weights),
      looks_(camera, scale_factors) {}

float Tracker::initial_weight(float remembered, float geometric) const {
  if (!weighted_) return 1.0F;
  const factors::DetectorVote votes[] = {{1.0, 0.5}, {geometric, 0.5}};
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
    if (last.rejected[i] != 0 && !geometry_) continue;
    const cv::KeyPoint& keypoint = features.keypoints[i];
    if (const MapPoint* point = map.find_point(last.points[i])) {
      predictions_.ids[i] = last.points[i];
      predictions_.positions[i] = point->position;
      predictions_.weights[i] = point->static_weight;
    } else if (features.depths[i] > 0.0F) {
      predictions_.positions[i] =
          T_world_last * camera_.unproject({keypoint.pt.x, keypoint.pt.y}, features.depths[i]);
      if (geometry_)
        predictions_.weights[i] = std::isnan(last.staticness[i]) ? 0.5F : last.staticness[i];
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

int Tracker::optimize(TrackedFrame& frame, const std::vector<PointId>& ids,
                      const std::optional<factors::PosePrior>& prior) {
  const ScopedTimer timer(times_.optimize);
  const factors::PoseResult result =
      pose_.solve(matches_, *frame.features, frame.T_cam_world, prior ? &*prior : nullptr);
  covariance_ = result.covariance;
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

void Tracker::keep_background(const Map& map, const TrackedFrame& last,
                              const geometry::DepthCheck& depth_check, TrackedFrame& frame) {
  motions_.clear();
  measure_distance(frame.T_cam_world);
  for (const PointMatch& match : matches_) {
    const cv::KeyPoint& keypoint = frame.features->keypoints[match.feature];
    const MapPoint* point = map.find_point(predictions_.ids[match.source]);
    motions_.add(
        match.position, keypoint.pt, frame.features->depths[match.feature],
        scale_factors_[static_cast<std::size_t>(keypoint.octave)],
        worth(predictions_.weights[match.source], match.position, frame.T_cam_world),
        point == nullptr ? 0.0F : static_cast<float>(map.keyframes_made() - point->born_keyframe));
  }
  const RigidTransform predicted = (predicted_ * last.T_cam_world).normalized();
  const geometry::PosePrior prior{predicted, kGuessRotation, kGuessTranslation};
  geometry::estimate_pose(camera_, motions_.problem(), &prior, depth_check, {}, motions_.workspace,
                          motions_.result);
  if (!motions_.result.ok()) return;
  const RigidTransform& aligned = frame.T_cam_world;
  const RigidTransform& matched = motions_.result.T_cam_world;
  if (prior_ && distance(matched, aligned) > kContradiction) {
    // Either may have followed a mover. The camera goes on more steadily than that.
    if (distance(aligned, predicted) <= distance(matched, predicted)) return;
    prior_.reset();
  }
  frame.T_cam_world = motions_.result.T_cam_world;
  std::size_t kept = 0;
  for (std::size_t i = 0; i < matches_.size(); ++i) {
    if (motions_.result.motion[i] == motions_.result.chosen) matches_[kept++] = matches_[i];
  }
  matches_.resize(kept);
}

void Tracker::reject_matches(const TrackedFrame& last, const TrackedFrame& frame) {
  keep_.resize(found_.size());
  matching::reject(matching::DefaultRule(), found_, last.features->keypoints,
                   frame.features->keypoints, keep_, {}, rejection_);
  matching::erase_rejected(found_, keep_);
}

bool Tracker::match_last_frame(const Map& map, const TrackedFrame& last, double radius,
                               TrackedFrame& frame, const geometry::DepthCheck& depth_check) {
  {
    const ScopedTimer timer(times_.match);
    frame.T_cam_world = expected_pose(last);
    taken_.clear();
    predict_from_last(map, last, radius, frame.T_cam_world);
    match_predictions(last.features->descriptors_view(), 0.9F, frame);
    if (reject_matches_) reject_matches(last, frame);
    matches_.clear();
    for (const Match& match : found_) {
      const auto source = static_cast<std::uint32_t>(match.query);
      const auto feature = static_cast<std::uint32_t>(match.train);
      frame.previous[feature] = match.query;
      if (last.rejected[source] != 0) continue;
      matches_.push_back({source, feature, predictions_.positions[source],
                          initial_weight(predictions_.weights[source], frame.staticness[feature])});
    }
    if (depth_check) keep_background(map, last, depth_check, frame);
  }
  return static_cast<int>(matches_.size()) >= options_.min_inliers &&
         optimize(frame, predictions_.ids, prior_) >= options_.min_inliers;
}

bool Tracker::track_last_frame(const Map& map, const TrackedFrame& last, TrackedFrame& frame,
                               const geometry::DepthCheck& depth_check) {
  if (match_last_frame(map, last, options_.frame_radius, frame, depth_check)) return true;
  return match_last_frame(map, last, 2.0 * options_.frame_radius, frame, depth_check);
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
    predictions_.octaves[i] = sighting->octave;
    predictions_.min_octaves[i] = sighting->octave - 1;
    predictions_.max_octaves[i] = sighting->octave + 1;
  }
}

void Tracker::match_local_map(const Map& map, KeyframeId reference, TrackedFrame& frame,
                              bool wide) {
  const ScopedTimer timer(times_.match);
  local_map_.collect(map, frame.points, reference, options_.local_keyframes);
  taken_ = frame.moving;
  predict_from_map(frame.T_cam_world, options_.map_radius * (wide ? 2.0 : 1.0));
  match_predictions(local_map_.descriptors_view(), 0.8F, frame);
  std::fill(frame.points.begin(), frame.points.end(), kNoId);
  matches_.clear();
  for (const Match& match : found_) {
    const auto source = static_cast<std::uint32_t>(match.query);
    const auto feature = static_cast<std::uint32_t>(match.train);
    matches_.push_back({source, feature, predictions_.positions[source],
                        initial_weight(predictions_.weights[source], frame.staticness[feature])});
  }
}

int Tracker::track_local_map(Map& map, KeyframeId reference, TrackedFrame& frame, bool wide) {
  match_local_map(map, reference, frame, wide);
  if (static_cast<int>(matches_.size()) < options_.min_inliers && !prior_) return 0;
  if (geometry_) prefer_proven(frame.T_cam_world);
  if (wide) motion_.forget_prediction();
  const std::optional<factors::PosePrior> expected = expected_motion();
  int inliers = optimize_as_expected(frame, expected);
  if (inliers >= options_.min_inliers && match_looks(map, frame)) {
    inliers = optimize_as_expected(frame, expected);
  }
  if (inliers >= options_.min_inliers) {
    pose_.learn_noise(frame.T_cam_world);
    remember_motion(frame);
  }
  if (!learns_) return inliers;
  for (const PointId id : predictions_.ids) {
    if (id != kNoId) ++map.point(id).visible;
  }
  for (const PointId id : frame.points) {
    if (id != kNoId) ++map.point(id).found;
  }
  remember_weights(map, frame);
  return inliers;
}

bool Tracker::match_looks(const Map& map, TrackedFrame& frame) {
  const ScopedTimer timer(times_.match);
  const bool aligned = looks_.align(map, matches_, predictions_.ids, frame) > 0;
  if (step_ > kSeekingStep) return aligned;
  taken_.assign(predictions_.ids.size(), 0);
  for (const PointMatch& match : matches_) taken_[match.source] = 1;
  sought_.clear();
  for (std::uint32_t i = 0; i < predictions_.ids.size(); ++i) {
    if (predictions_.ids[i] == kNoId || taken_[i] != 0) continue;
    const PointId id = predictions_.ids[i];
    sought_.push_back({i, id, predictions_.octaves[i], map.point(id).observations.size()});
  }
  // What is seen most is known best; what is left out long enough leaves the map.
  std::stable_sort(sought_.begin(), sought_.end(), [](const SoughtPoint& a, const SoughtPoint& b) {
    return a.observations > b.observations;
  });
  const std::size_t most = frame.features->size();  // as many again; more where much is hidden
  const std::vector<PointMatch> found = looks_.seek(map, sought_, most, frame);
  for (PointMatch match : found) {
    match.weight =
        initial_weight(predictions_.weights[match.source], frame.staticness[match.feature]);
    matches_.push_back(match);
  }
  if (geometry_) prefer_proven(frame.T_cam_world);
  return aligned || !found.empty();
}

// What is expected may have followed a mover. It is let go of if it makes outliers of most that the
// features say, and twice as much agrees without it.
int Tracker::optimize_as_expected(TrackedFrame& frame,
                                  const std::optional<factors::PosePrior>& expected) {
  const RigidTransform start = frame.T_cam_world;
  const int inliers = optimize(frame, predictions_.ids, expected);
  if (!geometry_ || !expected) return inliers;
  const double agreed = agreeing_weight();
  double all = 0.0;
  for (const PointMatch& match : matches_) all += match.weight;
  if (kContradicted * agreed >= all) return inliers;
  frame.T_cam_world = start;
  const int alone = optimize(frame, predictions_.ids, std::nullopt);
  if (alone >= options_.min_inliers && agreeing_weight() > kContradicted * agreed) return alone;
  frame.T_cam_world = start;
  return optimize(frame, predictions_.ids, expected);
}

// Of the matches that agree with the pose that was optimized last.
double Tracker::agreeing_weight() const {
  const Span<const std::uint8_t> inliers = pose_.inliers();
  double sum = 0.0;
  for (std::size_t i = 0; i < matches_.size(); ++i) {
    if (inliers[i] != 0) sum += matches_[i].weight;
  }
  return sum;
}

void Tracker::measure_distance(const RigidTransform& T_cam_world) {
  std::vector<double> distances;
  for (const PointMatch& match : matches_) {
    distances.push_back((T_cam_world * match.position).z());
  }
  if (!distances.empty()) middle_distance_ = std::max(kMinDepth, median(distances));
}

// Points on trial must not outvote those that have stood still for long: a weight is how much more
// than chance a point is believed. Among themselves they count by the surface that a feature
// stands for: what moves may fill the image, but only by being near.
float Tracker::worth(float belief, const Eigen::Vector3d& position,
                     const RigidTransform& T_cam_world) const {
  const double distance = (T_cam_world * position).z() / middle_distance_;
  const double surface = std::clamp(distance * distance, kLeastSurface, kMostSurface);
  return std::max(2.0F * belief - 1.0F, kTrialWeight * static_cast<float>(surface));
}

void Tracker::prefer_proven(const RigidTransform& T_cam_world) {
  measure_distance(T_cam_world);
  float greatest = kTrialWeight;
  for (PointMatch& match : matches_) {
    match.weight = worth(predictions_.weights[match.source], match.position, T_cam_world);
    greatest = std::max(greatest, match.weight);
  }
  for (PointMatch& match : matches_) match.weight /= greatest;
}

// A point that agrees frame after frame is believed, one that disagrees soon not.
void Tracker::remember_weights(Map& map, const TrackedFrame& frame) const {
  const Span<const float> weights = pose_.weights();
  const Span<const std::uint8_t> inliers = pose_.inliers();
  const double agrees = kAgrees * std::clamp(step_ / kUsualStep, 1.0, kMostSteps);
  for (std::size_t i = 0; i < matches_.size(); ++i) {
    MapPoint& point = map.point(predictions_.ids[matches_[i].source]);
    if (geometry_) {
      const double seen = frame.staticness[matches_[i].feature];
      const double odds = log_odds(point.static_weight) + (inliers[i] != 0 ? agrees : kDisagrees) +
                          (std::isnan(seen) ? 0.0 : std::clamp(0.3 * log_odds(seen), -0.5, 0.2));
      point.static_weight =
          static_cast<float>(1.0 / (1.0 + std::exp(-std::clamp(odds, -kSurest, kSurest))));
    } else if (weighted_) {
      point.static_weight = weights[i];
    }
  }
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
  return optimize(frame, keyframe.points, prior_) >= kMinPnpInliers;
}

}  // namespace dynslam::slam
