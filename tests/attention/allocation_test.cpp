// Layers promise to reuse their memory: this file counts every `new` of the program.
#include <atomic>
#include <cstdlib>
#include <new>

#include <gtest/gtest.h>

#include "dynslam/attention/cbam.hpp"
#include "dynslam/attention/dfc.hpp"
#include "dynslam/attention/ghost.hpp"

#include "attention/support.hpp"

namespace {
std::atomic<long> allocations{0};
}

[[gnu::noinline]] void* operator new(std::size_t size) {
  ++allocations;
  if (void* memory = std::malloc(size != 0 ? size : 1)) return memory;
  throw std::bad_alloc();
}
[[gnu::noinline]] void operator delete(void* memory) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
// Sanitizers bring arrays of their own, past the ones above.
void* operator new[](std::size_t size) { return operator new(size); }
void operator delete[](void* memory) noexcept { operator delete(memory); }
void operator delete[](void* memory, std::size_t) noexcept { operator delete(memory); }

namespace dynslam::attention {
namespace {

using reference::Map;
using testing::Random;
using testing::Result;

TEST(Layers, DoNotAllocateInASecondCall) {
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
  const long start = allocations;
  all();
  const long warm = allocations;
  all();
  const long again = allocations;  // before the checks, which allocate where they fail
  EXPECT_GT(warm, start);          // the counter counts
  EXPECT_EQ(again, warm);
}

}  // namespace
}  // namespace dynslam::attention
