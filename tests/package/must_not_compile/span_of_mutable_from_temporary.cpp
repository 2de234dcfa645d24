// EXPECT: conversion from .* to non-scalar type|no viable conversion
// What is written into a temporary is lost.
#include <vector>

#include "dynslam/core/span.hpp"

void use() { dynslam::Span<int> span = std::vector<int>(3); }
