#include <cstring>
#include <functional>
#include <string>
#include <string_view>
#include <unordered_map>

#include "dynslam/core/checksum.hpp"
#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"
#include "dynslam/slam/map_io.hpp"

#include "map_format.hpp"

namespace dynslam::slam {
namespace {

using namespace map_format;

using Sink = std::function<void(std::string_view)>;

/// The bytes of one section.
class Section {
 public:
  template <typename T>
  void put(T value) {
    static_assert(std::is_arithmetic_v<T>);
    char bytes[sizeof(T)];
    std::memcpy(bytes, &value, sizeof(T));
    bytes_.append(bytes, sizeof(T));
  }
  void put(const Eigen::Vector3d& v) {
    for (int i = 0; i < 3; ++i) put(v[i]);
  }
  void put(const std::uint8_t* bytes, std::size_t size) {
    bytes_.append(reinterpret_cast<const char*>(bytes), size);
  }
  /// Hands the section on and begins the next.
  void close(Tag tag, const Sink& sink) {
    SectionHead head{static_cast<std::uint32_t>(tag), 0, bytes_.size(),
                     checksum(bytes_.data(), bytes_.size())};
    sink({reinterpret_cast<const char*>(&head), sizeof(head)});
    sink(bytes_);
    bytes_.clear();
  }

 private:
  std::string bytes_;
};

void put_camera(Section& section, const Map& map, const DepthCamera& camera,
                Span<const float> scale_factors) {
  for (const double value : {camera.fx, camera.fy, camera.cx, camera.cy, camera.bf}) {
    section.put(value);
  }
  section.put(std::int32_t{camera.width});
  section.put(std::int32_t{camera.height});
  section.put(std::uint64_t{map.keyframes_made()});
  section.put(static_cast<std::uint32_t>(scale_factors.size()));
  for (const float factor : scale_factors) section.put(factor);
}

void put_feature(Section& section, const Keyframe& keyframe, std::size_t i, std::size_t levels) {
  const FrameFeatures& features = *keyframe.features;
  const cv::KeyPoint& keypoint = features.keypoints[i];
  require(keypoint.octave >= 0 && static_cast<std::size_t>(keypoint.octave) < levels, "save_map",
          "scale_factors", levels, "more than octave " + std::to_string(keypoint.octave));
  section.put(keypoint.pt.x);
  section.put(keypoint.pt.y);
  section.put(keypoint.size);
  section.put(keypoint.angle);
  section.put(keypoint.response);
  section.put(std::int32_t{keypoint.octave});
  section.put(features.depths[i]);
  section.put(features.right_columns[i]);
  section.put(features.colors[i].val, 3);
  section.put(keyframe.moving.empty() ? std::uint8_t{0} : keyframe.moving[i]);
  section.put(features.descriptor(i), kDescriptorBytes);
}

void put_keyframe(Section& section, const Keyframe& keyframe, std::size_t levels) {
  section.put(std::uint64_t{keyframe.number});
  section.put(std::uint64_t{keyframe.frame_index});
  section.put(keyframe.timestamp);
  for (int row = 0; row < 3; ++row) section.put(Eigen::Vector3d(keyframe.T_cam_world.R.row(row)));
  section.put(keyframe.T_cam_world.t);
  const FrameFeatures& features = *keyframe.features;
  section.put(features.masked_share);
  section.put(static_cast<std::uint32_t>(features.size()));
  for (std::size_t i = 0; i < features.size(); ++i) put_feature(section, keyframe, i, levels);
}

void put_point(Section& section, const MapPoint& point,
               const std::unordered_map<KeyframeId, std::uint32_t>& index_of) {
  section.put(point.position);
  for (int i = 0; i < 3; ++i) section.put(point.normal[i]);
  section.put(point.min_distance);
  section.put(point.max_distance);
  section.put(point.static_weight);
  section.put(point.visible);
  section.put(point.found);
  section.put(std::uint64_t{point.born_keyframe});
  section.put(point.color.val, 3);
  section.put(point.descriptor.data(), point.descriptor.size());
  section.put(static_cast<std::uint32_t>(point.observations.size()));
  for (const Observation& observation : point.observations) {
    section.put(index_of.at(observation.keyframe));
    section.put(observation.feature);
  }
}

void put_points(Section& section, const Map& map, const std::vector<KeyframeId>& keyframes) {
  std::unordered_map<KeyframeId, std::uint32_t> index_of;
  for (std::uint32_t i = 0; i < keyframes.size(); ++i) index_of[keyframes[i]] = i;
  std::vector<const MapPoint*> points;
  for (const PointId id : map.point_ids()) {
    if (!map.point(id).observations.empty()) points.push_back(&map.point(id));
  }
  section.put(std::uint64_t{points.size()});
  for (const MapPoint* point : points) put_point(section, *point, index_of);
}

void write(const Map& map, const DepthCamera& camera, Span<const float> scale_factors,
           const Sink& sink) {
  const std::vector<KeyframeId> keyframes = map.keyframe_ids();
  Head head = {};
  std::memcpy(head.magic, kMagic, sizeof(kMagic));
  head.version = kVersion;
  head.byte_order = kByteOrder;
  head.keyframes = keyframes.size();
  head.checksum = checksum(&head, offsetof(Head, checksum));
  sink({reinterpret_cast<const char*>(&head), sizeof(head)});
  Section section;
  put_camera(section, map, camera, scale_factors);
  section.close(Tag::kCamera, sink);
  for (const KeyframeId id : keyframes) {
    put_keyframe(section, map.keyframe(id), scale_factors.size());
    section.close(Tag::kKeyframe, sink);
  }
  put_points(section, map, keyframes);
  section.close(Tag::kPoints, sink);
}

}  // namespace

void save_map(const std::string& path, const Map& map, const DepthCamera& camera,
              Span<const float> scale_factors) {
  camera.validate();
  AtomicFile file(path);
  write(map, camera, scale_factors, [&](std::string_view bytes) { file.write(bytes); });
  file.commit();
}

std::string serialize_map(const Map& map, const DepthCamera& camera,
                          Span<const float> scale_factors) {
  camera.validate();
  std::string all;
  write(map, camera, scale_factors, [&](std::string_view bytes) { all.append(bytes); });
  return all;
}

}  // namespace dynslam::slam
