#include <limits>
#include <numeric>
#include <string>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/features/orb.hpp"

namespace dynslam::features {
namespace {

/// The complaint about options, empty if there is none.
template <typename Change>
std::string complaint(const Change& change) {
  OrbOptions options;
  change(options);
  try {
    options.validate();
  } catch (const InvalidArgument& error) {
    return error.what();
  }
  return {};
}

bool names(const std::string& message, const std::string& member) {
  return message.find("OrbOptions::validate: " + member + ":") != std::string::npos;
}

TEST(OrbOptions, DefaultsAreValid) {
  EXPECT_EQ(complaint([](OrbOptions&) {}), "");
}

TEST(OrbOptions, MaxFeaturesIsPositive) {
  EXPECT_TRUE(names(complaint([](OrbOptions& o) { o.max_features = 0; }), "max_features"));
  EXPECT_EQ(complaint([](OrbOptions& o) { o.max_features = 1; }), "");
}

TEST(OrbOptions, ScaleFactorIsAboveOneAndAtMostFour) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (const float bad : {1.0F, 0.5F, 4.5F, nan}) {
    EXPECT_TRUE(names(complaint([bad](OrbOptions& o) { o.scale_factor = bad; }), "scale_factor"));
  }
  EXPECT_EQ(complaint([](OrbOptions& o) { o.scale_factor = 4.0F; }), "");
}

TEST(OrbOptions, LevelsAreOneToThirtyTwo) {
  for (const int bad : {0, -1, 33}) {
    EXPECT_TRUE(names(complaint([bad](OrbOptions& o) { o.levels = bad; }), "levels"));
  }
  EXPECT_EQ(complaint([](OrbOptions& o) { o.levels = 32; }), "");
}

TEST(OrbOptions, FastThresholdIsAGreyValueBelow255) {
  for (const int bad : {0, 255}) {
    EXPECT_TRUE(
        names(complaint([bad](OrbOptions& o) { o.fast_threshold = bad; }), "fast_threshold"));
  }
}

TEST(OrbOptions, MinFastThresholdIsNotAboveFastThreshold) {
  for (const int bad : {0, 21}) {
    EXPECT_TRUE(names(complaint([bad](OrbOptions& o) { o.min_fast_threshold = bad; }),
                      "min_fast_threshold"));
  }
  EXPECT_EQ(complaint([](OrbOptions& o) { o.min_fast_threshold = 20; }), "");
}

TEST(OrbOptions, SpreadIsAShare) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (const float bad : {-0.1F, 1.1F, nan}) {
    EXPECT_TRUE(names(complaint([bad](OrbOptions& o) { o.spread = bad; }), "spread"));
  }
  for (const float good : {0.0F, 1.0F}) {
    EXPECT_EQ(complaint([good](OrbOptions& o) { o.spread = good; }), "");
  }
}

TEST(OrbOptions, CellsHaveAtLeastEightPixels) {
  EXPECT_TRUE(names(complaint([](OrbOptions& o) { o.cell_size = 7; }), "cell_size"));
}

TEST(OrbOptions, MaskMarginIsNotNegativeAndAtMost1024) {
  for (const int bad : {-1, 1025}) {
    EXPECT_TRUE(names(complaint([bad](OrbOptions& o) { o.mask_margin = bad; }), "mask_margin"));
  }
}

TEST(OrbOptions, AreCheckedByTheExtractor) {
  OrbOptions options;
  options.levels = 0;
  EXPECT_THROW(OrbExtractor{options}, InvalidArgument);
}

TEST(OrbExtractor, SharesSumToTheBudgetAndFallWithTheLevel) {
  for (const int budget : {1, 7, 500, 1000, 2000}) {
    OrbOptions options;
    options.max_features = budget;
    const OrbExtractor extractor(options);
    const std::vector<int>& shares = extractor.features_per_level();
    ASSERT_EQ(shares.size(), 8U);
    EXPECT_EQ(std::accumulate(shares.begin(), shares.end(), 0), budget);
    if (budget >= 500) {
      EXPECT_TRUE(std::is_sorted(shares.rbegin(), shares.rend()));
    }
    for (const int share : shares) EXPECT_GE(share, 0);
  }
}

TEST(OrbExtractor, ScaleFactorsArePowers) {
  const OrbExtractor extractor;
  ASSERT_EQ(extractor.scale_factors().size(), 8U);
  EXPECT_EQ(extractor.scale_factors()[0], 1.0F);
  EXPECT_FLOAT_EQ(extractor.scale_factors()[1], 1.2F);
  EXPECT_FLOAT_EQ(extractor.scale_factors()[7], 3.5831808F);
  EXPECT_EQ(extractor.options().max_features, 1000);
}

}  // namespace
}  // namespace dynslam::features
