// Random numbers of the rendered scene: pure functions of their keys, the same everywhere.
#pragma once

#include <cstdint>

namespace dynslam::dataset::scene {

/// Finalizer of splitmix64 (Steele, Lea, Flood, OOPSLA 2014): every bit of x moves every bit of the
/// result.
inline std::uint64_t mix(std::uint64_t x) {
  x += 0x9E3779B97F4A7C15ULL;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ULL;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBULL;
  return x ^ (x >> 31);
}

inline std::uint64_t mix(std::uint64_t a, std::uint64_t b) { return mix(mix(a) ^ b); }
inline std::uint64_t mix(std::uint64_t a, std::uint64_t b, std::uint64_t c) {
  return mix(mix(a, b) ^ c);
}

/// Sequence of random numbers, one for every thing that is built, so that a change in one thing
/// leaves the others as they were.
class Random {
 public:
  Random(std::uint64_t seed, std::uint64_t purpose) : state_(mix(seed, purpose)) {}

  std::uint64_t bits() { return mix(state_++); }
  /// In [0, 1).
  double uniform() { return static_cast<double>(bits() >> 11) * 0x1.0p-53; }
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  float uniformf(float low, float high) {
    return static_cast<float>(uniform(static_cast<double>(low), static_cast<double>(high)));
  }
  /// In [0, count).
  int below(int count) { return static_cast<int>(uniform() * count); }
  bool chance(double probability) { return uniform() < probability; }

 private:
  std::uint64_t state_;
};

}  // namespace dynslam::dataset::scene
