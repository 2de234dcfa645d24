// Masks that follow depth, are remembered and are carried: on a drawn scene with exact truth.
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/segmentation/depth_refinement.hpp"
#include "dynslam/segmentation/mask_propagation.hpp"
#include "dynslam/segmentation/refined_segmenter.hpp"

#include "segmentation/masks.hpp"
#include "segmentation/test_paths.hpp"

namespace dynslam::segmentation {
namespace {

// A wall at 3 m, a textured "person" at 1.5 m whose left edge is at `x`, and a table edge at 1 m
// before the person's middle.
struct PersonBeforeWall {
  cv::Mat image, depth, person;

  explicit PersonBeforeWall(int x = 120, bool table = false) {
    cv::Mat noise(kSize, CV_8UC1);
    cv::RNG random(5);
    random.fill(noise, cv::RNG::UNIFORM, 0, 255);
    cv::GaussianBlur(noise, noise, {5, 5}, 1.2);
    cv::normalize(noise, noise, 0, 255, cv::NORM_MINMAX);
    cv::cvtColor(noise, image, cv::COLOR_GRAY2BGR);
    depth = cv::Mat(kSize, CV_32FC1, cv::Scalar(3.0F));
    person = cv::Mat::zeros(kSize, CV_8UC1);
    const cv::Rect body = cv::Rect(x, 40, 60, 170) & cv::Rect(cv::Point(), kSize);
    person(body).setTo(255);
    cv::Mat cloth(170, 60, CV_8UC3);
    cv::RNG(9).fill(cloth, cv::RNG::UNIFORM, 0, 255);
    cv::GaussianBlur(cloth, cloth, {5, 5}, 1.0);
    cloth(body - cv::Point(x, 40)).copyTo(image(body));
    depth(body).setTo(1.5F);
    if (table) {
      const cv::Rect board(0, 110, kSize.width, 30);
      image(board).setTo(cv::Scalar(40, 60, 90));
      depth(board).setTo(1.0F);
      person(board).setTo(0);
    }
  }
  DepthView view() const { return as_view<const float>(depth); }
};

Segmentation of_mask(const cv::Mat& mask, float score = 0.9F) {
  Segmentation found;
  found.width = mask.cols;
  found.height = mask.rows;
  Instance instance;
  instance.box = cv::boundingRect(mask);
  instance.score = score;
  if (!instance.box.empty()) {
    instance.mask = mask(instance.box).clone();
    found.instances.push_back(instance);
  }
  return found;
}

TEST(DepthRefiner, GrowsToTheDepthEdgeAndTakesOutTheBackground) {
  const PersonBeforeWall scene;
  cv::Mat rough = cv::Mat::zeros(kSize, CV_8UC1);
  cv::rectangle(rough, cv::Rect(108, 52, 60, 146), cv::Scalar(255), cv::FILLED);  // shifted, short
  Segmentation found = of_mask(rough);
  ASSERT_LT(iou(rough, scene.person), 0.7);
  DepthRefiner().refine(found, scene.view());
  EXPECT_GT(iou(whole(found), scene.person), 0.97);
  EXPECT_EQ(found.instances[0].mask.size(), found.instances[0].box.size());
}

TEST(DepthRefiner, FindsLegsBehindATable) {
  const PersonBeforeWall scene(120, true);
  cv::Mat torso = scene.person.clone();
  torso.rowRange(110, kSize.height).setTo(0);
  Segmentation found = of_mask(torso);
  DepthRefiner().refine(found, scene.view());
  EXPECT_GT(iou(whole(found), scene.person), 0.97);
  DepthRefinementOptions options;
  options.reach = 0.0;
  found = of_mask(torso);
  DepthRefiner(options).refine(found, scene.view());
  EXPECT_LT(iou(whole(found), scene.person), 0.6) << "not when told not to";
}

TEST(DepthRefiner, DoesNotRunAwayAlongAWall) {
  PersonBeforeWall scene;
  scene.depth.setTo(2.0F);  // a picture of a person: no depth edge at all
  Segmentation found = of_mask(scene.person);
  DepthRefiner().refine(found, scene.view());
  EXPECT_GT(iou(whole(found), scene.person), 0.8);
}

TEST(DepthRefiner, DoesNotGrowOverTheFloor) {
  PersonBeforeWall scene;
  for (int y = 150; y < kSize.height; ++y) {
    for (int x = 0; x < kSize.width; ++x) {
      if (scene.person.at<std::uint8_t>(y, x) == 0) {
        scene.depth.at<float>(y, x) = 1.5F + 0.02F * static_cast<float>(209 - y);
      }
    }
  }
  Segmentation found = of_mask(scene.person);
  DepthRefiner().refine(found, scene.view());
  EXPECT_GT(iou(whole(found), scene.person), 0.9);
}

TEST(DepthRefiner, FillsHolesOfTheDepthImageInsideTheMask) {
  PersonBeforeWall scene;
  scene.depth(cv::Rect(140, 80, 10, 12)).setTo(0.0F);
  cv::Mat holed = scene.person.clone();
  holed(cv::Rect(140, 80, 10, 12)).setTo(0);
  Segmentation found = of_mask(holed);
  DepthRefiner().refine(found, scene.view());
  EXPECT_GT(iou(whole(found), scene.person), 0.99);
}

TEST(DepthRefiner, KeepsTwoThingsThatTheNetworkTookForOne) {
  PersonBeforeWall scene;
  const cv::Rect second(180, 60, 40, 140);
  scene.depth(second).setTo(2.2F);
  cv::Mat both = scene.person.clone();
  both(second).setTo(255);
  Segmentation found = of_mask(both);
  DepthRefiner().refine(found, scene.view());
  EXPECT_GT(iou(whole(found), both), 0.95);
}

TEST(DepthRefiner, LeavesMasksAloneWithoutDepth) {
  PersonBeforeWall scene;
  for (const float nothing : {0.0F, -1.0F, std::numeric_limits<float>::quiet_NaN(),
                              std::numeric_limits<float>::infinity()}) {
    scene.depth.setTo(nothing);
    Segmentation found = of_mask(scene.person);
    DepthRefiner().refine(found, scene.view());
    EXPECT_EQ(iou(whole(found), scene.person), 1.0) << nothing;
  }
  Segmentation found = of_mask(scene.person);
  DepthRefiner().refine(found, {});
  EXPECT_EQ(iou(whole(found), scene.person), 1.0);
}

TEST(DepthRefiner, SurvivesAnyInstanceOnAnyDepth) {
  std::mt19937 random(3);
  DepthRefiner refiner;
  for (int round = 0; round < 300; ++round) {
    const cv::Size size(1 + static_cast<int>(random() % 60), 1 + static_cast<int>(random() % 60));
    cv::Mat depth(size, CV_32FC1);
    cv::RNG(random()).fill(depth, cv::RNG::UNIFORM, -0.5, 4.0);
    Segmentation found;
    found.width = size.width;
    found.height = size.height;
    for (int i = 0; i < 3; ++i) {
      Instance instance;
      const int x = static_cast<int>(random() % static_cast<unsigned>(size.width));
      const int y = static_cast<int>(random() % static_cast<unsigned>(size.height));
      instance.box =
          cv::Rect(x, y, 1 + static_cast<int>(random() % 40), 1 + static_cast<int>(random() % 40)) &
          cv::Rect(cv::Point(), size);
      instance.mask = cv::Mat(instance.box.size(), CV_8UC1);
      cv::RNG(random()).fill(instance.mask, cv::RNG::UNIFORM, 0, 2);
      instance.mask *= 255;
      found.instances.push_back(instance);
    }
    if (round % 2 == 0) {
      refiner.refine(found, as_view<const float>(depth));
    } else {
      refiner.masks_from_boxes(found, as_view<const float>(depth));
    }
    ASSERT_EQ(found.instances.size(), 3U);
    for (const Instance& instance : found.instances) {
      ASSERT_EQ(instance.box & cv::Rect(cv::Point(), size), instance.box);
      ASSERT_FALSE(instance.box.empty());
      ASSERT_EQ(instance.mask.size(), instance.box.size());
    }
  }
}

TEST(DepthRefiner, MakesMasksFromBoxes) {
  const PersonBeforeWall scene;
  cv::Mat box = cv::Mat::zeros(kSize, CV_8UC1);
  box(cv::Rect(112, 34, 76, 180)).setTo(255);
  Segmentation found = of_mask(box);
  DepthRefiner refiner;
  refiner.masks_from_boxes(found, scene.view());
  EXPECT_GT(iou(whole(found), scene.person), 0.95);
  found = of_mask(box);
  refiner.masks_from_boxes(found, {});
  EXPECT_EQ(iou(whole(found), box), 1.0) << "without depth the mask is the box";
}

TEST(DepthRefiner, RefusesDepthOfAnotherSize) {
  const PersonBeforeWall scene;
  Segmentation found = of_mask(scene.person);
  found.width = 100;
  EXPECT_THROW(DepthRefiner().refine(found, scene.view()), InvalidArgument);
  EXPECT_THROW(DepthRefiner().masks_from_boxes(found, scene.view()), InvalidArgument);
}

TEST(DepthRefinementOptions, AreCheckedByName) {
  const auto refused = [](const char* name, auto change) {
    DepthRefinementOptions options;
    change(options);
    const std::string message = message_of<InvalidArgument>([&] { DepthRefiner refiner(options); });
    EXPECT_NE(message.find(name), std::string::npos) << name << ": " << message;
  };
  refused("focal_ratio", [](auto& o) { o.focal_ratio = 0.0; });
  refused("step_share", [](auto& o) { o.step_share = 0.0; });
  refused("step_m", [](auto& o) { o.step_m = -1.0; });
  refused("max_slant", [](auto& o) { o.max_slant = std::numeric_limits<double>::quiet_NaN(); });
  refused("max_growth", [](auto& o) { o.max_growth = -0.1; });
  refused("max_removal", [](auto& o) { o.max_removal = 1.1; });
  refused("side_margin", [](auto& o) { o.side_margin = -0.1; });
  refused("reach", [](auto& o) { o.reach = 11.0; });
}

// Gives what the test put in for each frame.
class Scripted final : public Segmenter {
 public:
  explicit Scripted(std::vector<Segmentation> answers) : answers_(std::move(answers)) {}
  Segmentation segment(const cv::Mat&, const FrameInfo& frame) override {
    return answers_.at(frame.index);
  }
  const std::vector<std::string>& class_names() const override { return names_; }
  SegmenterInfo info() const override { return {}; }

