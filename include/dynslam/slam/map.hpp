// The map: keyframes, points, and who sees whom.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core/types.hpp>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/features/patch_alignment.hpp"
#include "dynslam/slam/frame.hpp"
#include "dynslam/slam/slot_map.hpp"

namespace dynslam::slam {

using KeyframeId = std::uint64_t;
using PointId = std::uint64_t;

/// A frame that the map is built on.
struct Keyframe {
  std::size_t frame_index = 0;  ///< running number of the frame
  std::size_t number = 0;       ///< how many keyframes were made before it
  double timestamp = 0.0;       ///< seconds
  RigidTransform T_cam_world;
  FrameFeaturesPtr features;
  std::vector<PointId> points;          ///< of each feature; kNoId = none
  std::vector<std::uint8_t> moving;     ///< of each feature: 1 = it moved; may be empty
  std::map<KeyframeId, int> covisible;  ///< keyframes that see the same points: how many
};

/// Feature `feature` of keyframe `keyframe`.
struct Observation {
  KeyframeId keyframe = kNoId;
  std::uint32_t feature = 0;
};

/// How a point looks to one keyframe. Frames with depth find it by that to a tenth of a pixel,
/// where corners are found to a third.
struct PointLook {
  features::Patch patch;  ///< of the level on which the feature was found
  float scale = 1.0F;     ///< side of a pixel of that level, level-0 pixels
  Eigen::Matrix3d R_cam_world = Eigen::Matrix3d::Identity();  ///< of the keyframe, when it was made
  Eigen::Vector3d camera_point_world = Eigen::Vector3d::Zero();  ///< from its camera to the point
  Eigen::Vector3d normal_world = Eigen::Vector3d::Zero();  ///< of the surface; zero if not known
};

/// A point of the world.
struct MapPoint {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< world, metres
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();    ///< mean direction from the cameras, unit
  float min_distance = 0.0F;      ///< metres at which the coarsest level would see it
  float max_distance = 0.0F;      ///< metres at which the finest level would see it
  float static_weight = 1.0F;     ///< belief that it stands still, 0..1
  std::uint32_t visible = 1;      ///< frames in which it should have been seen
  std::uint32_t found = 1;        ///< frames in which it was
  std::size_t born_keyframe = 0;  ///< number of keyframes made before it
  cv::Vec3b color;
  std::array<std::uint8_t, 32> descriptor{};   ///< the observation nearest to all others
  std::vector<Observation> observations;       ///< ascending by keyframe id
  std::shared_ptr<const PointLook> look = {};  ///< may be null; is not stored with the map
};

/// Keyframes and points with consistent cross references: a keyframe's `points[i]` is p exactly
/// when p's observations hold (keyframe, i), and covisibility counts follow.
///
/// Ids are never given twice. Not thread-safe; the system guards it.
class Map {
 public:
  KeyframeId add_keyframe(Keyframe keyframe);
  /// Adds a point without observations.
  PointId add_point(MapPoint point);

  /// For maps read back: as the above, but a keyframe keeps its `number`, which must be at least
  /// `keyframes_made`, and a point its `born_keyframe`.
  KeyframeId restore_keyframe(Keyframe keyframe);
  PointId restore_point(MapPoint point);
  void restore_keyframes_made(std::size_t count) { keyframes_made_ = count; }

  /// Says that a keyframe's feature shows a point. A feature that shows another point already, or a
  /// point that the keyframe sees elsewhere, is left as it is and false returned.
  bool add_observation(PointId point, Observation observation);
  /// Takes an observation back; a point left without any is erased.
  void erase_observation(PointId point, KeyframeId keyframe);
  void erase_point(PointId point);
  /// Erases a keyframe; points that only it saw go with it.
  void erase_keyframe(KeyframeId keyframe);
  /// All of `from` becomes `into`; `from` is erased. Observations that clash are dropped.
  void merge_points(PointId from, PointId into);

  Keyframe* find_keyframe(KeyframeId id) { return keyframes_.find(id); }
  const Keyframe* find_keyframe(KeyframeId id) const { return keyframes_.find(id); }
  MapPoint* find_point(PointId id) { return points_.find(id); }
  const MapPoint* find_point(PointId id) const { return points_.find(id); }
  Keyframe& keyframe(KeyframeId id) { return keyframes_.at(id); }
  const Keyframe& keyframe(KeyframeId id) const { return keyframes_.at(id); }
  MapPoint& point(PointId id) { return points_.at(id); }
  const MapPoint& point(PointId id) const { return points_.at(id); }

  std::size_t keyframe_count() const { return keyframes_.size(); }
  std::size_t point_count() const { return points_.size(); }
  /// Keyframes ever made; ages of points are measured in it.
  std::size_t keyframes_made() const { return keyframes_made_; }

  /// Keyframes in the order in which they were made.
  std::vector<KeyframeId> keyframe_ids() const;
  std::vector<PointId> point_ids() const;

  /// The `count` keyframes that share most points with `id`, most first (ties: older first), at
  /// least `min_shared` points.
  std::vector<KeyframeId> covisible_keyframes(KeyframeId id, std::size_t count,
                                              int min_shared = 1) const;

  /// Recomputes normal, distance range and descriptor of a point from its observations.
  /// `scale_factors`: side of level 0 over that of each pyramid level. O(observations^2).
  void refresh_point(PointId id, Span<const float> scale_factors);

  /// Erases everything; the ids stay used.
  void clear();

 private:
  void count_covisibility(const MapPoint& point, KeyframeId keyframe, int change);

  SlotMap<Keyframe> keyframes_;
  SlotMap<MapPoint> points_;
  std::size_t keyframes_made_ = 0;
};

}  // namespace dynslam::slam
