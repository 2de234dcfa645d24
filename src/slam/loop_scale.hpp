// How much a map without depth has grown or shrunk until it came back to an old place.
#pragma once

#include <optional>
#include <vector>

namespace dynslam::slam {

/// The factor that most of the points agree on, from the logarithms of their distances at the new
/// place over those at the old one. Nothing if they are few, or scatter so much that the median is
/// not certain to a few percent. O(n).
std::optional<double> agreed_scale(std::vector<double> log_ratios);

}  // namespace dynslam::slam
