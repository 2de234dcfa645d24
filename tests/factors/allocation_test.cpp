// The pose optimizer allocates when it is made and not when it is used.
#include <gtest/gtest.h>

#include "dynslam/factors/pose_optimizer.hpp"

#include "allocation_counter.hpp"
#include "factors/synthetic.hpp"

namespace dynslam::factors {
namespace {

using dynslam::testing::Allocations;
using dynslam::testing::allocations_of;

TEST_F(Allocations, OfAPoseOptimizerWithinItsCapacityAreNone) {
  const synthetic::Frame f = synthetic::make_frame({}, 1);
  const PoseObservations<float> view = f.view();
  PosePrior prior;
  prior.information.setIdentity();
  for (const WeightMode mode : {WeightMode::kFixed, WeightMode::kJoint, WeightMode::kEliminated}) {
    PoseOptimizerOptions options;
    options.weights = mode;
    options.rounds = 4;
    PoseOptimizer optimizer(options, f.points.size());
    PoseResult result;
    EXPECT_EQ(allocations_of([&] { result = optimizer.optimize(f.camera, view, f.start, &prior); }),
              0);
    EXPECT_TRUE(result);
  }
}

}  // namespace
}  // namespace dynslam::factors
