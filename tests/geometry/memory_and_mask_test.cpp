#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/geometry/mask_evidence.hpp"
#include "dynslam/geometry/region_grow.hpp"
#include "dynslam/geometry/static_memory.hpp"

#include "geometry/synthetic.hpp"

namespace dynslam::geometry {
namespace {

/// Cells of a depth image, all without an opinion.
DepthEvidence cells_of(const std::vector<float>& depth) {
  DepthEvidence evidence;
  judge_depth({depth.data(), 640, 480}, synthetic::kCamera, {}, {}, evidence);
  return evidence;
}

void set_cells(DepthEvidence& evidence, const std::vector<std::uint8_t>& mask, float in,
               float out) {
  for (int y = 0; y < evidence.height; ++y) {
    for (int x = 0; x < evidence.width; ++x) {
      const bool inside = mask[static_cast<std::size_t>((4 * y + 2) * 640 + 4 * x + 2)] != 0;
      evidence.log_odds[static_cast<std::size_t>(y * evidence.width + x)] = inside ? in : out;
    }
  }
}

double share(const std::vector<std::uint8_t>& mask, const std::vector<std::uint8_t>& truth,
             std::uint8_t label) {
  double hit = 0, all = 0;
  for (std::size_t i = 0; i < mask.size(); ++i) {
    if (truth[i] != label) continue;
    ++all;
    hit += mask[i] != 0 ? 1 : 0;
  }
  return hit / all;
}

const synthetic::Box kPerson{{0.2, 0.1, 1.6}, {0.3, 0.7, 0.1}};

TEST(CellMemory, CarriesEvidenceToWhereTheCameraSeesItNow) {
  std::vector<std::uint8_t> then_mask, now_mask;
  const RigidTransform T_now_world(so3_exp({0, 0.1, 0}), {0.1, 0, 0});
  const auto then = synthetic::render({}, kPerson, then_mask);
  const auto now = synthetic::render(T_now_world, kPerson, now_mask);
  DepthEvidence evidence = cells_of(then);
  set_cells(evidence, then_mask, 2.0F, -1.0F);
  CellMemory memory;
  memory.update(synthetic::kCamera, {}, 0.0, 0.6, evidence);
  evidence = cells_of(now);
  memory.update(synthetic::kCamera, T_now_world.inverse(), 0.1, 0.6, evidence);
  int right = 0, wrong = 0;
  for (int y = 0; y < evidence.height; ++y) {
    for (int x = 0; x < evidence.width; ++x) {
      const float l = evidence.log_odds[static_cast<std::size_t>(y * evidence.width + x)];
      const bool inside = now_mask[static_cast<std::size_t>((4 * y + 2) * 640 + 4 * x + 2)] != 0;
      (l > 0.0F) == inside ? right += l != 0.0F : wrong += l != 0.0F;
    }
  }
  EXPECT_GT(right, 9000);
  EXPECT_LT(wrong, right / 100);
  EXPECT_GT(evidence.dynamic_cells, 1000);
  memory.clear();
  evidence = cells_of(now);
  memory.update(synthetic::kCamera, T_now_world.inverse(), 0.2, 0.6, evidence);
  EXPECT_EQ(evidence.dynamic_cells, 0);
}

TEST(CellMemory, RefusesOtherCamerasAndBrokenPoses) {
  DepthEvidence evidence = cells_of(std::vector<float>(640 * 480, 2.0F));
  CellMemory memory;
  RigidTransform broken;
  broken.t.x() = std::nan("");
  EXPECT_THROW(memory.update(synthetic::kCamera, broken, 0, 0.6, evidence), InvalidArgument);
  PinholeCamera other = synthetic::kCamera;
  other.width = 320;
  EXPECT_THROW(memory.update(other, {}, 0, 0.6, evidence), InvalidArgument);
}

class RegionGrow : public ::testing::Test {
 protected:
  RegionGrow() : depth_(synthetic::render({}, kPerson, truth_)), evidence_(cells_of(depth_)) {}

  double grow(const RegionGrowOptions& options = {}, Pixels pixels = {},
              Span<const FeatureVerdict> verdicts = {}) {
    mask_.assign(depth_.size(), 77);
    return grow_regions({depth_.data(), 640, 480}, evidence_, pixels, verdicts, options, workspace_,
                        {mask_.data(), 640, 480});
  }

