// For tests of functions that promise to reuse their memory. A room whose tests include this is
// declared with COUNT_ALLOCATIONS, which links the operator new that counts.
#pragma once

#include <new>

#include <gtest/gtest.h>

#include "sanitized.hpp"

namespace dynslam::testing {

/// How often the program has called operator new, in all its threads.
long allocations();

/// How often it did while `function` ran.
template <typename Function>
long allocations_of(const Function& function) {
  const long before = allocations();
  function();
  return allocations() - before;
}

/// Sanitizers have an operator new of their own, beside which there is no room for another: these
/// tests don't run there.
class Allocations : public ::testing::Test {
 protected:
  void SetUp() override {
    if (kSanitized) GTEST_SKIP() << "the sanitizer needs operator new for itself";
    ASSERT_EQ(allocations_of([] { ::operator delete(::operator new(1)); }), 1) << "nobody counts";
  }
};

}  // namespace dynslam::testing
