// Layers promise to reuse their memory.
#include <gtest/gtest.h>

#include "dynslam/attention/cbam.hpp"
#include "dynslam/attention/dfc.hpp"
#include "dynslam/attention/ghost.hpp"

#include "allocation_counter.hpp"
#include "attention/support.hpp"

namespace dynslam::attention {
namespace {

using dynslam::testing::Allocations;
using dynslam::testing::allocations_of;
using reference::Map;
using testing::Random;
using testing::Result;

TEST_F(Allocations, OfASecondCallOfLayersAreNone) {
  Random random(1);
  const Map map = random.map(16, 20, 24);
  const DfcAttention dfc(random.dfc(16, 16));
  const Cbam cbam(random.cbam(16, 4));
  const GhostC3 c3(random.c3(16, 8, 16, 2));
  Workspace workspace;
  Result result(1, 16, 20, 24);
  const auto all = [&] {
    dfc.run(map.view(), map.view(), result.view, workspace);
    cbam.run(map.view(), result.view, workspace);
    c3.run(map.view(), result.view, workspace);
  };
  EXPECT_GT(allocations_of(all), 0);
  EXPECT_EQ(allocations_of(all), 0);
}

}  // namespace
}  // namespace dynslam::attention