  std::vector<std::uint8_t> truth_, mask_;
  std::vector<float> depth_;
  DepthEvidence evidence_;
  RegionGrowWorkspace workspace_;
};

TEST_F(RegionGrow, FillsTheMoverToItsEdgesFromHalfOfItsCells) {
  // Left half seen to move, right half looks static, the room is static.
  set_cells(evidence_, truth_, 2.0F, -1.0F);
  for (int y = 0; y < evidence_.height; ++y) {
    for (int x = 92; x < evidence_.width; ++x) {
      float& l = evidence_.log_odds[static_cast<std::size_t>(y * evidence_.width + x)];
      if (l > 0.0F) l = 0.0F;
    }
  }
  const double covered = grow();
  EXPECT_GT(share(mask_, truth_, 255), 0.97);
  EXPECT_LT(share(mask_, truth_, 0), 0.01);
  EXPECT_NEAR(covered, std::count(mask_.begin(), mask_.end(), 255) / (640.0 * 480.0), 1e-12);
  EXPECT_EQ(std::count(mask_.begin(), mask_.end(), 0) + std::count(mask_.begin(), mask_.end(), 255),
            640 * 480);
}

TEST_F(RegionGrow, APatchThatIsKnownFillsItsRegionUnlessMoreHasToBeKnown) {
  set_cells(evidence_, truth_, 0.0F, -1.0F);
  const std::size_t middle = static_cast<std::size_t>(70 * evidence_.width + 80);
  ASSERT_NE(truth_[282 * 640 + 322], 0);
  for (std::size_t x = 0; x < 5; ++x) {
    for (std::size_t y = 0; y < 5; ++y) evidence_.log_odds[middle + y * 160 + x] = 2.0F;
  }
  RegionGrowOptions options;
  options.reach = 0.02;
  grow(options);
  EXPECT_GT(share(mask_, truth_, 255), 0.97);
  options.known_share = 0.7;
  grow(options);
  EXPECT_LT(share(mask_, truth_, 255), 0.5);
  EXPECT_EQ(mask_[290 * 640 + 330], 255);
  const double sure = share(mask_, truth_, 255);
  options.doubt = 1.0;
  grow(options);
  EXPECT_LT(share(mask_, truth_, 255), sure);
  EXPECT_EQ(mask_[290 * 640 + 330], 255);
}

TEST_F(RegionGrow, DoesNotSwallowFloorAndWalls) {
  set_cells(evidence_, truth_, 2.0F, 0.0F);  // nothing is known of the room
  grow();
  EXPECT_GT(share(mask_, truth_, 255), 0.97);
  EXPECT_LT(share(mask_, truth_, 0), 0.02);
}

TEST_F(RegionGrow, ABandWithoutDepthGoesToWhatItLooksLike) {
  // Depth is missing 3 pixels to both sides of every contour of the mover.
  std::vector<std::uint8_t> guide(truth_.size());
  std::vector<float> holes = depth_;
  for (int y = 3; y < 477; ++y) {
    for (int x = 3; x < 637; ++x) {
      const auto at = static_cast<std::size_t>(y * 640 + x);
      if (truth_[at - 3] != truth_[at + 3]) holes[at] = 0.0F;
    }
  }
  for (std::size_t i = 0; i < guide.size(); ++i) guide[i] = truth_[i] != 0 ? 160 : 60;
  depth_ = holes;
  evidence_ = cells_of(depth_);
  set_cells(evidence_, truth_, 2.0F, -1.0F);
  grow();
  const double plain = share(mask_, truth_, 255);
  grow_regions({depth_.data(), 640, 480}, evidence_, {}, {}, {}, workspace_,
               {mask_.data(), 640, 480}, {guide.data(), 640, 480});
  EXPECT_GT(share(mask_, truth_, 255), plain + 0.005);
  EXPECT_GT(share(mask_, truth_, 255), 0.985);
  EXPECT_LT(share(mask_, truth_, 0), 0.005);
  EXPECT_THROW(grow_regions({depth_.data(), 640, 480}, evidence_, {}, {}, {}, workspace_,
                            {mask_.data(), 640, 480}, {guide.data(), 640, 240}),
               InvalidArgument);
}

// A table's edge 0.9 m away hides rows 260 to 299.
class RegionGrowBehindATable : public RegionGrow {
 protected:
  RegionGrowBehindATable() {
    const std::size_t first = 260 * 640, last = 300 * 640;
    std::fill(depth_.begin() + first, depth_.begin() + last, 0.9F);
    std::fill(truth_.begin() + first, truth_.begin() + last, std::uint8_t{0});
  }
  bool masked(int x, int y) const { return mask_[static_cast<std::size_t>(y * 640 + x)] != 0; }
  float& depth(int x, int y) { return depth_[static_cast<std::size_t>(y * 640 + x)]; }
};

TEST_F(RegionGrowBehindATable, LegsTakeAfterTheBodyAboveIt) {
  evidence_ = cells_of(depth_);
  set_cells(evidence_, truth_, 2.0F, -1.0F);
  std::vector<std::uint8_t> legs = truth_;
  std::fill(legs.begin(), legs.begin() + 300 * 640, std::uint8_t{0});
  for (int y = 75; y < evidence_.height; ++y) {  // never seen before
    for (int x = 0; x < evidence_.width; ++x) {
      float& l = evidence_.log_odds[static_cast<std::size_t>(y * evidence_.width + x)];
      if (l > 0.0F) l = 0.0F;
    }
  }
  grow();
  EXPECT_GT(share(mask_, legs, 255), 0.95);
  EXPECT_LT(share(mask_, truth_, 0), 0.02);
  RegionGrowOptions alone;
  alone.completion = 0.0;
  grow(alone);
  EXPECT_LT(share(mask_, legs, 255), 0.05);
}

TEST_F(RegionGrowBehindATable, AGapSmallerThanACellShowsWhatIsBehind) {
  depth(400, 280) = depth(401, 280) = depth(400, 281) = depth(401, 281) = depth(400, 200);  // body
  depth(100, 280) = depth(101, 280) = depth(100, 281) = depth(101, 281) = depth(100, 200);  // wall
  evidence_ = cells_of(depth_);
  set_cells(evidence_, truth_, 2.0F, -1.0F);
  grow();
  EXPECT_TRUE(masked(400, 280) && masked(401, 281));
  EXPECT_FALSE(masked(398, 280) || masked(404, 280));
  EXPECT_FALSE(masked(100, 280) || masked(101, 281));
}

TEST_F(RegionGrow, WhatStandsBesideAMoverIsNoPartOfIt) {
  // A cupboard that touches the mover, 8 cm farther away; nothing is known of it.
  std::vector<std::uint8_t> cupboard(truth_.size());
  const float z = depth_[300 * 640 + 400] + 0.08F;
  for (int y = 200; y < 400; ++y) {
    for (int x = 420; x < 560; ++x) {
      const auto at = static_cast<std::size_t>(y * 640 + x);
      if (truth_[at] != 0) continue;
      depth_[at] = z;
      cupboard[at] = 255;
    }
  }
  evidence_ = cells_of(depth_);
  set_cells(evidence_, truth_, 2.0F, -1.0F);
  for (int y = 50; y < 100; ++y) {
    for (int x = 105; x < 140; ++x) {
      float& l = evidence_.log_odds[static_cast<std::size_t>(y * evidence_.width + x)];
      if (cupboard[static_cast<std::size_t>((4 * y + 2) * 640 + 4 * x + 2)] != 0) l = 0.0F;
    }
  }
  grow();
  EXPECT_GT(share(mask_, truth_, 255), 0.97);
  EXPECT_LT(share(mask_, cupboard, 255), 0.02);
}

TEST_F(RegionGrow, FitsAMaskToTheDepth) {
  // A network's mask, six pixels too far to the left; of the mover nothing else is known.
  std::vector<std::uint8_t> shifted(truth_.size());
  std::copy(truth_.begin() + 6, truth_.end(), shifted.begin());
  set_cells(evidence_, truth_, 0.0F, -1.0F);
  add_mask({depth_.data(), 640, 480}, {shifted.data(), 640, 480}, {}, evidence_);
  grow();
  EXPECT_GT(share(mask_, truth_, 255), 0.97);
  EXPECT_LT(share(mask_, truth_, 0), 0.01);
}

TEST_F(RegionGrow, AMaskHoldsWhereThereIsNoDepth) {
  std::fill(depth_.begin(), depth_.end(), 0.0F);
  evidence_ = cells_of(depth_);
  add_mask({depth_.data(), 640, 480}, {truth_.data(), 640, 480}, {}, evidence_);
  grow();
  EXPECT_GT(share(mask_, truth_, 255), 0.95);
  EXPECT_LT(share(mask_, truth_, 0), 0.05);
}

TEST_F(RegionGrow, WhatIsNotUnderTheMaskKeepsItsEvidence) {
  set_cells(evidence_, truth_, 0.0F, -1.0F);
  const std::vector<float> before = evidence_.log_odds;
  const std::vector<std::uint8_t> nothing(truth_.size());
  add_mask({depth_.data(), 640, 480}, {nothing.data(), 640, 480}, {}, evidence_);
  EXPECT_EQ(evidence_.log_odds, before);
}

TEST_F(RegionGrow, AMaskSpeaksAgainstWhatIsJustOutsideOfIt) {
  set_cells(evidence_, truth_, 0.0F, 0.0F);
  std::vector<std::uint8_t> mask(truth_.size());
  for (int y = 200; y < 280; ++y) {
    std::fill_n(&mask[static_cast<std::size_t>(y * 640 + 300)], 40, std::uint8_t{255});
  }
  MaskEvidenceOptions options;
  options.under = 2.0;
  options.beside = 0.5;
  options.margin = 8;
  add_mask({depth_.data(), 640, 480}, {mask.data(), 640, 480}, options, evidence_);
  const auto at = [&](int x, int y) {
    return evidence_.log_odds[static_cast<std::size_t>(y / 4 * evidence_.width + x / 4)];
  };
  EXPECT_FLOAT_EQ(at(300, 240), 2.0F);
  EXPECT_FLOAT_EQ(at(336, 240), 2.0F);
  for (const int beside : {292, 296, 340, 344}) EXPECT_FLOAT_EQ(at(beside, 240), -0.5F) << beside;
  for (const int beside : {192, 196, 280, 284}) EXPECT_FLOAT_EQ(at(320, beside), -0.5F) << beside;
  for (const int away : {288, 348}) EXPECT_FLOAT_EQ(at(away, 240), 0.0F) << away;
}

TEST_F(RegionGrow, RefusesMasksThatDoNotFit) {
  const ImageView<const float> depth{depth_.data(), 640, 480};
  const MaskView mask{truth_.data(), 640, 480};
  EXPECT_THROW(add_mask(depth, {truth_.data(), 320, 480}, {}, evidence_), InvalidArgument);
  evidence_.width = 80;
  EXPECT_THROW(add_mask(depth, mask, {}, evidence_), InvalidArgument);
}

TEST(MaskEvidenceOptions, RefusesEachInvalidOption) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const auto expect_refused = [](auto member, auto value) {
    MaskEvidenceOptions options;
    options.*member = value;
    EXPECT_THROW(options.validate(), InvalidArgument) << value;
  };
  MaskEvidenceOptions().validate();
  for (const double bad : {0.0, -1.0, kInfinity, std::nan("")}) {
    expect_refused(&MaskEvidenceOptions::under, bad);
  }
  for (const double bad : {-0.1, kInfinity, std::nan("")}) {
    expect_refused(&MaskEvidenceOptions::beside, bad);
  }
  for (const int bad : {0, 65}) expect_refused(&MaskEvidenceOptions::margin, bad);
}

TEST_F(RegionGrow, DropsSpeckles) {
  set_cells(evidence_, truth_, -1.0F, -1.0F);
  for (const int i : {3000, 3001, 9000}) {
    evidence_.log_odds[static_cast<std::size_t>(i)] = 2.0F;
  }
  EXPECT_EQ(grow(), 0.0);
}

TEST_F(RegionGrow, GrowsFromFeaturesToo) {
  std::vector<Eigen::Vector2f> pixels;
  std::vector<FeatureVerdict> verdicts;
  for (int y = 180; y < 480; y += 30) {
    for (int x = 310; x < 460; x += 30) {
      pixels.emplace_back(static_cast<float>(x), static_cast<float>(y));
      FeatureVerdict v;
      v.verdict = Verdict::kDynamic;
      v.log_odds = 2.0F;
      verdicts.push_back(v);
    }
  }
  pixels.emplace_back(std::nanf(""), 3.0F);
  verdicts.push_back(verdicts.front());
  EXPECT_EQ(grow(), 0.0);
  grow({}, pixels, verdicts);
  EXPECT_GT(share(mask_, truth_, 255), 0.8);
  EXPECT_LT(share(mask_, truth_, 0), 0.02);
}

TEST_F(RegionGrow, DilatesBySquares) {
  set_cells(evidence_, truth_, 2.0F, -1.0F);
  grow();
  const std::vector<std::uint8_t> thin = mask_;
  RegionGrowOptions options;
  options.dilate = 5;
  grow(options);
  for (int y = 0; y < 480; y += 3) {
    for (int x = 0; x < 640; ++x) {
      bool set = false;
      for (int v = std::max(0, y - 5); v <= std::min(479, y + 5) && !set; ++v) {
        for (int u = std::max(0, x - 5); u <= std::min(639, x + 5) && !set; ++u) {
          set = thin[static_cast<std::size_t>(v * 640 + u)] != 0;
        }
      }
      ASSERT_EQ(mask_[static_cast<std::size_t>(y * 640 + x)] != 0, set) << x << " " << y;
    }
  }
}

TEST_F(RegionGrow, MasksNothingWithoutDepthOrEvidence) {
  EXPECT_EQ(grow(), 0.0);
  std::fill(depth_.begin(), depth_.end(), 0.0F);
  evidence_ = cells_of(depth_);
  EXPECT_EQ(grow(), 0.0);
}

TEST_F(RegionGrow, RefusesSizesThatDoNotFit) {
  const auto call = [&](int width, int height) {
    std::vector<std::uint8_t> mask(640 * 480, 9);
    grow_regions({depth_.data(), 640, 480}, evidence_, {}, {}, {}, workspace_,
                 {mask.data(), width, height});
  };
  EXPECT_THROW(call(320, 480), InvalidArgument);
  EXPECT_THROW(call(640, 240), InvalidArgument);
  const std::vector<Eigen::Vector2f> one(1);
  EXPECT_THROW(grow({}, one, {}), InvalidArgument);
  EXPECT_EQ(mask_[0], 77);
  evidence_.width = 80;
  EXPECT_THROW(grow(), InvalidArgument);
}

TEST_F(RegionGrow, RefusesEachInvalidOption) {
  using O = RegionGrowOptions;
  for (double O::*member : {&O::jump, &O::reach, &O::fill_share, &O::max_fill, &O::decision}) {
    O options;
    options.*member = 0.0;
    EXPECT_THROW(grow(options), InvalidArgument);
  }
  for (double O::*member : {&O::fill_share, &O::known_share, &O::max_fill}) {
    O options;
    options.*member = 1.01;
    EXPECT_THROW(grow(options), InvalidArgument);
  }
  O options;
  options.min_cells = 0;
  EXPECT_THROW(grow(options), InvalidArgument);
  options = O();
  options.dilate = -1;
  EXPECT_THROW(grow(options), InvalidArgument);
  options = O();
  options.feature_weight = -1.0;
  EXPECT_THROW(grow(options), InvalidArgument);
  options = O();
  options.known_share = -0.1;
  EXPECT_THROW(grow(options), InvalidArgument);
  options = O();
  options.doubt = -0.1;
  EXPECT_THROW(grow(options), InvalidArgument);
  options = O();
  options.completion = -1.0;
  EXPECT_THROW(grow(options), InvalidArgument);
}

TEST(HoleVoters, AreTheNearestPixelsWithDepthInEachDirection) {
  constexpr int kWidth = 37, kHeight = 29;
  std::vector<float> image(kWidth * kHeight);
  std::uint32_t state = 3;
  for (float& z : image) z = (state = state * 1664525U + 1013904223U) >> 28 == 0 ? 1.5F : 0.0F;
  const ImageView<const float> depth(image.data(), kWidth, kHeight);
  detail::KnownPixels known;
  known.fill(depth);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const detail::HoleVoters voters(known.at(x, y), known.pitch);
      for (int d = 0; d < 8; ++d) {
        const int dx = detail::HoleVoters::kSteps[d][0], dy = detail::HoleVoters::kSteps[d][1];
        int nearest = 0;
        for (int i = 10; i >= 1; --i) {
          const int u = x + i * dx, v = y + i * dy;
          if (depth.contains(u, v) && depth(u, v) > 0.0F) nearest = i;
        }
        ASSERT_EQ(voters.away[d][0], nearest) << x << " " << y << " " << d;
      }
    }
  }
}

}  // namespace
}  // namespace dynslam::geometry
