// What a rule sees: the matched points, one array for each coordinate.
#pragma once

#include <cstddef>
#include <cstdint>

#include "dynslam/core/span.hpp"

namespace dynslam::matching {

/// Matches with a coordinate beyond this many pixels are treated like those with NaN.
inline constexpr float kLargestCoordinate = 1e6F;

/// Matched image points and what else is known of each match, as arrays of equal length.
///
/// `reject` gathers it from the host's types (a random access for each match, done once however
/// many rules follow). Points are pixels in the first ("query") and the second ("train") image, the
/// two images may have different sizes, and all four coordinates are finite (and at most
/// `kLargestCoordinate`). The optional arrays
/// are empty when the host has nothing of the kind.
struct PairsView {
  Span<const float> x1, y1;  ///< point in the first image, pixels
  Span<const float> x2, y2;  ///< point in the second image, pixels

  Span<const float> distance;  ///< descriptor distance, smaller is better; or empty
  Span<const float> rotation;  ///< key point angle 2 minus angle 1, degrees in [0, 360), NaN where
                               ///< not known; or empty
  Span<const float> zoom;      ///< key point size 2 over size 1, 0 where not known; or empty

  std::size_t size() const { return x1.size(); }
  bool empty() const { return x1.empty(); }
};

/// What `reject` did.
struct Rejection {
  std::size_t matches = 0;  ///< matches with two indices (a -1 in `vnMatches12` is none)
  std::size_t usable = 0;   ///< of these, with four finite coordinates up to 10^6
  std::size_t kept = 0;     ///< of these, kept by the rule
};

}  // namespace dynslam::matching
