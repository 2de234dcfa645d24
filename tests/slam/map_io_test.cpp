#include "dynslam/slam/map_io.hpp"

#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "dynslam/core/checksum.hpp"
#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"
#include "dynslam/core/opencv.hpp"

#include "slam/map_check.hpp"
#include "slam/small_map.hpp"
#include "temp_folder.hpp"

namespace dynslam::slam {
namespace {

namespace fs = std::filesystem;
using testing::problem_of;
using testing::small_camera;
using testing::small_map;
using testing::small_scales;

std::string small_bytes() { return serialize_map(small_map(), small_camera(), small_scales()); }

StoredMap parse(const std::string& bytes) {
  return parse_map({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}, "a.map");
}

std::string error_of(const std::string& bytes) {
  try {
    parse(bytes);
  } catch (const IoError& error) {
    return error.what();
  }
  return "no error";
}

template <typename T>
T get(const std::string& bytes, std::size_t at) {
  T value;
  std::memcpy(&value, bytes.data() + at, sizeof(T));
  return value;
}

template <typename T>
void put(std::string& bytes, std::size_t at, T value) {
  std::memcpy(bytes.data() + at, &value, sizeof(T));
}

// Where the contents of the sections begin, as far as the sizes lead.
std::vector<std::size_t> sections_of(const std::string& bytes) {
  std::vector<std::size_t> starts;
  for (std::size_t at = 32; at + 24 <= bytes.size();) {
    starts.push_back(at + 24);
    const auto size = get<std::uint64_t>(bytes, at + 8);
    if (size > bytes.size() - at - 24) break;
    at += 24 + static_cast<std::size_t>(size);
  }
  return starts;
}

// Makes the checksums right again, so that what is behind them is looked at.
void seal(std::string& bytes) {
  put(bytes, 24, checksum(bytes.data(), 24));
  for (const std::size_t start : sections_of(bytes)) {
    const auto size = get<std::uint64_t>(bytes, start - 16);
    if (size <= bytes.size() - start) put(bytes, start - 8, checksum(bytes.data() + start, size));
  }
}

void expect_equal(const FrameFeatures& a, const FrameFeatures& b) {
  ASSERT_EQ(a.size(), b.size());
  EXPECT_EQ(a.masked_share, b.masked_share);
  EXPECT_EQ(a.depths, b.depths);
  EXPECT_EQ(a.colors, b.colors);
  EXPECT_EQ(cv::norm(a.descriptors, b.descriptors, cv::NORM_L1), 0.0);
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a.keypoints[i].pt, b.keypoints[i].pt);
    EXPECT_EQ(a.keypoints[i].size, b.keypoints[i].size);
    EXPECT_EQ(a.keypoints[i].angle, b.keypoints[i].angle);
    EXPECT_EQ(a.keypoints[i].response, b.keypoints[i].response);
    EXPECT_EQ(a.keypoints[i].octave, b.keypoints[i].octave);
    if (std::isnan(a.right_columns[i])) {
      EXPECT_TRUE(std::isnan(b.right_columns[i]));
    } else {
      EXPECT_EQ(a.right_columns[i], b.right_columns[i]);
    }
    std::vector<std::int32_t> found;
    b.grid.find(b.keypoints[i].pt, 0.5F, found);
    EXPECT_NE(std::find(found.begin(), found.end(), static_cast<std::int32_t>(i)), found.end());
  }
}

void expect_equal(const MapPoint& a, const MapPoint& b) {
  EXPECT_EQ(a.position, b.position);
  EXPECT_EQ(a.normal, b.normal);
  EXPECT_EQ(a.min_distance, b.min_distance);
  EXPECT_EQ(a.max_distance, b.max_distance);
  EXPECT_EQ(a.static_weight, b.static_weight);
  EXPECT_EQ(a.visible, b.visible);
  EXPECT_EQ(a.found, b.found);
  EXPECT_EQ(a.born_keyframe, b.born_keyframe);
  EXPECT_EQ(a.color, b.color);
  EXPECT_EQ(a.descriptor, b.descriptor);
  ASSERT_EQ(a.observations.size(), b.observations.size());
  for (std::size_t i = 0; i < a.observations.size(); ++i) {
    EXPECT_EQ(a.observations[i].feature, b.observations[i].feature);
  }
}

