// What a person carries, on a drawn scene.
#include "dynslam/segmentation/carried_region.hpp"

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"

#include "segmentation/masks.hpp"
#include "segmentation/test_paths.hpp"

namespace dynslam::segmentation {
namespace {

// A wall at 3 m and somebody at 1.6 m.
struct Somebody {
  cv::Mat depth = cv::Mat(kSize, CV_32FC1, cv::Scalar(3.0F));
  Segmentation found;

  Somebody() {
    const cv::Rect body(130, 40, 60, 180);
    depth(body).setTo(1.6F);
    found.width = kSize.width;
    found.height = kSize.height;
    Instance person;
    person.score = 0.9F;
    person.box = body;
    person.mask = cv::Mat(body.size(), CV_8UC1, cv::Scalar(255));
    found.instances.push_back(person);
  }
  cv::Mat carried(const CarriedRegionOptions& options = {}) const {
    return carried_region(found, {0}, as_view<const float>(depth), options);
  }
};

TEST(CarriedRegion, IsTheBoxInTheArms) {
  Somebody scene;
  const cv::Rect box(190, 100, 30, 40);
  scene.depth(box).setTo(1.4F);
  const cv::Mat region = scene.carried();
  EXPECT_EQ(cv::boundingRect(region), box);
  EXPECT_EQ(cv::countNonZero(region), box.area());
}

TEST(CarriedRegion, LeavesWhatIsNotHeld) {
  Somebody away;
  away.depth(cv::Rect(200, 100, 30, 40)).setTo(1.4F);  // ten pixels off
  EXPECT_EQ(cv::countNonZero(away.carried()), 0);
  Somebody behind;
  behind.depth(cv::Rect(190, 100, 30, 40)).setTo(2.2F);
  EXPECT_EQ(cv::countNonZero(behind.carried()), 0);
  Somebody before;
  before.depth(cv::Rect(190, 100, 30, 40)).setTo(0.7F);
  EXPECT_EQ(cv::countNonZero(before.carried()), 0);
}

TEST(CarriedRegion, LeavesFurniture) {
  Somebody board;  // goes on beyond an arm's length
  board.depth(cv::Rect(190, 120, 130, 20)).setTo(1.5F);
  CarriedRegionOptions options;
  options.arm_m = 0.5;
  EXPECT_EQ(cv::countNonZero(board.carried(options)), 0);
  Somebody cupboard;  // larger than most of the person
  cupboard.depth(cv::Rect(190, 60, 70, 150)).setTo(1.5F);
  EXPECT_EQ(cv::countNonZero(cupboard.carried()), 0);
  Somebody floor;  // rises towards the camera
  for (int y = 180; y < 240; ++y) {
    floor.depth(cv::Rect(190, y, 60, 1)).setTo(1.6F - 0.02F * static_cast<float>(y - 220));
  }
  EXPECT_EQ(cv::countNonZero(floor.carried()), 0);
  Somebody pole;  // touches at its end only
  pole.depth(cv::Rect(190, 100, 60, 4)).setTo(1.5F);
  options = {};
  options.min_contact = 0.2;
  EXPECT_EQ(cv::countNonZero(pole.carried(options)), 0);
}

TEST(CarriedRegion, IsEmptyWithoutDepthOrCarriers) {
  Somebody scene;
  scene.depth(cv::Rect(190, 100, 30, 40)).setTo(1.4F);
  EXPECT_EQ(cv::countNonZero(carried_region(scene.found, {0}, {})), 0);
  EXPECT_EQ(cv::countNonZero(carried_region(scene.found, {}, as_view<const float>(scene.depth))),
            0);
  scene.depth.setTo(0.0F);
  EXPECT_EQ(cv::countNonZero(scene.carried()), 0);
}

TEST(CarriedRegion, ChecksItsArguments) {
  const Somebody scene;
  const cv::Mat other(10, 10, CV_32FC1, cv::Scalar(1));
  EXPECT_THROW(carried_region(scene.found, {0}, as_view<const float>(other)), InvalidArgument);
  EXPECT_THROW(carried_region(scene.found, {1}, as_view<const float>(scene.depth)),
               InvalidArgument);
}

TEST(CarriedRegionOptions, AreCheckedByName) {
  const auto refused = [](const char* name, auto change) {
    CarriedRegionOptions options;
    change(options);
    const std::string message = message_of<InvalidArgument>([&] { options.validate(); });
    EXPECT_NE(message.find(name), std::string::npos) << name << ": " << message;
  };
  EXPECT_NO_THROW(CarriedRegionOptions().validate());
  refused("arm_m", [](auto& o) { o.arm_m = 0.0; });
  refused("behind_m", [](auto& o) { o.behind_m = -0.1; });
  refused("max_share", [](auto& o) { o.max_share = 0.0; });
  refused("min_contact", [](auto& o) { o.min_contact = 1.5; });
  refused("step_share", [](auto& o) { o.depth.step_share = 0.0; });
}

}  // namespace
}  // namespace dynslam::segmentation
