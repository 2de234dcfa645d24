// Functions that promise to reuse their memory are watched: this file counts every `new` of the
// program.
#include <atomic>
#include <cstdlib>
#include <new>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/opencv.hpp"
#include "dynslam/features/matcher.hpp"
#include "dynslam/features/orb.hpp"

#include "features/support.hpp"

namespace {
std::atomic<long> allocations{0};
}

void* operator new(std::size_t size) {
  ++allocations;
  if (void* memory = std::malloc(size != 0 ? size : 1)) return memory;
  throw std::bad_alloc();
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

namespace dynslam::features {
namespace {

using testing::texture;

template <typename Function>
long allocations_of(const Function& function) {
  const long before = allocations;
  function();
  return allocations - before;
}

struct Frame {
  cv::Mat image = texture(320, 240, 9);
  OrbExtractor extractor;
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  void extract() {
    extractor.extract(as_view<const std::uint8_t>(image), {}, keypoints, descriptors);
  }
};

TEST(Allocations, OfASecondExtractionAreNone) {
  Frame frame;
  EXPECT_GT(allocations_of([&] { frame.extract(); }), 0);  // the counter counts
  EXPECT_EQ(allocations_of([&] { frame.extract(); }), 0);
}

TEST(Allocations, OfASecondGridAndASecondWindowMatchAreNone) {
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

}  // namespace
}  // namespace dynslam::features