TEST(MapFile, AMapComesBackBitForBit) {
  const Map map = small_map();
  const StoredMap back = parse(small_bytes());
  EXPECT_EQ(problem_of(back.map), "");
  EXPECT_EQ(back.camera.fx, small_camera().fx);
  EXPECT_EQ(back.camera.bf, small_camera().bf);
  EXPECT_EQ(back.camera.height, small_camera().height);
  EXPECT_EQ(back.scale_factors, small_scales());
  EXPECT_EQ(back.map.keyframes_made(), map.keyframes_made());
  const auto ids = map.keyframe_ids(), their = back.map.keyframe_ids();
  ASSERT_EQ(ids.size(), their.size());
  for (std::size_t i = 0; i < ids.size(); ++i) {
    const Keyframe &a = map.keyframe(ids[i]), &b = back.map.keyframe(their[i]);
    EXPECT_EQ(a.number, b.number);
    EXPECT_EQ(a.frame_index, b.frame_index);
    EXPECT_EQ(a.timestamp, b.timestamp);
    EXPECT_EQ(a.T_cam_world.R, b.T_cam_world.R);
    EXPECT_EQ(a.T_cam_world.t, b.T_cam_world.t);
    EXPECT_EQ(a.covisible.size(), b.covisible.size());
    EXPECT_EQ(a.moving, b.moving);
    expect_equal(*a.features, *b.features);
  }
  const auto points = map.point_ids(), back_points = back.map.point_ids();
  ASSERT_EQ(points.size(), back_points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    expect_equal(map.point(points[i]), back.map.point(back_points[i]));
  }
  EXPECT_EQ(serialize_map(back.map, back.camera, back.scale_factors), small_bytes());
}

TEST(MapFile, AnEmptyMapIsAMap) {
  const StoredMap back = parse(serialize_map(Map(), small_camera(), small_scales()));
  EXPECT_EQ(back.map.keyframe_count(), 0U);
  EXPECT_EQ(back.map.point_count(), 0U);
}

TEST(MapFile, APointThatNobodySeesIsLeftOut) {
  Map map = small_map();
  const std::size_t before = map.point_count();
  map.add_point({});
  EXPECT_EQ(parse(serialize_map(map, small_camera(), small_scales())).map.point_count(), before);
}

TEST(MapFile, NewKeyframesAreNumberedAfterThoseThatWere) {
  StoredMap back = parse(small_bytes());
  const std::size_t made = back.map.keyframes_made();
  Keyframe keyframe;
  keyframe.features = std::make_shared<FrameFeatures>();
  EXPECT_EQ(back.map.keyframe(back.map.add_keyframe(std::move(keyframe))).number, made);
}

TEST(MapFile, RefusesWhatCannotBeWritten) {
  EXPECT_THROW(serialize_map(small_map(), DepthCamera(), small_scales()), InvalidArgument);
  EXPECT_THROW(serialize_map(small_map(), small_camera(), std::vector<float>{1.0F}),
               InvalidArgument);
}

struct Damage {
  std::size_t section, offset;  // of the field in the section's content
  std::string bytes;            // put there
  const char* message;
};

template <typename T>
std::string raw(T value) {
  return std::string(reinterpret_cast<const char*>(&value), sizeof(T));
}

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr float kNanF = std::numeric_limits<float>::quiet_NaN();
constexpr std::size_t kFirstFeature = 128, kFirstPoint = 8;

