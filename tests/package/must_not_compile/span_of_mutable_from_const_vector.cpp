// EXPECT: conversion from .* to non-scalar type|no viable conversion
// A view for writing does not bind to what may only be read.
#include <vector>

#include "dynslam/core/span.hpp"

void use() {
  const std::vector<int> numbers(3);
  dynslam::Span<int> span = numbers;
  span[0] = 1;
}
