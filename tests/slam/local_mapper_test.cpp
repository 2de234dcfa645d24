#include "slam/local_mapper.hpp"

#include <memory>
#include <random>

#include <gtest/gtest.h>

#include "dynslam/core/opencv.hpp"

#include "map_check.hpp"
#include "synthetic_map.hpp"

namespace dynslam::slam {
namespace {

class LocalMapperTest : public ::testing::Test {
 protected:
  KeyframeId look(double degrees) {
    const KeyframeId id = world.look(degrees, SyntheticMap::true_pose(degrees));
    world.shared.log.reference = id;
    return id;
  }
  void refine(KeyframeId id) {
    mapper.refine(id, false, stop);
    EXPECT_EQ(testing::problem_of(map), "");
  }

  SyntheticMap world;
  Map& map = world.shared.map;
  std::atomic<bool> stop{false};
  LocalMapper mapper{world.camera, SystemOptions(), unit_scales(), world.shared};
};

TEST_F(LocalMapperTest, MakesNoSecondPointWhereOneWasFoundByItsLook) {
  const DepthCamera& camera = world.camera;
  const auto known_at = cv::Point2f(100.0F, 100.0F);
  MapPoint known;
  known.position = camera.unproject({100.0, 100.0}, 2.0);
  const PointId id = map.add_point(std::move(known));
  auto features = std::make_shared<FrameFeatures>();
  enum : std::size_t { kBeside, kCoarse, kAlone, kFound, kRejected, kAll };
  features->keypoints = {{known_at + cv::Point2f(2.0F, 0.0F), 31.0F, 0.0F, 1.0F, 0},
                         {known_at, 31.0F, 0.0F, 1.0F, 2},
                         {known_at + cv::Point2f(20.0F, 0.0F), 31.0F, 0.0F, 1.0F, 0},
                         {known_at, 31.0F, -1.0F, 0.0F, 0},
                         {known_at + cv::Point2f(50.0F, 0.0F), 31.0F, -1.0F, 0.0F, 0}};
  features->sought = 2;
  features->descriptors = cv::Mat::zeros(kAll, 32, CV_8U);
  features->depths.assign(kAll, 2.0F);
  features->right_columns.assign(kAll, 50.0F);
  features->colors.resize(kAll);
  features->grid.build(field(features->keypoints, &cv::KeyPoint::pt), camera.width, camera.height);
  TrackedFrame frame;
  frame.reset(features, 0.0);
  frame.points[kFound] = id;
  const Keyframe& keyframe = map.keyframe(mapper.insert(frame, 0));
  EXPECT_EQ(keyframe.points[kBeside], kNoId);
  EXPECT_NE(keyframe.points[kCoarse], kNoId) << "looks at more than that point";
  EXPECT_NE(keyframe.points[kAlone], kNoId);
  EXPECT_EQ(keyframe.points[kFound], id);
  EXPECT_EQ(keyframe.points[kRejected], kNoId) << "it is no corner";
  EXPECT_EQ(map.point(id).observations.size(), 1U);
}

TEST_F(LocalMapperTest, DropsAKeyframeThatHasLostItsPoints) {
  const KeyframeId first = look(0.0), second = look(90.0);
  for (const double degrees : {180.0, 270.0, 45.0}) look(degrees);
  const std::vector<PointId> points = map.keyframe(second).points;
  for (std::size_t i = 0; i + 5 < points.size(); ++i) map.erase_point(points[i]);
  refine(look(0.0));
  EXPECT_EQ(map.find_keyframe(second), nullptr);
  EXPECT_NE(map.find_keyframe(first), nullptr);
}

TEST_F(LocalMapperTest, DropsAPointOfFewObservationsThatIsNotFoundAnyMore) {
  const KeyframeId first = look(0.0);
  look(2.0);
  std::vector<PointId> points;
  for (const PointId id : map.keyframe(first).points) {
    if (map.point(id).observations.size() == 2) points.push_back(id);
  }
  const PointId gone = points.at(0), found = points.at(1), proven = points.at(2);
  for (const PointId id : {gone, found, proven}) map.point(id).visible = 100;
  map.point(found).found = 50;
  world.memory = 0;  // nothing is found again by itself
  const KeyframeId third = look(30.0);
  std::uint32_t free = 0;
  while (map.keyframe(third).points[free] != kNoId)
    map.erase_point(map.keyframe(third).points[free]);
  ASSERT_TRUE(map.add_observation(proven, {third, free}));
  refine(third);
  EXPECT_EQ(map.find_point(gone), nullptr);
  EXPECT_NE(map.find_point(found), nullptr);
  EXPECT_NE(map.find_point(proven), nullptr);
}

// Keyframes from one place, of which each sees 20 points of all and 40 of its own.
class Crowd {
 public:
  explicit Crowd(Map& map) : map_(map) {}

  KeyframeId add() {
    auto features = std::make_shared<FrameFeatures>();
    features->descriptors = cv::Mat(kFeatures, 32, CV_8U);
    for (int i = 0; i < kFeatures; ++i) {
      const auto u = static_cast<float>(random_() % 640), v = static_cast<float>(random_() % 480);
      features->keypoints.emplace_back(cv::Point2f(u, v), 31.0F);
      features->keypoints.back().octave = 0;
      for (int b = 0; b < 32; ++b) {
        features->descriptors.at<std::uint8_t>(i, b) = static_cast<std::uint8_t>(random_() & 255U);
      }
    }
    features->depths.assign(kFeatures, 2.0F);
    features->right_columns.assign(kFeatures, 0.0F);
    features->colors.resize(kFeatures);
    features->grid.build(field(features->keypoints, &cv::KeyPoint::pt), 640, 480);
    Keyframe keyframe;
    keyframe.features = features;
    const KeyframeId id = map_.add_keyframe(std::move(keyframe));
    for (std::uint32_t i = 0; i < kFeatures; ++i) {
      if (i >= kShared || common_.size() < kShared) {
        MapPoint point;
        point.position = {0.01 * i, 0.0, 2.0};
        const PointId made = map_.add_point(point);
        if (i < kShared) common_.push_back(made);
        map_.add_observation(made, {id, i});
      } else {
        map_.add_observation(common_[i], {id, i});
      }
    }
    return id;
  }

 private:
  static constexpr int kFeatures = 60;
  static constexpr std::size_t kShared = 20;
  Map& map_;
  std::vector<PointId> common_;
  std::mt19937_64 random_{3};
};

TEST_F(LocalMapperTest, KeepsNoMoreThanAHundredKeyframesOfOnePlace) {
  Crowd crowd(map);
  KeyframeId newest = kNoId;
  for (int i = 0; i < 130; ++i) newest = crowd.add();
  world.shared.log.reference = newest;
  refine(newest);
  EXPECT_EQ(map.keyframe_count(), 101U);  // the newest, and a hundred that see the same
  EXPECT_NE(map.find_keyframe(newest), nullptr);
}

}  // namespace
}  // namespace dynslam::slam
