#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <string>
#include <utility>

#include "dynslam/core/checksum.hpp"
#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/slam/map_io.hpp"

#include "map_format.hpp"

namespace dynslam::slam {
namespace {

using namespace map_format;

constexpr double kRotationTolerance = 1e-6;  // largest entry of |R^T R - I|
constexpr std::uint32_t kMaxLevels = 32;     // of a pyramid
constexpr double kGreatest = 1e9;            // metres, pixels: beyond is damage
constexpr double kLatest = 1e12;             // seconds
constexpr std::uint64_t kManyFrames = 1ULL << 40U;

/// Bytes in order, never more than there are, and where in the map they belong.
class Cursor {
 public:
  Cursor(Span<const std::uint8_t> bytes, const std::string& name) : bytes_(bytes), name_(name) {}

  std::string place;  ///< "keyframe 3: "; before what is wrong in messages
  std::size_t left() const { return bytes_.size() - at_; }

  [[noreturn]] void refuse(const std::string& what) const {
    throw_io_error(name_, "no sound map: " + place + what);
  }
  void expect(bool sound, const char* field, const std::string& got, const std::string& rule) {
    if (!sound) refuse(std::string(field) + " is " + got + ", expected " + rule);
  }

  void bytes(void* to, std::size_t size, const char* field) {
    if (size > left()) refuse(std::string("ends before ") + field);
    if (size > 0) std::memcpy(to, bytes_.data() + at_, size);
    at_ += size;
  }
  template <typename T>
  T number(const char* field) {
    T value;
    bytes(&value, sizeof(value), field);
    return value;
  }
  /// A number in [low, high]; never NaN.
  template <typename T>
  T within(const char* field, T low, T high) {
    const T value = number<T>(field);
    if (!(value >= low && value <= high)) {
      refuse(std::string(field) + " is " + std::to_string(value) + ", expected " +
             std::to_string(low) + " .. " + std::to_string(high));
    }
    return value;
  }
  /// How many things of at least `each` bytes follow.
  template <typename T>
  std::size_t count(const char* field, std::size_t each) {
    const T value = number<T>(field);
    expect(value <= left() / each, field, std::to_string(value),
           "at most " + std::to_string(left() / each) + ", for which there are bytes");
    return static_cast<std::size_t>(value);
  }
  Eigen::Vector3d vector(const char* field) {
    Eigen::Vector3d v;
    for (int i = 0; i < 3; ++i) v[i] = within<double>(field, -kGreatest, kGreatest);
    return v;
  }

  /// The next section, its checksum tested.
  Cursor section(Tag tag) {
    const auto head = number<SectionHead>("the head of the section");
    expect(head.tag == static_cast<std::uint32_t>(tag), "tag", std::to_string(head.tag),
           std::to_string(static_cast<std::uint32_t>(tag)));
    expect(head.reserved == 0, "a reserved field", std::to_string(head.reserved), "0");
    expect(head.bytes <= left(), "size", std::to_string(head.bytes),
           "at most " + std::to_string(left()) + ", which are left");
    Cursor inside(bytes_.subspan(at_, static_cast<std::size_t>(head.bytes)), name_);
    inside.place = place;
    if (checksum(inside.bytes_.data(), inside.bytes_.size()) != head.checksum) {
      refuse("the checksum is wrong");
    }
    at_ += inside.bytes_.size();
    return inside;
  }
  void expect_end() {
    if (left() > 0) refuse(std::to_string(left()) + " bytes after its end");
  }

