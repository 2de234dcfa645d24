// The part of the map that a frame may see, copied into arrays.
//
// A copy, so that the tracker holds nothing of the map while it matches: the mapper may change the
// map meanwhile. Points are a structure of arrays because that is how they are walked.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>

#include "dynslam/core/image_view.hpp"
#include "dynslam/slam/map.hpp"

namespace dynslam::slam {

constexpr int kPlaceKeyframes = 10;  ///< keyframes whose points make a place

struct LocalMap {
  std::vector<PointId> ids;
  std::vector<Eigen::Vector3d> positions;
  std::vector<Eigen::Vector3f> normals;
  std::vector<float> min_distances, max_distances, weights;
  std::vector<std::uint8_t> descriptors;  ///< 32 bytes a point
  std::vector<KeyframeId> keyframes;
  KeyframeId reference = kNoId;  ///< the keyframe that shares most points with the frame

  std::size_t size() const { return ids.size(); }
  DescriptorsView descriptors_view() const {
    return {descriptors.data(), 32, static_cast<int>(size())};
  }

  /// Replaces the content by the points of the keyframes that share points with a frame, given its
  /// `points` by feature (kNoId allowed), filled up with their covisible keyframes to `count`.
  /// `fallback` is used when the frame shows no point at all.
  void collect(const Map& map, const std::vector<PointId>& points, KeyframeId fallback, int count);
};

}  // namespace dynslam::slam
