#include "dynslam/segmentation/mask_policy.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/segmentation/yolo_seg_segmenter.hpp"

#include "segmentation/test_paths.hpp"

namespace dynslam::segmentation {
namespace {

Instance solid(int class_id, float score, cv::Rect box) {
  Instance instance;
  instance.class_id = class_id;
  instance.score = score;
  instance.box = box;
  instance.mask = cv::Mat(box.size(), CV_8UC1, cv::Scalar(255));
  return instance;
}

Segmentation scene() {
  Segmentation found;
  found.width = 100;
  found.height = 80;
  found.instances = {solid(0, 0.9F, {10, 10, 20, 30}), solid(56, 0.9F, {60, 10, 20, 30}),
                     solid(0, 0.1F, {60, 60, 10, 10})};
  return found;
}

TEST(MaskPolicy, MasksDynamicClassesOfSufficientScoreOnly) {
  MaskPolicyOptions options;
  options.dilation_px = 0;
  const cv::Mat mask = MaskPolicy(options).mask(scene(), coco_class_names());
  EXPECT_EQ(mask.size(), cv::Size(100, 80));
  EXPECT_EQ(cv::countNonZero(mask), 20 * 30);
  EXPECT_EQ(cv::countNonZero(mask(cv::Rect(10, 10, 20, 30)) == 255), 20 * 30);
}

TEST(MaskPolicy, IsTheMaskViewOfOtherRoomsWithoutACopy) {
  const cv::Mat mask = MaskPolicy().mask(scene(), coco_class_names());
  const MaskView view = as_view<const std::uint8_t>(mask);
  EXPECT_EQ(view.data, mask.data);
}

TEST(MaskPolicy, ReusesTheMaskItIsGiven) {
  cv::Mat mask(80, 100, CV_8UC1, cv::Scalar(7));
  const unsigned char* pixels = mask.data;
  MaskPolicy().mask(scene(), coco_class_names(), mask);
  EXPECT_EQ(mask.data, pixels);
  EXPECT_EQ(cv::countNonZero(mask == 7), 0);
}

TEST(MaskPolicy, GivesAnEmptyMaskForNothing) {
  Segmentation nothing;
  nothing.width = 30;
  nothing.height = 20;
  const cv::Mat mask = MaskPolicy().mask(nothing, {});
  EXPECT_EQ(mask.size(), cv::Size(30, 20));
  EXPECT_EQ(cv::countNonZero(mask), 0);
}

TEST(MaskPolicy, TakesTheClassesItIsTold) {
  MaskPolicyOptions options;
  options.dilation_px = 0;
  options.classes = {"CHAIR"};
  EXPECT_EQ(cv::countNonZero(MaskPolicy(options).mask(scene(), coco_class_names())), 600);
  options.classes = {"*"};
  EXPECT_EQ(cv::countNonZero(MaskPolicy(options).mask(scene(), coco_class_names())), 1200);
  EXPECT_EQ(cv::countNonZero(MaskPolicy(options).mask(scene(), {})), 1200);
  options.classes = {};
  EXPECT_EQ(cv::countNonZero(MaskPolicy(options).mask(scene(), coco_class_names())), 0);
}

TEST(MaskPolicy, TakesWhatADynamicInstanceTouches) {
  Segmentation found = scene();
  found.instances.push_back(solid(56, 0.9F, {33, 15, 10, 10}));  // a chair 3 pixels off the person
  found.instances.push_back(solid(56, 0.9F, {44, 15, 10, 10}));  // and one beside that chair
  MaskPolicyOptions options;
  options.touched_classes = {"chair"};
  const MaskPolicy policy(options);
  EXPECT_EQ(policy.dynamic_instances(found, coco_class_names()), (std::vector<std::size_t>{0, 3}));
  options.touch_px = 3;
  EXPECT_EQ(MaskPolicy(options).dynamic_instances(found, coco_class_names()).size(), 1U);
  found.instances.erase(found.instances.begin());
  EXPECT_TRUE(policy.dynamic_instances(found, coco_class_names()).empty()) << "nobody is there";
}

TEST(DilationAtLevel, GrowsWithTheLevel) {
  EXPECT_EQ(dilation_at_level(15.0, 1.2, 0), 15);
  EXPECT_EQ(dilation_at_level(15.0, 1.2, 2), 22);
  EXPECT_EQ(dilation_at_level(50.0, 2.0, 7), 100);
  EXPECT_THROW(dilation_at_level(-1.0, 1.2, 0), InvalidArgument);
  EXPECT_THROW(dilation_at_level(1.0, 0.9, 0), InvalidArgument);
  EXPECT_THROW(dilation_at_level(1.0, 1.2, -1), InvalidArgument);
}

TEST(MasksByLevel, KeepPatchesOfEveryLevelOffTheMask) {
  cv::Mat mask = cv::Mat::zeros(120, 200, CV_8UC1);
  mask.at<std::uint8_t>(60, 100) = 255;
  const auto masks = masks_by_level(mask, 10.0, 1.5, 3);
  ASSERT_EQ(masks.size(), 3U);
  for (int level = 0; level < 3; ++level) {
    const cv::Mat& here = masks[static_cast<std::size_t>(level)];
    const double shrink = std::pow(1.5, level);
    EXPECT_EQ(here.cols, std::lround(200 / shrink));
    // Ten pixels of the level on each side, whatever the level.
    EXPECT_NEAR(cv::boundingRect(here).width, 21, 2) << level;
  }
  EXPECT_THROW(masks_by_level(cv::Mat(), 1.0, 1.2, 1), InvalidArgument);
  EXPECT_THROW(masks_by_level(cv::Mat(4, 4, CV_32F), 1.0, 1.2, 1), InvalidArgument);
  EXPECT_THROW(masks_by_level(mask, 1.0, 1.2, 0), InvalidArgument);
}

TEST(MaskPolicy, KnowsBothSpellingsOfAClass) {
  EXPECT_EQ(canonical_class_name("motorbike"), canonical_class_name("Motorcycle"));
  EXPECT_EQ(canonical_class_name("dining_table"), canonical_class_name("diningtable"));
  EXPECT_EQ(canonical_class_name(" potted-plant "), "potted plant");
  EXPECT_EQ(canonical_class_name("tvmonitor"), canonical_class_name("tv"));
  EXPECT_NE(canonical_class_name("cat"), canonical_class_name("car"));
}

TEST(MaskPolicy, DefaultsAreThePeopleVehiclesAndAnimalsOfCoco) {
  const auto& coco = coco_class_names();
  ASSERT_EQ(coco.size(), 80U);
  for (const std::string& name : default_dynamic_classes()) {
    EXPECT_TRUE(name == "mover" || std::find(coco.begin(), coco.end(), name) != coco.end()) << name;
  }
  EXPECT_EQ(default_dynamic_classes().size(), 18U);
}

TEST(MaskPolicy, RefusesInstancesThatDoNotFitTheImage) {
  Segmentation found = scene();
  found.instances[1].box.x = 90;
  EXPECT_THROW(MaskPolicy().mask(found, coco_class_names()), InvalidArgument);
  found = scene();
  found.instances[0].mask = cv::Mat(5, 5, CV_8UC1);
  cv::Mat mask(3, 3, CV_8UC1, cv::Scalar(9));
  EXPECT_THROW(MaskPolicy().mask(found, coco_class_names(), mask), InvalidArgument);
  EXPECT_EQ(mask.rows, 3) << "the output is untouched";
  found = scene();
  found.instances[0].mask.convertTo(found.instances[0].mask, CV_32F);
  EXPECT_THROW(MaskPolicy().mask(found, coco_class_names()), InvalidArgument);
}

TEST(MaskPolicyOptions, AreCheckedByName) {
  const auto refused = [](const char* name, auto change) {
    MaskPolicyOptions options;
    change(options);
    const std::string message = message_of<InvalidArgument>([&] { MaskPolicy policy(options); });
    EXPECT_NE(message.find(name), std::string::npos) << name << ": " << message;
  };
  refused("min_score", [](MaskPolicyOptions& o) { o.min_score = 2.0F; });
  refused("min_score",
          [](MaskPolicyOptions& o) { o.min_score = std::numeric_limits<float>::quiet_NaN(); });
  refused("dilation_px", [](MaskPolicyOptions& o) { o.dilation_px = -1; });
  refused("dilation_px", [](MaskPolicyOptions& o) { o.dilation_px = 101; });
  refused("touch_px", [](MaskPolicyOptions& o) { o.touch_px = -1; });
  refused("touched_classes", [](MaskPolicyOptions& o) { o.touched_classes = {""}; });
  refused("classes", [](MaskPolicyOptions& o) { o.classes = {"person", " "}; });
}

TEST(DilateMask, ReachesExactlyThePixelsWithinTheRadius) {
  cv::Mat source = cv::Mat::zeros(37, 53, CV_8UC1);
  for (const cv::Point p :
       {cv::Point(0, 0), cv::Point(20, 18), cv::Point(52, 30), cv::Point(22, 18)}) {
    source.at<std::uint8_t>(p) = 255;
  }
  for (const int radius : {0, 1, 2, 3, 7, 60}) {
    cv::Mat mask = source.clone();
    dilate_mask(mask, radius);
    for (int y = 0; y < source.rows; ++y) {
      for (int x = 0; x < source.cols; ++x) {
        bool near = false;
        for (int v = 0; v < source.rows && !near; ++v) {
          for (int u = 0; u < source.cols && !near; ++u) {
            near = source.at<std::uint8_t>(v, u) != 0 &&
                   (x - u) * (x - u) + (y - v) * (y - v) <= radius * radius;
          }
        }
        ASSERT_EQ(mask.at<std::uint8_t>(y, x), near ? 255 : 0) << radius << " " << x << " " << y;
      }
    }
  }
}

TEST(DilateMask, GrowsLargeMasksAsMuchAsASmallPiece) {
  constexpr int kRadius = 10;
  cv::Mat whole = cv::Mat::zeros(120, 203, CV_8UC1);
  cv::ellipse(whole, {90, 60}, {70, 40}, 0, 0, 360, 1, cv::FILLED);  // any value but 0 counts
  cv::Mat pieces = cv::Mat::zeros(whole.size(), CV_8UC1);
  for (int y = 0; y < whole.rows; y += 11) {
    for (int x = 0; x < whole.cols; x += 7) {
      const cv::Rect tile = cv::Rect(x, y, 7, 11) & cv::Rect({}, whole.size());
      cv::Mat piece = cv::Mat::zeros(whole.size(), CV_8UC1);
      whole(tile).copyTo(piece(tile));
      dilate_mask(piece, kRadius);
      pieces |= piece;
    }
  }
  dilate_mask(whole, kRadius);
  EXPECT_EQ(cv::countNonZero(whole != pieces), 0);
  EXPECT_EQ(cv::countNonZero((whole != 0) & (whole != 255)), 0);
}

TEST(DilateMask, RefusesOtherTypesAndRadii) {
  cv::Mat colour(4, 4, CV_8UC3), grey(4, 4, CV_8UC1), empty;
  EXPECT_THROW(dilate_mask(colour, 1), InvalidArgument);
  EXPECT_THROW(dilate_mask(grey, -1), InvalidArgument);
  EXPECT_THROW(dilate_mask(grey, 101), InvalidArgument);
  EXPECT_NO_THROW(dilate_mask(empty, 1));
}

}  // namespace
}  // namespace dynslam::segmentation
