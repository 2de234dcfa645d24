#include "features/orb_spread.hpp"

#include <algorithm>
#include <numeric>
#include <set>

#include <gtest/gtest.h>

#include "features/support.hpp"

namespace dynslam::features::detail {
namespace {

using testing::uniform;

std::vector<Corner> corners_of_seed(int count, int width, int height, unsigned seed) {
  std::mt19937 random(seed);
  std::set<std::pair<int, int>> places;
  while (static_cast<int>(places.size()) < count) {
    places.insert({uniform(random, 0, height - 1), uniform(random, 0, width - 1)});
  }
  std::vector<Corner> corners;
  for (const auto& [y, x] : places) {
    corners.push_back({static_cast<std::uint16_t>(x), static_cast<std::uint16_t>(y),
                       static_cast<std::uint8_t>(uniform(random, 1, 200))});
  }
  return corners;
}

TEST(PyramidLevel, HasTheBordersOfTheImage) {
  for (const float scale : {1.0F, 1.2F, 2.0F, 3.58F}) {
    EXPECT_EQ(to_level(-0.5F, scale), -0.5F);
    EXPECT_NEAR(to_level(100.0F * scale - 0.5F, scale), 99.5F, 1e-4F);
    EXPECT_NEAR(to_level(from_level(17.3F, scale), scale), 17.3F, 1e-5F);
  }
  EXPECT_EQ(to_level(0.5F, 2.0F), 0.0F) << "the first pixel of a level lies between two";
}

TEST(CornerChooser, ReturnsExactlyAsManyAsAskedForAndNoneTwice) {
  CornerChooser chooser;
  std::vector<Corner> chosen;
  for (const int count : {0, 1, 2, 17, 3000}) {
    const std::vector<Corner> corners = corners_of_seed(count, 640, 480, 1);
    for (const int target : {0, 1, 2, 3, 4, 5, 16, 17, 100, 999, 5000}) {
      for (const float share : {0.0F, 0.1F, 0.5F, 1.0F}) {
        chosen.clear();
        EXPECT_EQ(chooser.spread(corners, target, share, chosen), std::min(count, target));
        EXPECT_EQ(static_cast<int>(chosen.size()), std::min(count, target));
        std::set<std::pair<int, int>> places;
        for (const Corner& corner : chosen) places.insert({corner.x, corner.y});
        EXPECT_EQ(places.size(), chosen.size());
      }
    }
  }
}

TEST(CornerChooser, AddsToWhatWasChosenBefore) {
  CornerChooser chooser;
  const std::vector<Corner> corners = corners_of_seed(500, 640, 480, 3);
  const std::vector<Corner> others = corners_of_seed(5, 640, 480, 4);
  std::vector<Corner> chosen;
  EXPECT_EQ(chooser.spread(corners, 100, 0.5F, chosen), 100);
  const Corner first = chosen.front();
  EXPECT_EQ(chooser.spread(others, 100, 0.5F, chosen), 5);
  EXPECT_EQ(chosen.size(), 105U);
  EXPECT_TRUE(chosen.front().x == first.x && chosen.front().y == first.y);
}

TEST(CornerChooser, TakesTheStrongestIfAskedForOne) {
  CornerChooser chooser;
  std::vector<Corner> corners = corners_of_seed(500, 640, 480, 2);
  corners[123].score = 255;
  std::vector<Corner> chosen;
  chooser.spread(corners, 1, 1.0F, chosen);
  ASSERT_EQ(chosen.size(), 1U);
  EXPECT_EQ(chosen[0].score, 255);
}

TEST(CornerChooser, GivesSparseRegionsTheirShare) {
  // 2000 corners in the left tenth, 40 in the rest.
  std::vector<Corner> corners = corners_of_seed(2000, 64, 480, 3);
  for (Corner corner : corners_of_seed(40, 500, 480, 4)) {
    corner.x = static_cast<std::uint16_t>(corner.x + 100);
    corners.push_back(corner);
  }
  CornerChooser chooser;
  std::vector<Corner> chosen;
  chooser.spread(corners, 200, 1.0F, chosen);
  int right = 0;
  for (const Corner& corner : chosen) right += corner.x >= 100;
  EXPECT_GE(right, 36);
}

TEST(CornerChooser, TakesTheStrongestOnlyIfNoneAreToBeSpread) {
  const std::vector<Corner> corners = corners_of_seed(2000, 640, 480, 5);
  CornerChooser chooser;
  std::vector<Corner> chosen;
  chooser.spread(corners, 300, 0.0F, chosen);
  std::vector<int> all, taken;
  for (const Corner& corner : corners) all.push_back(corner.score);
  for (const Corner& corner : chosen) taken.push_back(corner.score);
  std::sort(all.rbegin(), all.rend());
  std::sort(taken.rbegin(), taken.rend());
  all.resize(300);
  EXPECT_EQ(taken, all);
}

TEST(CornerChooser, HoldsTheEvenlySpreadOnesAndTheStrongestOfTheRest) {
  const std::vector<Corner> corners = corners_of_seed(2000, 640, 480, 6);
  CornerChooser chooser;
  std::vector<Corner> even, both;
  chooser.spread(corners, 150, 1.0F, even);
  chooser.spread(corners, 300, 0.5F, both);
  const auto place = [](const Corner& corner) { return std::pair(corner.x, corner.y); };
  std::set<std::pair<int, int>> places;
  for (const Corner& corner : both) places.insert(place(corner));
  for (const Corner& corner : even) EXPECT_EQ(places.count(place(corner)), 1U);
  int strongest_left_out = 0;
  for (const Corner& corner : corners) {
    if (places.count(place(corner)) == 0) {
      strongest_left_out = std::max<int>(strongest_left_out, corner.score);
    }
  }
  std::set<std::pair<int, int>> even_places;
  for (const Corner& corner : even) even_places.insert(place(corner));
  for (const Corner& corner : both) {
    if (even_places.count(place(corner)) == 0) {
      EXPECT_GE(corner.score, strongest_left_out);
    }
  }
}

TEST(CornerChooser, WorksOnCornersAtTheEndsOfItsRange) {
  const std::vector<Corner> corners = {{0, 0, 1}, {65534, 0, 2}, {0, 65534, 3}, {65534, 65534, 4}};
  CornerChooser chooser;
  std::vector<Corner> chosen;
  chooser.spread(corners, 3, 1.0F, chosen);
  ASSERT_EQ(chosen.size(), 3U);
  for (const Corner& corner : chosen) EXPECT_GT(corner.score, 1);  // the weakest had to go
}

TEST(DivideBudget, GivesWhatSomeLevelsLackToTheOthers) {
  std::vector<int> take;
  divide_budget({50, 30, 20}, {1000, 1000, 1000}, 100, take);
  EXPECT_EQ(take, (std::vector<int>{50, 30, 20}));
  divide_budget({50, 30, 20}, {10, 1000, 1000}, 100, take);
  EXPECT_EQ(take[0], 10);
  EXPECT_EQ(std::accumulate(take.begin(), take.end(), 0), 100);
  EXPECT_GT(take[1], take[2]);
  divide_budget({50, 30, 20}, {10, 40, 0}, 100, take);
  EXPECT_EQ(take, (std::vector<int>{10, 40, 0}));
  divide_budget({1, 0, 0}, {0, 0, 5}, 1, take);
  EXPECT_EQ(take, (std::vector<int>{0, 0, 1}));
  divide_budget({1, 1, 1}, {0, 0, 0}, 3, take);
  EXPECT_EQ(take, (std::vector<int>{0, 0, 0}));
}

TEST(DivideBudget, NeverExceedsTheBudgetNorWhatIsThere) {
  std::mt19937 random(5);
  std::vector<int> take;
  for (int i = 0; i < 2000; ++i) {
    std::vector<int> shares(8), available(8);
    for (int& share : shares) share = uniform(random, 0, 200);
    for (int& count : available) count = uniform(random, 0, 300);
    const int budget = std::accumulate(shares.begin(), shares.end(), 0);
    divide_budget(shares, available, budget, take);
    for (std::size_t k = 0; k < 8; ++k) EXPECT_LE(take[k], available[k]);
    EXPECT_EQ(std::accumulate(take.begin(), take.end(), 0),
              std::min(budget, std::accumulate(available.begin(), available.end(), 0)));
  }
}

}  // namespace
}  // namespace dynslam::features::detail
