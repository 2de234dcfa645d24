// A correspondence between two sets of features.
#pragma once

#include <cstdint>

namespace dynslam {

/// Feature `query` of one frame is taken for feature `train` of the other.
struct Match {
  std::int32_t query = -1;  ///< index into the first set
  std::int32_t train = -1;  ///< index into the second set
  float distance = 0.0F;    ///< descriptor distance (bits for Hamming), smaller is better
};

}  // namespace dynslam
