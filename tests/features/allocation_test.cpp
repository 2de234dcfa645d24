// Functions that promise to reuse their memory are watched.
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/opencv.hpp"
#include "dynslam/features/matcher.hpp"
#include "dynslam/features/orb.hpp"
#include "dynslam/features/patch_alignment.hpp"

#include "allocation_counter.hpp"
#include "features/support.hpp"

namespace dynslam::features {
namespace {

using dynslam::testing::Allocations;
using dynslam::testing::allocations_of;
using testing::texture;

struct Frame {
  cv::Mat image = texture(320, 240, 9);
  OrbExtractor extractor;
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  void extract() {
    extractor.extract(as_view<const std::uint8_t>(image), {}, keypoints, descriptors);
  }
};

TEST_F(Allocations, OfASecondExtractionAreNone) {
  Frame frame;
  EXPECT_GT(allocations_of([&] { frame.extract(); }), 0);
  EXPECT_EQ(allocations_of([&] { frame.extract(); }), 0);
}

TEST_F(Allocations, OfASecondExtractionWithACrowdAreNone) {
  Frame frame;
  cv::Mat crowd = cv::Mat::zeros(frame.image.size(), CV_8UC1);
  crowd(cv::Rect(60, 40, 150, 150)) = 255;
  const OrbBudget budget{800, as_view<const std::uint8_t>(crowd), 100};
  const auto extract = [&] {
    frame.extractor.extract(as_view<const std::uint8_t>(frame.image), {}, budget, frame.keypoints,
                            frame.descriptors);
  };
  EXPECT_GT(allocations_of(extract), 0);
  EXPECT_EQ(allocations_of(extract), 0);
}

TEST_F(Allocations, OfASecondGridAndASecondWindowMatchAreNone) {
  Frame frame;
  frame.extract();
  KeypointGrid grid;
  const auto positions = field(frame.keypoints, &cv::KeyPoint::pt);
  const auto build = [&] { grid.build(positions, 320, 240); };
  build();
  EXPECT_EQ(allocations_of(build), 0);

  const std::vector<float> radii(frame.keypoints.size(), 20.0F);
  const DescriptorsView descriptors = as_view<const std::uint8_t>(frame.descriptors);
  std::vector<Match> matches;
  const auto match = [&] {
    match_windowed({positions, radii, {}, {}, descriptors}, {&grid, {}, descriptors, {}}, {},
                   matches);
  };
  match();
  EXPECT_EQ(matches.size(), frame.keypoints.size());
  EXPECT_EQ(allocations_of(match), 0);
}

TEST_F(Allocations, OfAligningAPatchAreNone) {
  const Frame frame;
  const GrayView image = as_view<const std::uint8_t>(frame.image);
  const Eigen::Vector2f at(100.3F, 90.2F);
  const auto align = [&] {
    const auto patch = cut_patch(image, at);
    if (patch) align_patch(*patch, Eigen::Matrix2f::Identity(), image, at);
  };
  align();  // chooses the instruction set
  EXPECT_EQ(allocations_of(align), 0);
}

}  // namespace
}  // namespace dynslam::features