TEST(MapFile, EveryFieldIsCheckedBeforeItIsUsed) {
  const std::string good = small_bytes();
  ASSERT_EQ(sections_of(good).size(), 5U) << "camera, three keyframes, points";
  const Damage damages[] = {
      {0, 0, raw(0.0), "camera: fx is 0.0"},
      {0, 8, raw(-1.0), "camera: fy is -1"},
      {0, 16, raw(kNan), "camera: cx is nan"},
      {0, 24, raw(1e300), "camera: cy is"},
      {0, 32, raw(0.0), "camera: bf is 0.0"},
      {0, 40, raw(0), "camera: width is 0"},
      {0, 44, raw(-5), "camera: height is -5"},
      {0, 48, raw<std::uint64_t>(2), "camera: keyframes made is 2"},
      {0, 56, raw<std::uint32_t>(0), "camera: levels is 0"},
      {0, 56, raw<std::uint32_t>(9), "camera: ends before scale factor"},
      {0, 60, raw(1.5F), "camera: scale factor is 1.5"},
      {0, 64, raw(0.5F), "camera: scale factor is 0.5"},
      {2, 0, raw<std::uint64_t>(0), "keyframe 1: number is 0"},
      {1, 8, raw(~std::uint64_t{0}), "keyframe 0: frame is"},
      {1, 16, raw(kNan), "keyframe 0: timestamp is nan"},
      {1, 24, raw(2.0), "keyframe 0: rotation is none"},
      {1, 32, raw(kNan), "keyframe 0: rotation is nan"},
      {1, 96, raw(1e30), "keyframe 0: translation is"},
      {1, 120, raw(1.5F), "keyframe 0: masked share is 1.5"},
      {1, 124, raw(~std::uint32_t{0}), "keyframe 0: features is 4294967295"},
      {1, 124, raw<std::uint32_t>(3), "keyframe 0: 68 bytes after its end"},
      {3, kFirstFeature + 0, raw(-1.0F), "keyframe 2: feature 0: column is -1"},
      {3, kFirstFeature + 68 + 4, raw(240.0F), "keyframe 2: feature 1: row is 240"},
      {3, kFirstFeature + 8, raw(kNanF), "feature 0: size is nan"},
      {3, kFirstFeature + 12, raw(361.0F), "feature 0: angle is 361"},
      {3, kFirstFeature + 16, raw(kNanF), "feature 0: response is nan"},
      {3, kFirstFeature + 20, raw(4), "feature 0: octave is 4, expected 0 .. 3"},
      {3, kFirstFeature + 20, raw(-1), "feature 0: octave is -1"},
      {3, kFirstFeature + 24, raw(-1.0F), "feature 0: depth is -1"},
      {3, kFirstFeature + 28, raw(std::numeric_limits<float>::infinity()),
       "feature 0: right column is inf"},
      {3, kFirstFeature + 35, raw(std::uint8_t{2}), "feature 0: moving is 2"},
      {4, 0, raw(std::uint64_t{1} << 60U), "points: points is"},
      {4, 0, raw<std::uint64_t>(1), "bytes after its end"},
      {4, kFirstPoint + 8, raw(kNan), "point 0: position is nan"},
      {4, kFirstPoint + 24, raw(7.0F), "point 0: normal is 7"},
      {4, kFirstPoint + 36, raw(-1.0F), "point 0: least distance is -1"},
      {4, kFirstPoint + 40, raw(0.0F), "point 0: greatest distance is 0"},
      {4, kFirstPoint + 44, raw(1.5F), "point 0: static weight is 1.5"},
      {4, kFirstPoint + 56, raw<std::uint64_t>(99), "point 0: first keyframe is 99"},
      {4, kFirstPoint + 99, raw<std::uint32_t>(0), "point 0: observations is 0"},
      {4, kFirstPoint + 99, raw(~std::uint32_t{0}), "point 0: observations is 4294967295"},
      {4, kFirstPoint + 103, raw<std::uint32_t>(3), "point 0: keyframe is 3, expected below 3"},
      {4, kFirstPoint + 107, raw<std::uint32_t>(4), "point 0: feature is 4, expected below 4"},
      {4, kFirstPoint + 111, raw<std::uint32_t>(1), "point 0: feature 0 of keyframe 1 is taken"},
  };
  for (const Damage& damage : damages) {
    std::string bad = good;
    const std::size_t at = sections_of(good)[damage.section] + damage.offset;
    bad.replace(at, damage.bytes.size(), damage.bytes);
    seal(bad);
    const std::string error = error_of(bad);
    EXPECT_NE(error.find(damage.message), std::string::npos)
        << "section " << damage.section << ", byte " << damage.offset << ": " << error;
    EXPECT_EQ(error.rfind("a.map: no sound map: ", 0), 0U) << error;
  }
}

