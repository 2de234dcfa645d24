#include "dynslam/geometry/static_memory.hpp"

#include <cmath>
#include <cstdint>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

namespace dynslam::geometry {
namespace {

TEST(StaticMemory, RemembersAMoverAndForgivesAParkedCar) {
  StaticMemory memory;
  for (int i = 0; i < 4; ++i) memory.update(7, 2.0, 0.1 * i);
  EXPECT_EQ(memory.verdict(7, 0.4), Verdict::kDynamic);
  memory.update(7, 0.0, 0.5);  // no test could be made
  EXPECT_EQ(memory.verdict(7, 0.5), Verdict::kDynamic);
  double time = 0.5;
  int frames = 0;
  while (memory.verdict(7, time) != Verdict::kStatic && frames < 100) {
    time += 0.1;
    memory.update(7, -0.7, time);
    ++frames;
  }
  EXPECT_GE(frames, 3);
  EXPECT_LE(frames, 15);
}

TEST(StaticMemory, HalvesInItsHalfLifeAndNeverGrowsBackwardsInTime) {
  StaticMemoryOptions options;
  options.half_life = 3.0;
  StaticMemory memory(options);
  memory.update(1, 2.0, 10.0);
  EXPECT_NEAR(memory.log_odds(1, 13.0), 1.0, 1e-6);
  EXPECT_NEAR(memory.log_odds(1, 5.0), 2.0, 1e-6);
  EXPECT_NEAR(memory.update(1, 0.0, 5.0), 2.0, 1e-6);
  EXPECT_EQ(memory.log_odds(2, 10.0), 0.0);
  EXPECT_EQ(memory.verdict(2, 10.0), Verdict::kUnknown);
}

TEST(StaticMemory, ClampsAndTakesNaNForNoEvidence) {
  StaticMemory memory;
  for (int i = 0; i < 100; ++i) memory.update(1, 5.0, 0.0);
  EXPECT_NEAR(memory.log_odds(1, 0.0), StaticMemoryOptions().max_dynamic, 1e-6);
  for (int i = 0; i < 100; ++i) memory.update(1, -5.0, 0.0);
  EXPECT_NEAR(memory.log_odds(1, 0.0), -StaticMemoryOptions().max_static, 1e-6);
  EXPECT_NEAR(memory.update(1, std::nan(""), 0.0), -StaticMemoryOptions().max_static, 1e-6);
}

TEST(StaticMemory, UpdatesVerdictsOfMapPointsOnly) {
  StaticMemory memory;
  memory.update(5, 4.0, 0.0);
  std::vector<FeatureVerdict> verdicts(3);
  verdicts[2].verdict = Verdict::kDynamic;
  const std::vector<std::uint64_t> ids{5, StaticMemory::kNoId, 6};
  memory.update(ids, 0.0, verdicts);
  EXPECT_EQ(verdicts[0].verdict, Verdict::kDynamic);
  EXPECT_EQ(verdicts[0].reason, Reason::kRemembered);
  EXPECT_EQ(verdicts[1].reason, Reason::kNoReference);
  EXPECT_EQ(verdicts[2].verdict, Verdict::kUnknown);  // its log-odds was 0
  EXPECT_EQ(memory.size(), 2U);
  EXPECT_THROW(memory.update(Span<const std::uint64_t>(ids).subspan(0, 2), 0.0, verdicts),
               InvalidArgument);
}

TEST(StaticMemory, ForgetsOnRequest) {
  StaticMemory memory;
  memory.update(1, 1.0, 0.0);
  memory.update(2, 1.0, 5.0);
  memory.update(3, 1.0, 6.0);
  memory.erase(3);
  memory.erase_older_than(4.0);
  EXPECT_EQ(memory.size(), 1U);
  EXPECT_GT(memory.log_odds(2, 5.0), 0.0);
  memory.clear();
  EXPECT_EQ(memory.size(), 0U);
}

TEST(StaticMemory, RefusesEachInvalidOption) {
  using O = StaticMemoryOptions;
  for (double O::*member : {&O::half_life, &O::max_dynamic, &O::max_static}) {
    O options;
    options.*member = 0.0;
    EXPECT_THROW(StaticMemory{options}, InvalidArgument);
  }
  O options;
  options.decision = -1.0;
  EXPECT_THROW(StaticMemory{options}, InvalidArgument);
  using C = CellMemoryOptions;
  for (double C::*member : {&C::max_dynamic, &C::max_static}) {
    C cells;
    cells.*member = 0.0;
    EXPECT_THROW(CellMemory{cells}, InvalidArgument);
  }
  C cells;
  cells.retention = 1.0;
  EXPECT_THROW(CellMemory{cells}, InvalidArgument);
  cells = C();
  cells.max_speed = -1.0;
  EXPECT_THROW(CellMemory{cells}, InvalidArgument);
}

}  // namespace
}  // namespace dynslam::geometry