 private:
  Span<const std::uint8_t> bytes_;
  std::size_t at_ = 0;
  const std::string& name_;
};

std::uint64_t read_head(Cursor& file) {
  file.place = "head: ";
  const Head head = file.number<Head>("its end");
  if (std::memcmp(head.magic, kMagic, sizeof(kMagic)) != 0) {
    file.refuse("it does not start with \"dynsMAPf\"");
  }
  if (head.byte_order != kByteOrder) file.refuse("the byte order is another machine's");
  if (head.version != kVersion) {
    file.refuse("version " + std::to_string(head.version) + ", this library reads version " +
                std::to_string(kVersion));
  }
  if (head.checksum != checksum(&head, offsetof(Head, checksum))) {
    file.refuse("the checksum is wrong");
  }
  file.expect(head.keyframes <= file.left() / sizeof(SectionHead), "keyframes",
              std::to_string(head.keyframes),
              "at most " + std::to_string(file.left() / sizeof(SectionHead)));
  return head.keyframes;
}

// Returns how many keyframes were ever made.
std::uint64_t read_camera(Cursor section, StoredMap& stored) {
  DepthCamera& camera = stored.camera;
  camera.fx = section.within<double>("fx", 1e-3, kGreatest);
  camera.fy = section.within<double>("fy", 1e-3, kGreatest);
  camera.cx = section.within<double>("cx", -kGreatest, kGreatest);
  camera.cy = section.within<double>("cy", -kGreatest, kGreatest);
  camera.bf = section.within<double>("bf", 1e-9, kGreatest);
  camera.width = section.within<std::int32_t>("width", 1, 1 << 16);
  camera.height = section.within<std::int32_t>("height", 1, 1 << 16);
  const auto made = section.within<std::uint64_t>("keyframes made", 0, kManyFrames);
  const auto levels = section.within<std::uint32_t>("levels", 1, kMaxLevels);
  for (std::uint32_t i = 0; i < levels; ++i) {
    const float least = i == 0 ? 1.0F : stored.scale_factors.back();
    const float most = i == 0 ? 1.0F : 1e6F;
    stored.scale_factors.push_back(section.within<float>("scale factor", least, most));
  }
  section.expect_end();
  return made;
}

void read_pose(Cursor& section, RigidTransform& T) {
  for (int row = 0; row < 3; ++row) T.R.row(row) = section.vector("rotation").transpose();
  T.t = section.vector("translation");
  const double off = (T.R.transpose() * T.R - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (off > kRotationTolerance || T.R.determinant() < 0.0) section.refuse("rotation is none");
}

// Returns whether it moved.
std::uint8_t read_feature(Cursor& section, const StoredMap& stored, FrameFeatures& features,
                          int row) {
  const auto& camera = stored.camera;
  cv::KeyPoint keypoint;
  keypoint.pt.x = section.within<float>("column", 0.0F, static_cast<float>(camera.width - 1));
  keypoint.pt.y = section.within<float>("row", 0.0F, static_cast<float>(camera.height - 1));
  keypoint.size = section.within<float>("size", 0.0F, 1e6F);
  keypoint.angle = section.within<float>("angle", -1.0F, 360.0F);
  keypoint.response = section.within<float>("response", -1e30F, 1e30F);
  keypoint.octave = section.within<std::int32_t>(
      "octave", 0, static_cast<std::int32_t>(stored.scale_factors.size()) - 1);
  features.keypoints.push_back(keypoint);
  features.depths.push_back(section.within<float>("depth", 0.0F, 1e6F));
  const auto right = section.number<float>("right column");
  section.expect(std::isnan(right) || std::abs(right) < 1e9F, "right column", std::to_string(right),
                 "a finite number or NaN");
  features.right_columns.push_back(right);
  section.bytes(features.colors.emplace_back().val, 3, "colour");
  const auto moving = section.within<std::uint8_t>("moving", 0, 1);
  section.bytes(features.descriptors.ptr(row), kDescriptorBytes, "descriptor");
  return moving;
}

void read_keyframe(Cursor section, StoredMap& stored) {
  Keyframe keyframe;
  keyframe.number =
      section.within<std::uint64_t>("number", stored.map.keyframes_made(), kManyFrames);
  keyframe.frame_index = section.within<std::uint64_t>("frame", 0, kManyFrames);
  keyframe.timestamp = section.within<double>("timestamp", -kLatest, kLatest);
  read_pose(section, keyframe.T_cam_world);
  auto features = std::make_shared<FrameFeatures>();
  features->masked_share = section.within<float>("masked share", 0.0F, 1.0F);
  const std::size_t n = section.count<std::uint32_t>("features", kFeatureBytes);
  features->descriptors.create(static_cast<int>(n), kDescriptorBytes, CV_8UC1);
  features->keypoints.reserve(n);
  const std::string place = section.place;
  for (std::size_t i = 0; i < n; ++i) {
    section.place = place + "feature " + std::to_string(i) + ": ";
    keyframe.moving.push_back(read_feature(section, stored, *features, static_cast<int>(i)));
  }
  section.place = place;
  section.expect_end();
  features->grid.build(field(features->keypoints, &cv::KeyPoint::pt), stored.camera.width,
                       stored.camera.height);
  keyframe.features = std::move(features);
  stored.map.restore_keyframe(std::move(keyframe));
}

MapPoint read_point_fields(Cursor& section, std::uint64_t made) {
  MapPoint point;
  point.position = section.vector("position");
  for (int i = 0; i < 3; ++i) point.normal[i] = section.within<float>("normal", -1.001F, 1.001F);
  point.min_distance = section.within<float>("least distance", 0.0F, 1e9F);
  point.max_distance = section.within<float>("greatest distance", point.min_distance, 1e9F);
  point.static_weight = section.within<float>("static weight", 0.0F, 1.0F);
  point.visible = section.number<std::uint32_t>("visible");
  point.found = section.number<std::uint32_t>("found");
  point.born_keyframe = section.within<std::uint64_t>("first keyframe", 0, made);
  section.bytes(point.color.val, 3, "colour");
  section.bytes(point.descriptor.data(), point.descriptor.size(), "descriptor");
  return point;
}

void read_point(Cursor& section, const std::vector<KeyframeId>& keyframes, Map& map) {
  const PointId id = map.restore_point(read_point_fields(section, map.keyframes_made()));
  const std::size_t n = section.count<std::uint32_t>("observations", kObservationBytes);
  section.expect(n > 0, "observations", "0", "at least 1");
  for (std::size_t i = 0; i < n; ++i) {
    const auto keyframe = section.number<std::uint32_t>("keyframe");
    section.expect(keyframe < keyframes.size(), "keyframe", std::to_string(keyframe),
                   "below " + std::to_string(keyframes.size()));
    const auto feature = section.number<std::uint32_t>("feature");
    const std::size_t features = map.keyframe(keyframes[keyframe]).points.size();
    section.expect(feature < features, "feature", std::to_string(feature),
                   "below " + std::to_string(features));
    if (!map.add_observation(id, {keyframes[keyframe], feature})) {
      section.refuse("feature " + std::to_string(feature) + " of keyframe " +
                     std::to_string(keyframe) + " is taken, or the keyframe sees the point twice");
    }
  }
}

void read_points(Cursor section, Map& map) {
  const std::vector<KeyframeId> keyframes = map.keyframe_ids();
  const std::size_t n = section.count<std::uint64_t>("points", kPointBytes + kObservationBytes);
  for (std::size_t i = 0; i < n; ++i) {
    section.place = "point " + std::to_string(i) + ": ";
    read_point(section, keyframes, map);
  }
  section.place = "points: ";
  section.expect_end();
}

}  // namespace

StoredMap parse_map(Span<const std::uint8_t> bytes, const std::string& name) {
  StoredMap stored;
  Cursor file(bytes, name);
  const std::uint64_t keyframes = read_head(file);
  file.place = "camera: ";
  const std::uint64_t made = read_camera(file.section(Tag::kCamera), stored);
  for (std::uint64_t i = 0; i < keyframes; ++i) {
    file.place = "keyframe " + std::to_string(i) + ": ";
    read_keyframe(file.section(Tag::kKeyframe), stored);
  }
  file.place = "camera: ";
  file.expect(made >= stored.map.keyframes_made(), "keyframes made", std::to_string(made),
              "at least " + std::to_string(stored.map.keyframes_made()));
  stored.map.restore_keyframes_made(static_cast<std::size_t>(made));
  file.place = "points: ";
  read_points(file.section(Tag::kPoints), stored.map);
  file.place = "";
  file.expect_end();
  return stored;
}

StoredMap load_map(const std::string& path) {
  const std::string bytes = read_file(path);
  return parse_map({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}, path);
}

}  // namespace dynslam::slam
