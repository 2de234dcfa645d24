// Four floats at a time, through Eigen: the same code is SSE, NEON or plain C++, at any
// optimization level and without -march.
#pragma once

#include <cstddef>

#include <Eigen/Core>

namespace dynslam::matching::detail {

using Float4 = Eigen::Array<float, 4, 1>;

/// The four floats from `at` on, as an operand. Arrays that are read so are padded by four.
inline Eigen::Map<const Float4> load(const float* at) { return Eigen::Map<const Float4>(at); }

inline void store(const Float4& values, float* at) { Eigen::Map<Float4>{at} = values; }

/// 1 for the first `count` lanes, 0 for the others.
inline Float4 first_lanes(std::size_t count) {
  static constexpr float kMask[8] = {1, 1, 1, 1, 0, 0, 0, 0};
  return load(kMask + (count < 4 ? 4 - count : 0));
}

}  // namespace dynslam::matching::detail
