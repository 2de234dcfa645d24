// EXPECT: a point must be made of scalars only
// Points of three floats are not points of doubles.
#include <array>
#include <vector>

#include "dynslam/core/points.hpp"

void use(const std::vector<std::array<float, 3>>& points) { dynslam::as_points<double>(points); }