TEST(MapFile, TheHeadIsChecked) {
  const auto changed = [](std::size_t at, const std::string& bytes, bool sealed = true) {
    std::string bad = small_bytes();
    bad.replace(at, bytes.size(), bytes);
    if (sealed) seal(bad);
    return error_of(bad);
  };
  const auto says = [](const std::string& error, const char* what) {
    EXPECT_NE(error.find(what), std::string::npos) << error;
  };
  says(changed(0, "?"), "does not start with");
  says(changed(8, raw<std::uint32_t>(2)), "version 2, this library reads version 1");
  says(changed(12, raw<std::uint32_t>(0x04030201)), "byte order");
  says(changed(16, raw(~std::uint64_t{0})), "head: keyframes is");
  says(changed(16, raw<std::uint64_t>(2)), "points: tag is 2, expected 3");
  says(changed(16, raw<std::uint64_t>(4)), "keyframe 3: tag is 3, expected 2");
  says(changed(24, "?", false), "head: the checksum is wrong");
  says(changed(32, raw<std::uint32_t>(9)), "camera: tag is 9");
  says(changed(36, raw<std::uint32_t>(9)), "camera: a reserved field is 9");
  says(changed(40, raw(~std::uint64_t{0})), "camera: size is");
  says(changed(60, "?", false), "camera: the checksum is wrong");
  says(error_of(small_bytes() + "?"), "1 bytes after its end");
  says(error_of(""), "head: ends before");
}

TEST(MapFile, NoFileCutShortAndNoFlippedByteIsAccepted) {
  const std::string good = small_bytes();
  for (std::size_t size = 0; size < good.size(); ++size) {
    ASSERT_NE(error_of(good.substr(0, size)), "no error") << size;
  }
  for (std::size_t at = 0; at < good.size(); ++at) {
    std::string bad = good;
    bad[at] = static_cast<char>(bad[at] ^ 0x10);
    ASSERT_NE(error_of(bad), "no error") << at;
  }
}

// The short form of tests/fuzz/map_fuzz.cpp.
TEST(MapFile, RandomDamageIsRefusedOrGivesASoundMap) {
  const std::string good = small_bytes();
  std::mt19937_64 random(1);
  int refused = 0;
  for (int i = 0; i < 20000; ++i) {
    std::string bad = good;
    for (std::uint64_t n = 1 + random() % 4; n > 0; --n) {
      const std::size_t at = random() % bad.size();
      if (random() % 16 == 0)
        bad.erase(at, random() % 8);
      else
        bad[at] = static_cast<char>(random());
    }
    seal(bad);
    try {
      const StoredMap stored = parse(bad);
      ASSERT_EQ(problem_of(stored.map), "");
      ASSERT_EQ(serialize_map(stored.map, stored.camera, stored.scale_factors).size(), bad.size());
    } catch (const IoError&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 5000);
  EXPECT_LT(refused, 20000);
}

// Written by version 1; see data/make_map_seeds.cpp.
TEST(MapFile, AMapOfAnEarlierVersionIsStillRead) {
  const std::string folder = DYNSLAM_TEST_DATA_DIR "/../../fuzz/corpus/map_fuzz/";
  EXPECT_EQ(read_file(folder + "small"), small_bytes());
  EXPECT_EQ(load_map(folder + "small").map.point_count(), 3U);
  EXPECT_EQ(load_map(folder + "empty").map.keyframe_count(), 0U);
}

TEST(MapFile, IsWrittenWholeOrNotAtAll) {
  const dynslam::testing::TempFolder folder;
  const std::string path = folder.file("a.map");
  save_map(path, small_map(), small_camera(), small_scales());
  EXPECT_EQ(read_file(path), small_bytes());
  EXPECT_EQ(load_map(path).map.keyframe_count(), 3U);
  EXPECT_THROW(save_map(path, small_map(), small_camera(), {}), InvalidArgument);
  EXPECT_EQ(read_file(path), small_bytes()) << "the old map is still there";
  EXPECT_THROW(save_map(folder.file("no/a.map"), Map(), small_camera(), small_scales()), IoError);
  if (fs::exists("/dev/full")) {
    EXPECT_THROW(save_map("/dev/full", small_map(), small_camera(), small_scales()), IoError);
  }
  EXPECT_THROW(load_map(folder.file("no.map")), IoError);
  EXPECT_THROW(load_map(folder.path().string()), IoError);
  EXPECT_EQ(folder.entries(), 1U);
}

}  // namespace
}  // namespace dynslam::slam
