// Carried masks where the older frame could not see everything: on a drawn scene with exact truth.
#include "dynslam/segmentation/mask_propagation.hpp"

#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/opencv.hpp"

#include "segmentation/masks.hpp"

namespace dynslam::segmentation {
namespace {

// Smooth noise that optical flow can follow.
cv::Mat texture(cv::Size size, int seed) {
  cv::Mat coarse(size.height / 4 + 1, size.width / 4 + 1, CV_8UC1);
  cv::RNG(static_cast<std::uint64_t>(seed)).fill(coarse, cv::RNG::UNIFORM, 0, 255);
  cv::Mat fine;
  cv::resize(coarse, fine, size, 0, 0, cv::INTER_CUBIC);
  return fine;
}

// A wall at 3 m with things before it, each with a texture of its own.
struct ThingsBeforeWall {
  cv::Mat image = texture(kSize, 1);
  cv::Mat depth = cv::Mat(kSize, CV_32FC1, cv::Scalar(3.0F));

  void put(cv::Rect box, float z, int seed) {
    const cv::Rect visible = box & cv::Rect(cv::Point(), kSize);
    texture(box.size(), seed)(visible - box.tl()).copyTo(image(visible));
    depth(visible).setTo(z);
  }
  cv::Mat at(float z) const { return depth == z; }
};

Instance instance_of(const cv::Mat& mask) {
  Instance instance;
  instance.score = 0.9F;
  instance.label = 1;
  instance.box = cv::boundingRect(mask);
  instance.mask = mask(instance.box).clone();
  return instance;
}

// The masks of the first scene, carried to the last.
PropagatedSegmentation carry(const std::vector<ThingsBeforeWall>& scenes,
                             const std::vector<cv::Mat>& masks) {
  MaskPropagator propagator;
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    FrameInfo frame;
    frame.index = i;
    frame.timestamp = 0.07 * static_cast<double>(i);
    frame.depth = as_view<const float>(scenes[i].depth);
    propagator.add_frame(scenes[i].image, frame);
  }
  Segmentation found;
  found.width = kSize.width;
  found.height = kSize.height;
  for (const cv::Mat& mask : masks) found.instances.push_back(instance_of(mask));
  EXPECT_TRUE(propagator.set_segmentation(0, found));
  const auto now = propagator.current();
  EXPECT_TRUE(now.has_value());
  return now.value_or(PropagatedSegmentation());
}

TEST(CarriedMask, TakesInWhatABoardUncovered) {
  std::vector<ThingsBeforeWall> scenes(4);
  for (int i = 0; i < 4; ++i) {
    ThingsBeforeWall& scene = scenes[static_cast<std::size_t>(i)];
    scene.put({130, 20, 60, 200}, 2.0F, 2);
    scene.put({130 + 20 * i, 70, 90, 100}, 1.0F, 3);  // moves off to the right
  }
  const auto now = carry(scenes, {scenes[0].at(2.0F)});
  EXPECT_LT(iou(scenes[0].at(2.0F), scenes[3].at(2.0F)), 0.6) << "the old mask would not do";
  EXPECT_GT(iou(whole(now.segmentation), scenes[3].at(2.0F)), 0.95);
}

TEST(CarriedMask, DoesNotTakeWhatComesBefore) {
  std::vector<ThingsBeforeWall> scenes(4);
  for (int i = 0; i < 4; ++i) {
    ThingsBeforeWall& scene = scenes[static_cast<std::size_t>(i)];
    scene.put({130, 20, 60, 200}, 2.0F, 2);
    scene.put({40 + 8 * i, 70, 90, 100}, 1.93F, 3);  // at nearly the same depth
  }
  const auto now = carry(scenes, {scenes[0].at(2.0F)});
  EXPECT_GT(iou(whole(now.segmentation), scenes[3].at(2.0F)), 0.9);
}

TEST(CarriedMask, CountsWhatStepsOutFromBehindAnInstance) {
  std::vector<ThingsBeforeWall> scenes(4);
  for (int i = 0; i < 4; ++i) {
    ThingsBeforeWall& scene = scenes[static_cast<std::size_t>(i)];
    scene.put({110, 60, 50, 180}, 2.2F, 4);           // stands still
    scene.put({100 - 20 * i, 20, 80, 220}, 1.5F, 2);  // walks off
  }
  ASSERT_EQ(cv::countNonZero(scenes[0].at(2.2F)), 0) << "hidden at first";
  const auto now = carry(scenes, {scenes[0].at(1.5F)});
  const cv::Mat truth = scenes[3].at(1.5F) | scenes[3].at(2.2F);
  EXPECT_GT(iou(whole(now.segmentation), truth), 0.9);
  ASSERT_EQ(now.segmentation.instances.size(), 2U);
  EXPECT_EQ(now.segmentation.instances[1].label, 0) << "nobody knows who it is";
  EXPECT_LT(now.confidence[1], now.confidence[0]);
}

TEST(CarriedMask, DoesNotCountTheWallThatAnInstanceUncovers) {
  std::vector<ThingsBeforeWall> scenes(4);
  for (int i = 0; i < 4; ++i) {
    scenes[static_cast<std::size_t>(i)].put({120 - 20 * i, 20, 80, 200}, 1.5F, 2);
  }
  const auto now = carry(scenes, {scenes[0].at(1.5F)});
  EXPECT_GT(iou(whole(now.segmentation), scenes[3].at(1.5F)), 0.97);
  EXPECT_EQ(now.segmentation.instances.size(), 1U);
}

TEST(CarriedMask, MovesEachThingOfAMaskByItself) {
  std::vector<ThingsBeforeWall> scenes(4);
  for (int i = 0; i < 4; ++i) {
    ThingsBeforeWall& scene = scenes[static_cast<std::size_t>(i)];
    scene.put({30 + 10 * i, 30, 70, 190}, 2.0F, 2);
    scene.put({220 - 10 * i, 30, 60, 190}, 1.5F, 3);
  }
  const cv::Mat both = scenes[0].at(2.0F) | scenes[0].at(1.5F);
  const auto now = carry(scenes, {both});
  EXPECT_GT(iou(whole(now.segmentation), scenes[3].at(2.0F) | scenes[3].at(1.5F)), 0.95);
}

TEST(CarriedMask, FollowsAThingThatComesNearer) {
  std::vector<ThingsBeforeWall> scenes(4);
  for (int i = 0; i < 4; ++i) {
    const int grow = 2 * i;
    scenes[static_cast<std::size_t>(i)].put({130 - grow, 30 - grow, 60, 180},
                                            2.0F - 0.12F * static_cast<float>(i), 2);
  }
  // In all 18 % nearer, more than its depth may jump at once.
  const cv::Mat truth = scenes[3].depth < 2.9F;
  const auto now = carry(scenes, {scenes[0].depth < 2.9F});
  EXPECT_GT(iou(whole(now.segmentation), truth), 0.95);
}

}  // namespace
}  // namespace dynslam::segmentation
