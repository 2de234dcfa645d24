// The pose optimizer allocates when it is made and not when it is used.
#include <atomic>
#include <cstdlib>
#include <new>

#include <gtest/gtest.h>

#include "dynslam/factors/pose_optimizer.hpp"

#include "factors/synthetic.hpp"

namespace {
std::atomic<long> allocations{0};
}

void* operator new(std::size_t size) {
  ++allocations;
  if (void* p = std::malloc(size ? size : 1)) return p;
  throw std::bad_alloc();
}
// Out of line: g++ would otherwise see new paired with free and warn.
[[gnu::noinline]] void operator delete(void* p) noexcept { std::free(p); }
[[gnu::noinline]] void operator delete(void* p, std::size_t) noexcept { std::free(p); }

namespace dynslam::factors {
namespace {

TEST(PoseOptimizer, DoesNotAllocateWithinItsCapacity) {
  const synthetic::Frame f = synthetic::make_frame({}, 1);
  const PoseObservations<float> view = f.view();
  PosePrior prior;
  prior.information.setIdentity();
  for (const WeightMode mode : {WeightMode::kFixed, WeightMode::kJoint, WeightMode::kEliminated}) {
    PoseOptimizerOptions options;
    options.weights = mode;
    options.rounds = 4;
    PoseOptimizer optimizer(options, f.points.size());
    const long before = allocations;
    const PoseResult result = optimizer.optimize(f.camera, view, f.start, &prior);
    EXPECT_EQ(allocations - before, 0);
    EXPECT_TRUE(result);
  }
}

}  // namespace
}  // namespace dynslam::factors
