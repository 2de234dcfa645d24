#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/geometry/depth_cells.hpp"
#include "dynslam/geometry/depth_consistency.hpp"

#include "geometry/synthetic.hpp"

namespace dynslam::geometry {
namespace {

using synthetic::kNaN;

class DepthCellsOfWidth : public testing::TestWithParam<int> {};

TEST_P(DepthCellsOfWidth, HoldNearestAndFarthestOfCellAndNeighbours) {
  const int width = GetParam();
  const PinholeCamera camera{100, 100, 10, 6, width, 13};
  std::vector<float> image(static_cast<std::size_t>(width) * 13);
  std::uint32_t state = 1;
  for (float& z : image) {
    state = state * 1664525U + 1013904223U;
    z = (state >> 28) == 0 ? 0.0F : 1.0F + static_cast<float>(state >> 8) * 1e-7F;
  }
  DepthCellsOptions options;
  options.min_valid = 0.3;
  DepthCells cells;
  build_depth_cells({image.data(), width, 13}, camera, options, cells);
  ASSERT_EQ(cells.width, (width + 3) / 4);
  ASSERT_EQ(cells.height, 4);
  for (int cy = 0; cy < 4; ++cy) {
    for (int cx = 0; cx < cells.width; ++cx) {
      float nearest = 1e9F, farthest = 0.0F;
      int count = 0;
      for (int y = std::max(0, 4 * cy - 4); y < std::min(13, 4 * cy + 8); ++y) {
        for (int x = std::max(0, 4 * cx - 4); x < std::min(width, 4 * cx + 8); ++x) {
          const float z = image[static_cast<std::size_t>(y * width + x)];
          if (z <= 0.0F) continue;
          ++count;
          nearest = std::min(nearest, z);
          farthest = std::max(farthest, z);
        }
      }
      const bool known = count >= std::ceil(0.3 * 9 * 16);
      const std::size_t i = static_cast<std::size_t>(cy * cells.width + cx);
      EXPECT_EQ(cells.near_depth[i], known ? nearest : 0.0F);
      EXPECT_EQ(cells.far_depth[i], known ? farthest : 0.0F);
    }
  }
}

// Less than what is summarized together, that, and one and a half of it.
INSTANTIATE_TEST_SUITE_P(Widths, DepthCellsOfWidth, testing::Values(22, 64, 97));

TEST(DepthCells, KnowNothingOfHolesAndTreatNaNAndInfinityAsHoles) {
  for (const float hole : {0.0F, -1.0F, kNaN, std::numeric_limits<float>::infinity()}) {
    const std::vector<float> image(640 * 480, hole);
    DepthCells cells;
    build_depth_cells({image.data(), 640, 480}, synthetic::kCamera, {}, cells);
    for (const float z : cells.near_depth) ASSERT_EQ(z, 0.0F);
    for (const float z : cells.far_depth) ASSERT_EQ(z, 0.0F);
  }
}

TEST(DepthCells, RefuseWhatDoesNotFit) {
  const std::vector<float> image(640 * 480, 1.0F);
  const std::vector<std::uint8_t> mask(640 * 480, 0);
  const ImageView<const float> view(image.data(), 640, 480);
  DepthCells cells;
  EXPECT_THROW(build_depth_cells({image.data(), 320, 480}, synthetic::kCamera, {}, cells),
               InvalidArgument);
  EXPECT_THROW(build_depth_cells({image.data(), 640, 240}, synthetic::kCamera, {}, cells),
               InvalidArgument);
  EXPECT_THROW(build_depth_cells({}, synthetic::kCamera, {}, cells), InvalidArgument);
  EXPECT_THROW(build_depth_cells(view, synthetic::kCamera, {mask.data(), 320, 240}, {}, cells),
               InvalidArgument);
  EXPECT_THROW(build_depth_cells(view, synthetic::kCamera, {0, 0.5}, cells), InvalidArgument);
  EXPECT_THROW(build_depth_cells(view, synthetic::kCamera, {65, 0.5}, cells), InvalidArgument);
  EXPECT_THROW(build_depth_cells(view, synthetic::kCamera, {4, 0.0}, cells), InvalidArgument);
  EXPECT_THROW(build_depth_cells(view, synthetic::kCamera, {4, 1.1}, cells), InvalidArgument);
  EXPECT_TRUE(cells.empty());
}

struct Judged {
  DepthEvidence evidence;
  double dynamic_in(const std::vector<std::uint8_t>& truth) const { return share(truth, 255); }
  double dynamic_out(const std::vector<std::uint8_t>& truth) const { return share(truth, 0); }
  double share(const std::vector<std::uint8_t>& truth, std::uint8_t label) const {
    double hit = 0, all = 0;
    for (int y = 0; y < evidence.height; ++y) {
      for (int x = 0; x < evidence.width; ++x) {
        if (truth[static_cast<std::size_t>((4 * y + 2) * 640 + 4 * x + 2)] != label) continue;
        ++all;
        hit +=
            evidence.verdict[static_cast<std::size_t>(y * evidence.width + x)] == Verdict::kDynamic
                ? 1
                : 0;
      }
    }
    return hit / all;
  }
};

/// The room seen now against the same room seen from `T_ref_world`, with a box at `then` and `now`.
Judged judge(const RigidTransform& T_ref_world, const synthetic::Box& then,
             const synthetic::Box& now, std::vector<std::uint8_t>& truth,
             const DepthConsistencyOptions& options = {}) {
  std::vector<std::uint8_t> unused;
  const std::vector<float> before = synthetic::render(T_ref_world, then, unused);
  const std::vector<float> after = synthetic::render({}, now, truth);
  DepthCells cells;
  build_depth_cells({before.data(), 640, 480}, synthetic::kCamera, {}, cells);
  const DepthReference reference{T_ref_world.inverse(), &cells, 1.0};
  Judged judged;
  judge_depth({after.data(), 640, 480}, synthetic::kCamera,
              Span<const DepthReference>(&reference, 1), options, judged.evidence);
  return judged;
}

TEST(DepthConsistency, FindsNoMoverInAStaticRoomFromAnyView) {
  const synthetic::Box box{{0.2, 0.0, 1.6}, {0.3, 0.4, 0.1}};
  std::vector<std::uint8_t> truth;
  for (const Eigen::Vector3d& t :
       {Eigen::Vector3d(0.3, 0, 0), Eigen::Vector3d(-0.1, 0.1, 0.3), Eigen::Vector3d(0, 0, 0)}) {
    const Judged judged = judge({so3_exp({0.02, 0.1, -0.05}), t}, box, box, truth);
    EXPECT_EQ(judged.evidence.dynamic_cells, 0);
    EXPECT_GT(judged.evidence.static_cells, 9000);
    EXPECT_EQ(judged.evidence.static_share(), 1.0);
  }
}

TEST(DepthConsistency, FindsASurfaceThatArrivedAndSparesTheOneItRevealed) {
  const synthetic::Box then{{-0.6, 0.0, 1.6}, {0.25, 0.4, 0.1}};
  const synthetic::Box now{{0.4, 0.0, 1.6}, {0.25, 0.4, 0.1}};
  std::vector<std::uint8_t> truth;
  const Judged judged = judge({so3_exp({0, 0.05, 0}), {0.1, 0, 0}}, then, now, truth);
  EXPECT_GT(judged.dynamic_in(truth), 0.9);
  EXPECT_LT(judged.dynamic_out(truth), 0.001);
}

TEST(DepthConsistency, DoesNotAccuseWhatWasHiddenBehindAMover) {
  const synthetic::Box then{{0.0, 0.0, 1.2}, {0.3, 0.3, 0.1}};
  const synthetic::Box gone{{0.0, 0.0, -9.0}, {0.3, 0.3, 0.1}};
  std::vector<std::uint8_t> truth;
  const Judged judged = judge({}, then, gone, truth);
  EXPECT_EQ(judged.evidence.dynamic_cells, 0);
  EXPECT_GT(judged.evidence.unknown_cells, 1000);
}

TEST(DepthConsistency, SaysWhyOfASinglePoint) {
  const std::vector<float> image(640 * 480, 2.0F);
  DepthCells cells;
  build_depth_cells({image.data(), 640, 480}, synthetic::kCamera, {}, cells);
  const DepthReference reference{{}, &cells, 1.0};
  const Span<const DepthReference> one(&reference, 1);
  const auto reason = [&](double x, double z) { return judge_point({x, 0, z}, one, {}).reason; };
  EXPECT_EQ(reason(0, 1.5), Reason::kFreeSpaceViolated);
  EXPECT_EQ(reason(0, 2.0), Reason::kConsistent);
  EXPECT_EQ(reason(0, 3.0), Reason::kOccluded);
  EXPECT_EQ(reason(9, 2.0), Reason::kNoReference);
  EXPECT_EQ(reason(0, 0.5), Reason::kOccluded);  // nearer than the sensor measures
  EXPECT_EQ(reason(kNaN, 2.0), Reason::kNotFinite);
  EXPECT_NEAR(judge_point({0, 0, 1.5}, one, {}).delta, 0.5, 1e-6);
  EXPECT_EQ(judge_point({0, 0, 1.5}, {}, {}).reason, Reason::kNoReference);
}

TEST(DepthConsistency, GivesStaticVotesOfYoungReferencesLessWeight) {
  const std::vector<float> image(640 * 480, 2.0F);
  DepthCells cells;
  build_depth_cells({image.data(), 640, 480}, synthetic::kCamera, {}, cells);
  DepthReference reference{{}, &cells, 1.0};
  const float old = judge_point({0, 0, 2}, Span<const DepthReference>(&reference, 1), {}).log_odds;
  reference.age = 0.25;
  const float young =
      judge_point({0, 0, 2}, Span<const DepthReference>(&reference, 1), {}).log_odds;
  EXPECT_NEAR(young, 0.25F * old, 1e-6F);
}

TEST(DepthConsistency, LetsAReferenceForgetWhatMovedInIt) {
  const std::vector<float> image(640 * 480, 2.0F);
  const std::vector<std::uint8_t> mask(640 * 480, 255);
  DepthCells cells;
  build_depth_cells({image.data(), 640, 480}, synthetic::kCamera, {mask.data(), 640, 480}, {},
                    cells);
  const DepthReference reference{{}, &cells, 1.0};
  const Span<const DepthReference> one(&reference, 1);
  EXPECT_EQ(judge_point({0, 0, 1.5}, one, {}).verdict, Verdict::kUnknown);
  EXPECT_LT(judge_point({0, 0, 2.0}, one, {}).log_odds, 0.0F);
}

TEST(DepthConsistency, ForgivesPoseErrorsOfATracker) {
  const synthetic::Box box{{0.2, 0.0, 1.6}, {0.3, 0.4, 0.1}};
  std::vector<std::uint8_t> truth, unused;
  const std::vector<float> before = synthetic::render({}, box, unused);
  DepthCells cells;
  build_depth_cells({before.data(), 640, 480}, synthetic::kCamera, {}, cells);
  const std::vector<float> after = synthetic::render({}, box, truth);
  Vector6d error;
  error << 0.006, -0.006, 0.006, 0.004, -0.004, 0.004;
  const DepthReference reference{se3_exp(error), &cells, 1.0};
  DepthEvidence evidence;
  judge_depth({after.data(), 640, 480}, synthetic::kCamera,
              Span<const DepthReference>(&reference, 1), {}, evidence);
  EXPECT_LT(evidence.dynamic_cells, 0.01 * evidence.static_cells);
}

TEST(DepthConsistency, KnowsNothingWithoutReferencesOrDepth) {
  const std::vector<float> wall(640 * 480, 2.0F), none(640 * 480, 0.0F);
  DepthEvidence evidence;
  judge_depth({wall.data(), 640, 480}, synthetic::kCamera, {}, {}, evidence);
  EXPECT_EQ(evidence.unknown_cells, 160 * 120);
  EXPECT_EQ(evidence.static_share(), 0.0);
  DepthCells cells;
  build_depth_cells({wall.data(), 640, 480}, synthetic::kCamera, {}, cells);
  DepthReference references[3] = {{{}, &cells, 1.0}, {{}, nullptr, 1.0}, {{}, &cells, 1.0}};
  references[2].T_cur_ref.t.x() = kNaN;
  judge_depth({none.data(), 640, 480}, synthetic::kCamera, references, {}, evidence);
  EXPECT_EQ(evidence.unknown_cells + evidence.static_cells + evidence.dynamic_cells, 0);
  judge_depth({wall.data(), 640, 480}, synthetic::kCamera, references, {}, evidence);
  // The one that can be asked says static, but for the corners, of which it saw too little.
  EXPECT_EQ(evidence.static_cells, 160 * 120 - 4);
  EXPECT_NEAR(evidence.log_odds[200], -0.7F, 1e-6F);
}

TEST(DepthConsistency, JudgesFeaturesAsPoints) {
  const std::vector<float> image(640 * 480, 2.0F);
  DepthCells cells;
  build_depth_cells({image.data(), 640, 480}, synthetic::kCamera, {}, cells);
  const DepthReference reference{{}, &cells, 1.0};
  const std::vector<Eigen::Vector2f> pixels{{100, 100}, {200, 100}, {300, 100}, {kNaN, 0}};
  const std::vector<float> depths{2.0F, 1.4F, 0.0F, 1.0F};
  FeaturesView features;
  features.pixels = pixels;
  features.depths = depths;
  std::vector<FeatureVerdict> out(4);
  const Span<const DepthReference> one(&reference, 1);
  judge_features(synthetic::kCamera, features, one, {}, out);
  EXPECT_EQ(out[0].verdict, Verdict::kStatic);
  EXPECT_EQ(out[1].verdict, Verdict::kDynamic);
  EXPECT_EQ(out[2].reason, Reason::kNoDepth);
  EXPECT_EQ(out[3].reason, Reason::kNotFinite);
  EXPECT_THROW(judge_features(synthetic::kCamera, features, one, {}, Span(out).subspan(0, 1)),
               InvalidArgument);
  features.depths = Span<const float>(depths).subspan(0, 1);
  EXPECT_THROW(judge_features(synthetic::kCamera, features, one, {}, out), InvalidArgument);
}

TEST(DepthConsistency, RefusesEachInvalidOption) {
  using O = DepthConsistencyOptions;
  EXPECT_NO_THROW(O().validate());
  for (double O::*member : {&O::threshold, &O::max_spread, &O::dynamic_evidence,
                            &O::static_evidence, &O::settle_time}) {
    O options;
    options.*member = 0.0;
    EXPECT_THROW(options.validate(), InvalidArgument);
  }
  for (double O::*member : {&O::depth_floor, &O::relative_floor, &O::decision, &O::min_range}) {
    O options;
    options.*member = -0.1;
    EXPECT_THROW(options.validate(), InvalidArgument);
  }
  for (const int stride : {0, 65}) {
    O options;
    options.stride = stride;
    EXPECT_THROW(options.validate(), InvalidArgument);
  }
  const std::vector<float> image(640 * 480, 2.0F);
  DepthEvidence evidence;
  EXPECT_THROW(judge_depth({image.data(), 640, 240}, synthetic::kCamera, {}, {}, evidence),
               InvalidArgument);
  EXPECT_THROW(judge_depth({image.data(), 320, 480}, synthetic::kCamera, {}, {}, evidence),
               InvalidArgument);
  EXPECT_THROW(judge_depth({}, synthetic::kCamera, {}, {}, evidence), InvalidArgument);
}

TEST(LookBatch, VotesAsEachLookByItself) {
  const PinholeCamera camera{50, 50, 20, 15, 41, 31};
  std::uint32_t state = 5;
  const auto next = [&] {
    return static_cast<float>((state = state * 1664525U + 1013904223U) >> 8);
  };
  std::vector<float> image(41 * 31);
  for (std::size_t i = 0; i < image.size(); ++i) {
    image[i] = 1.0F + static_cast<float>(i % 41 / 14) + next() * 1e-9F;  // three steps
  }
  std::vector<std::uint8_t> mask(image.size(), 0);
  std::fill(mask.begin(), mask.begin() + 300, 255);
  DepthCells cells;
  build_depth_cells({image.data(), 41, 31}, camera, {mask.data(), 41, 31}, {2, 0.6}, cells);
  const detail::Outlook outlook(cells);
  const detail::MarginModel model(DepthConsistencyOptions{});
  detail::LookBatch batch;
  int still = 0, arrived = 0;
  for (int row = 0; row < 100; ++row) {
    float z[20];
    for (float& each : z) each = next() < 3e6F ? 0.0F : next() * 3e-7F;
    const Eigen::Vector3f origin(-0.5F, -0.4F + 0.008F * static_cast<float>(row), 1.0F);
    const Eigen::Vector3f step(0.05F, 0.001F, 0.0F), t(0.02F, 0.01F, -0.05F);
    float log_odds[20] = {};
    batch.project(z, 20, 3, origin, step, t, outlook);
    batch.look_up(outlook);
    batch.vote(model, 2.0F, 0.7F, 20, log_odds);
    for (int i = 0; i < 20; ++i) {
      detail::SightTally tally;
      const Eigen::Vector3f P = z[i] * (origin + static_cast<float>(3 + i) * step) + t;
      if (z[i] > 0.0F) tally.add(detail::look(P, z[i], outlook, model), 2.0F, 0.7F);
      EXPECT_EQ(log_odds[i], tally.log_odds) << row << " " << i;
      still += tally.seen;
      arrived += tally.through;
    }
  }
  EXPECT_GT(still, 30);
  EXPECT_GT(arrived, 100);
}

}  // namespace
TEST(Outlook, FindsTheCellOfEveryPixelWithoutADivision) {
  DepthCells cells;
  for (cells.cell = 1; cells.cell <= 64; ++cells.cell) {
    const detail::Outlook outlook(cells);
    for (int pixel = 0; pixel < 65536; ++pixel) {
      ASSERT_EQ(outlook.cell_of(static_cast<float>(pixel)),
                static_cast<std::size_t>(pixel / cells.cell))
          << pixel << " / " << cells.cell;
    }
  }
}

}  // namespace dynslam::geometry