 private:
  std::vector<Segmentation> answers_;
  std::vector<std::string> names_{"person"};
};

FrameInfo frame_of(std::size_t index, const PersonBeforeWall& scene) {
  FrameInfo frame;
  frame.index = index;
  frame.timestamp = 0.07 * static_cast<double>(index);
  frame.depth = scene.view();
  return frame;
}

Segmentation nothing() {
  Segmentation empty;
  empty.width = kSize.width;
  empty.height = kSize.height;
  return empty;
}

TEST(RefinedSegmenter, BridgesMissedDetectionsWhereThePersonWalks) {
  std::vector<PersonBeforeWall> scenes;
  std::vector<Segmentation> answers;
  for (int i = 0; i < 10; ++i) {
    scenes.emplace_back(80 + 8 * i);
    answers.push_back(i == 0 ? of_mask(scenes.back().person) : nothing());
  }
  RefinementOptions options;
  options.max_bridged = 5;
  RefinedSegmenter segmenter(std::make_unique<Scripted>(answers), options);
  int label = 0;
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    const Segmentation found = segmenter.segment(scenes[i].image, frame_of(i, scenes[i]));
    ASSERT_EQ(found.instances.size(), i <= 5 ? 1U : 0U) << i;
    if (i > 5) continue;
    EXPECT_GT(iou(whole(found), scenes[i].person), 0.9) << i;
    if (i == 0) label = found.instances[0].label;
    EXPECT_EQ(found.instances[0].label, label);
    EXPECT_GT(label, 0);
  }
}

TEST(RefinedSegmenter, TakesAWeakDetectionOnlyWhereAnInstanceIsRemembered) {
  const PersonBeforeWall scene;
  cv::Mat elsewhere = cv::Mat::zeros(kSize, CV_8UC1);
  elsewhere(cv::Rect(250, 50, 40, 80)).setTo(255);
  Segmentation weak = of_mask(scene.person, 0.12F);
  weak.instances.push_back(of_mask(elsewhere, 0.15F).instances[0]);
  RefinementOptions options;
  options.max_bridged = 0;
  RefinedSegmenter segmenter(
      std::make_unique<Scripted>(std::vector<Segmentation>{weak, of_mask(scene.person), weak}),
      options);
  EXPECT_TRUE(segmenter.segment(scene.image, frame_of(0, scene)).instances.empty());
  EXPECT_EQ(segmenter.segment(scene.image, frame_of(1, scene)).instances.size(), 1U);
  const Segmentation third = segmenter.segment(scene.image, frame_of(2, scene));
  ASSERT_EQ(third.instances.size(), 1U);
  EXPECT_GT(iou(whole(third), scene.person), 0.95);
  EXPECT_GE(third.instances[0].score, options.score);
}

TEST(RefinedSegmenter, ForgetsWhenTimeJumps) {
  const PersonBeforeWall scene;
  const auto run = [&](std::size_t second_index, double second_time) {
    RefinedSegmenter segmenter(std::make_unique<Scripted>(
        std::vector<Segmentation>{nothing(), of_mask(scene.person), nothing(), nothing()}));
    segmenter.segment(scene.image, frame_of(1, scene));
    FrameInfo frame = frame_of(second_index, scene);
    frame.timestamp = second_time;
    return segmenter.segment(scene.image, frame).instances.size();
  };
  EXPECT_EQ(run(2, 0.14), 1U);
  EXPECT_EQ(run(2, 5.0), 0U) << "too long ago";
  EXPECT_EQ(run(2, 0.0), 0U) << "backwards";
  EXPECT_EQ(run(0, 0.14), 0U) << "an earlier frame";
}

TEST(RefinedSegmenter, WithoutMemoryAndDepthOnlyAppliesTheThreshold) {
  const PersonBeforeWall scene;
  Segmentation two = of_mask(scene.person);
  two.instances.push_back(of_mask(scene.person, 0.1F).instances[0]);
  RefinementOptions options;
  options.bridge = options.follow_depth = false;
  RefinedSegmenter segmenter(std::make_unique<Scripted>(std::vector<Segmentation>{two}), options);
  const Segmentation found = segmenter.segment(scene.image, frame_of(0, scene));
  ASSERT_EQ(found.instances.size(), 1U);
  EXPECT_EQ(iou(whole(found), scene.person), 1.0);
}

TEST(RefinementOptions, AreCheckedByName) {
  const auto refused = [](const char* name, auto change) {
    RefinementOptions options;
    change(options);
    const std::string message = message_of<InvalidArgument>([&] { options.validate(); });
    EXPECT_NE(message.find(name), std::string::npos) << name << ": " << message;
  };
  refused("score", [](auto& o) { o.score = 1.5F; });
  refused("max_bridged", [](auto& o) { o.max_bridged = -1; });
  refused("max_gap", [](auto& o) { o.max_gap = 0.0; });
  refused("min_overlap", [](auto& o) { o.min_overlap = 2.0; });
  refused("min_tracked", [](auto& o) { o.min_tracked = -0.5; });
  refused("reach", [](auto& o) { o.depth.reach = -1.0; });
  EXPECT_THROW(RefinedSegmenter(nullptr), InvalidArgument);
}

class Carried : public ::testing::TestWithParam<bool> {};

TEST_P(Carried, MaskFollowsAPersonForThreeFrames) {
  PropagationOptions options;
  options.follow_depth = GetParam();
  MaskPropagator propagator(options);
  std::vector<PersonBeforeWall> scenes;
  for (int i = 0; i < 4; ++i) {
    scenes.emplace_back(80 + 10 * i);
    propagator.add_frame(scenes.back().image, frame_of(static_cast<std::size_t>(i), scenes.back()));
  }
  EXPECT_FALSE(propagator.current().has_value());
  ASSERT_TRUE(propagator.set_segmentation(0, of_mask(scenes[0].person)));
  const auto now = propagator.current();
  ASSERT_TRUE(now.has_value());
  EXPECT_EQ(now->age, 3);
  EXPECT_EQ(now->source_index, 0U);
  EXPECT_NEAR(now->age_seconds, 0.21, 1e-9);
  ASSERT_EQ(now->confidence.size(), 1U);
  EXPECT_LT(now->confidence[0], 1.0F);
  EXPECT_GT(now->confidence[0], 0.2F);
  EXPECT_LT(iou(scenes[0].person, scenes[3].person), 0.4) << "standing still would not do";
  EXPECT_GT(iou(whole(now->segmentation), scenes[3].person), GetParam() ? 0.97 : 0.9);

  const cv::Mat soft = now->soft_mask({0}, 2);
  EXPECT_FLOAT_EQ(soft.at<float>(120, 140), now->confidence[0]);
  EXPECT_EQ(soft.at<float>(5, 5), 0.0F);
}

INSTANTIATE_TEST_SUITE_P(Depth, Carried, ::testing::Bool(), [](const auto& test) {
  return test.param ? "WithDepth" : "WithoutDepth";
});

TEST(MaskPropagator, GivesAMaskOfTheNewestFrameAsItIs) {
  const PersonBeforeWall scene;
  MaskPropagator propagator;
  propagator.add_frame(scene.image, frame_of(5, scene));
  ASSERT_TRUE(propagator.set_segmentation(5, of_mask(scene.person)));
  const auto now = propagator.current();
  ASSERT_TRUE(now.has_value());
  EXPECT_EQ(now->age, 0);
  EXPECT_EQ(now->confidence, std::vector<float>{1.0F});
  EXPECT_EQ(iou(whole(now->segmentation), scene.person), 1.0);
}

TEST(MaskPropagator, PrefersTheNewerSegmentation) {
  const PersonBeforeWall scene;
  PropagationOptions options;
  options.history = 8;
  MaskPropagator propagator(options);
  for (std::size_t i = 0; i < 12; ++i) propagator.add_frame(scene.image, frame_of(i, scene));
  EXPECT_FALSE(propagator.set_segmentation(2, of_mask(scene.person))) << "forgotten";
  EXPECT_FALSE(propagator.set_segmentation(99, of_mask(scene.person))) << "never seen";
  EXPECT_TRUE(propagator.set_segmentation(9, of_mask(scene.person)));
  EXPECT_FALSE(propagator.set_segmentation(8, of_mask(scene.person))) << "older";
  EXPECT_EQ(propagator.current()->age, 2);
  for (std::size_t i = 12; i < 30; ++i) propagator.add_frame(scene.image, frame_of(i, scene));
  EXPECT_FALSE(propagator.current().has_value()) << "too old";
}

TEST(MaskPropagator, CarriesTheSameMaskWhetherDepthIsCopiedOrShared) {
  MaskPropagator copying, sharing;
  std::vector<PersonBeforeWall> scenes;
  for (std::size_t i = 0; i < 4; ++i) {
    scenes.emplace_back(80 + 10 * static_cast<int>(i));
    FrameInfo frame = frame_of(i, scenes.back());
    copying.add_frame(scenes.back().image, frame);
    const cv::Mat depth = as_mat(frame.depth);
    frame.depth = {};
    sharing.add_frame_shared(scenes.back().image, depth, frame);
  }
  ASSERT_TRUE(copying.set_segmentation(0, of_mask(scenes[0].person)));
  ASSERT_TRUE(sharing.set_segmentation(0, of_mask(scenes[0].person)));
  const cv::Mat copied = whole(copying.current()->segmentation);
  EXPECT_GT(cv::countNonZero(copied), 0);
  EXPECT_EQ(cv::norm(copied, whole(sharing.current()->segmentation), cv::NORM_L1), 0.0);
}

TEST(MaskPropagator, RefusesToShareDepthOfAnotherTypeOrSize) {
  const PersonBeforeWall scene;
  MaskPropagator propagator;
  const FrameInfo frame{5, 0.0, "", {}};
  const cv::Mat steps(scene.image.size(), CV_16UC1, cv::Scalar(1000));
  EXPECT_THROW(propagator.add_frame_shared(scene.image, steps, frame), InvalidArgument);
  const cv::Mat small(9, 9, CV_32FC1, cv::Scalar(1));
  EXPECT_THROW(propagator.add_frame_shared(scene.image, small, frame), InvalidArgument);
}

TEST(MaskPropagator, RefusesFramesOutOfOrder) {
  const PersonBeforeWall scene;
  MaskPropagator propagator;
  propagator.add_frame(scene.image, frame_of(5, scene));
  EXPECT_THROW(propagator.add_frame(scene.image, frame_of(5, scene)), InvalidArgument);
  EXPECT_THROW(propagator.add_frame(cv::Mat(9, 9, CV_8UC1), FrameInfo{6, 0.0, "", {}}),
               InvalidArgument);
  EXPECT_THROW(propagator.add_frame(cv::Mat(), FrameInfo{6, 0.0, "", {}}), InvalidArgument);
  Segmentation other = of_mask(scene.person);
  other.width = 3;
  EXPECT_THROW(propagator.set_segmentation(5, other), InvalidArgument);
  other = of_mask(scene.person);
  other.instances.at(0).mask.release();
  EXPECT_THROW(propagator.set_segmentation(5, other), InvalidArgument);
  EXPECT_FALSE(propagator.current().has_value());
  PropagatedSegmentation result;
  EXPECT_THROW(result.soft_mask({}, -1), InvalidArgument);
  result.segmentation = of_mask(scene.person);
  EXPECT_THROW(result.soft_mask({1}, 0), InvalidArgument);
}

TEST(PropagationOptions, AreCheckedByName) {
  const auto refused = [](const char* name, auto change) {
    PropagationOptions options;
    change(options);
    const std::string message =
        message_of<InvalidArgument>([&] { MaskPropagator propagator(options); });
    EXPECT_NE(message.find(name), std::string::npos) << name << ": " << message;
  };
  refused("history", [](auto& o) { o.history = 1; });
  refused("max_error_px", [](auto& o) { o.max_error_px = 0.0; });
  refused("max_age", [](auto& o) { o.max_age = 0; });
  refused("half_life", [](auto& o) { o.half_life = -1.0; });
  refused("max_slant", [](auto& o) { o.depth.max_slant = 0.0; });
}

}  // namespace
}  // namespace dynslam::segmentation
