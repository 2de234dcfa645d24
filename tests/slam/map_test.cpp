#include "dynslam/slam/map.hpp"

#include <algorithm>
#include <memory>
#include <random>
#include <set>

#include <gtest/gtest.h>

#include "dynslam/slam/slot_map.hpp"

#include "slam/map_check.hpp"

namespace dynslam::slam {
namespace {

using testing::problem_of;

constexpr std::size_t kFeatures = 20;

FrameFeaturesPtr some_features() {
  auto features = std::make_shared<FrameFeatures>();
  features->keypoints.resize(kFeatures);
  for (cv::KeyPoint& keypoint : features->keypoints) keypoint.octave = 0;
  features->descriptors = cv::Mat::zeros(kFeatures, 32, CV_8U);
  for (int i = 0; i < static_cast<int>(kFeatures); ++i) features->descriptors.row(i) = i;
  return features;
}

KeyframeId add_keyframe(Map& map) {
  Keyframe keyframe;
  keyframe.features = some_features();
  return map.add_keyframe(std::move(keyframe));
}

PointId add_point(Map& map) {
  MapPoint point;
  point.position = Eigen::Vector3d(0, 0, 2);
  return map.add_point(point);
}

TEST(SlotMap, NeverGivesAnIdTwice) {
  SlotMap<int> numbers;
  std::set<std::uint64_t> ids;
  for (int i = 0; i < 100; ++i) {
    const std::uint64_t id = numbers.emplace(i);
    EXPECT_TRUE(ids.insert(id).second);
    if (i % 2 == 0) {
      EXPECT_TRUE(numbers.erase(id));
    }
    if (i % 2 == 0) {
      EXPECT_FALSE(numbers.erase(id));
    }
  }
  EXPECT_EQ(numbers.size(), 50U);
}

TEST(SlotMap, FindsNothingUnderTheIdOfAnErasedObject) {
  SlotMap<int> numbers;
  const std::uint64_t first = numbers.emplace(1);
  numbers.erase(first);
  const std::uint64_t second = numbers.emplace(2);
  EXPECT_EQ(numbers.find(first), nullptr);
  EXPECT_EQ(numbers.at(second), 2);
  EXPECT_EQ(numbers.find(kNoId), nullptr);
  EXPECT_EQ(numbers.find(12345), nullptr);
}

TEST(SlotMap, UsesSlotsAgainSoThatMemoryIsThatOfTheLiving) {
  SlotMap<int> numbers;
  const std::uint64_t keep = numbers.emplace(0);
  for (int i = 0; i < 1000; ++i) numbers.erase(numbers.emplace(i));
  EXPECT_LT(slot_of(numbers.emplace(1)), 3U);
  EXPECT_TRUE(numbers.contains(keep));
}

TEST(SlotMap, GivesTheLivingSlotsOfTheirOwn) {
  SlotMap<int> numbers;
  std::vector<std::uint64_t> ids;
  for (int i = 0; i < 10; ++i) ids.push_back(numbers.emplace(i));
  for (std::size_t i = 0; i < ids.size(); i += 3) {
    numbers.erase(ids[i]);
    ids[i] = numbers.emplace(100);
  }
  std::set<std::uint32_t> slots;
  for (const std::uint64_t id : ids) slots.insert(slot_of(id));
  EXPECT_EQ(slots.size(), ids.size());
  EXPECT_EQ(*slots.rbegin(), ids.size() - 1);
}

TEST(Map, ObservationsAreKnownOnBothSides) {
  Map map;
  const KeyframeId keyframe = add_keyframe(map);
  const PointId point = add_point(map);
  EXPECT_TRUE(map.add_observation(point, {keyframe, 3}));
  EXPECT_EQ(map.keyframe(keyframe).points[3], point);
  EXPECT_EQ(problem_of(map), "");
}

TEST(Map, AFeatureShowsOnePointAndAKeyframeSeesAPointOnce) {
  Map map;
  const KeyframeId keyframe = add_keyframe(map);
  const PointId a = add_point(map), b = add_point(map);
  EXPECT_TRUE(map.add_observation(a, {keyframe, 3}));
  EXPECT_FALSE(map.add_observation(b, {keyframe, 3}));
  EXPECT_FALSE(map.add_observation(a, {keyframe, 4}));
  EXPECT_EQ(problem_of(map), "");
}

TEST(Map, APointWithoutObservationsIsGone) {
  Map map;
  const KeyframeId keyframe = add_keyframe(map);
  const PointId point = add_point(map);
  map.add_observation(point, {keyframe, 0});
  map.erase_observation(point, keyframe);
  EXPECT_EQ(map.find_point(point), nullptr);
  EXPECT_EQ(problem_of(map), "");
}

TEST(Map, ErasingAKeyframeTakesWhatOnlyItSaw) {
  Map map;
  const KeyframeId a = add_keyframe(map), b = add_keyframe(map);
  const PointId both = add_point(map), only_a = add_point(map);
  map.add_observation(both, {a, 0});
  map.add_observation(both, {b, 0});
  map.add_observation(only_a, {a, 1});
  map.erase_keyframe(a);
  EXPECT_NE(map.find_point(both), nullptr);
  EXPECT_EQ(map.find_point(only_a), nullptr);
  EXPECT_EQ(map.keyframe_count(), 1U);
  EXPECT_EQ(problem_of(map), "");
}

TEST(Map, MergingKeepsEveryObservationThatDoesNotClash) {
  Map map;
  const KeyframeId a = add_keyframe(map), b = add_keyframe(map), c = add_keyframe(map);
  const PointId from = add_point(map), into = add_point(map);
  map.add_observation(from, {a, 0});
  map.add_observation(from, {b, 0});
  map.add_observation(into, {b, 1});
  map.add_observation(into, {c, 0});
  map.merge_points(from, into);
  EXPECT_EQ(map.find_point(from), nullptr);
  EXPECT_EQ(map.point(into).observations.size(), 3U);
  EXPECT_EQ(map.keyframe(b).points[0], kNoId);
  EXPECT_EQ(map.point(into).found, 2U);
  EXPECT_EQ(problem_of(map), "");
}

TEST(Map, CovisibleKeyframesComeMostSharedFirst) {
  Map map;
  const KeyframeId a = add_keyframe(map), b = add_keyframe(map), c = add_keyframe(map);
  for (std::uint32_t i = 0; i < 5; ++i) {
    const PointId point = add_point(map);
    map.add_observation(point, {a, i});
    if (i < 2) map.add_observation(point, {b, i});
    if (i < 4) map.add_observation(point, {c, i});
  }
  EXPECT_EQ(map.covisible_keyframes(a, 9), (std::vector<KeyframeId>{c, b}));
  EXPECT_EQ(map.covisible_keyframes(a, 1), (std::vector<KeyframeId>{c}));
  EXPECT_EQ(map.covisible_keyframes(a, 9, 3), (std::vector<KeyframeId>{c}));
}

TEST(Map, StaysConsistentUnderAnyOrderOfChanges) {
  std::mt19937 random(7);
  Map map;
  const auto pick = [&](const std::vector<std::uint64_t>& ids) {
    return ids[random() % ids.size()];
  };
  for (int step = 0; step < 3000; ++step) {
    const std::vector<KeyframeId> keyframes = map.keyframe_ids();
    const std::vector<PointId> points = map.point_ids();
    const unsigned what = random() % 20;
    if (what < 2 || keyframes.size() < 3) {
      add_keyframe(map);
    } else if (what < 6 || points.size() < 5) {
      map.add_observation(add_point(map),
                          {pick(keyframes), static_cast<std::uint32_t>(random() % kFeatures)});
    } else if (what < 15) {
      map.add_observation(pick(points),
                          {pick(keyframes), static_cast<std::uint32_t>(random() % kFeatures)});
    } else if (what < 16) {
      map.erase_observation(pick(points), pick(keyframes));
    } else if (what < 17) {
      map.merge_points(pick(points), pick(points));
    } else if (what < 18) {
      map.erase_point(pick(points));
    } else if (keyframes.size() > 8) {
      map.erase_keyframe(pick(keyframes));
    }
  }
  EXPECT_EQ(problem_of(map), "");
}

TEST(Map, RefreshingAPointTakesTheDescriptorNearestToAllOthers) {
  Map map;
  const PointId point = add_point(map);
  // Every byte of row i is i: 3 differs from each other in one bit a byte, the others in two.
  for (const std::uint32_t feature : {2U, 1U, 3U, 7U, 11U}) {
    map.add_observation(point, {add_keyframe(map), feature});
  }
  const std::vector<float> scales{1.0F, 1.2F, 1.44F};
  map.refresh_point(point, scales);
  const MapPoint& fresh = map.point(point);
  EXPECT_EQ(fresh.descriptor[0], 3);
  EXPECT_FLOAT_EQ(fresh.max_distance, 2.0F);
  EXPECT_FLOAT_EQ(fresh.min_distance, 2.0F / 1.44F);
  EXPECT_NEAR(fresh.normal.z(), 1.0F, 1e-6F);
}

TEST(Map, KeyframesAreListedInTheOrderInWhichTheyWereMade) {
  Map map;
  const KeyframeId a = add_keyframe(map), b = add_keyframe(map);
  map.erase_keyframe(a);
  const KeyframeId c = add_keyframe(map);  // takes a's slot
  EXPECT_EQ(map.keyframe_ids(), (std::vector<KeyframeId>{b, c}));
  EXPECT_EQ(map.keyframes_made(), 3U);
}

}  // namespace
}  // namespace dynslam::slam
