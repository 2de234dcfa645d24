// Orientation and description of the patches about corners.
#include <cstring>

#include "features/orb_kernels.hpp"
#include "features/orb_pattern.hpp"
#include "features/orb_reference.hpp"
#include "features/simd.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "features/patch_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace dynslam::features::detail::HWY_NAMESPACE {
namespace {

#if HWY_TARGET == HWY_SCALAR

void patch_moments_simd(const PixelBlock& level, const Corner* corners, int count,
                        std::int32_t* m10, std::int32_t* m01) {
  reference::patch_moments(level, corners, count, m10, m01);
}

void rotated_brief_simd(const PixelBlock& blurred, const Corner* corners, const Rotation* rotations,
                        int count, std::uint8_t* descriptors) {
  reference::rotated_brief(blurred, corners, rotations, count, descriptors);
}

#else

namespace hn = hwy::HWY_NAMESPACE;

// ---------------------------------------------------------------------------------------------
// Orientation. A row of the patch is 32 bytes, columns -16 .. 15, of which the round patch keeps
// some.
// ---------------------------------------------------------------------------------------------

struct RoundPatch {
  alignas(16) std::uint8_t keep[kPatchRadius + 1][32];
  alignas(16) std::int16_t column[32];

  constexpr RoundPatch() : keep(), column() {
    for (int u = -16; u < 16; ++u) {
      column[u + 16] = static_cast<std::int16_t>(u);
      for (int v = 0; v <= kPatchRadius; ++v) {
        const int reach = kPatchReach[v];
        keep[v][u + 16] = (u >= -reach && u <= reach) ? 255 : 0;
      }
    }
  }
};
constexpr RoundPatch kRoundPatch;

struct Moments {
  std::int32_t m10, m01;
};

/// Half a patch: the 16 columns from `first` (0 or 16) of the 32.
HWY_INLINE Moments moments_of_half(const std::uint8_t* centre, std::ptrdiff_t stride, int first) {
  const hn::FixedTag<std::uint8_t, 16> d8;
  const hn::FixedTag<std::uint8_t, 8> d8_half;
  const hn::FixedTag<std::uint16_t, 8> d16;
  const hn::FixedTag<std::int16_t, 8> di16;
  const hn::FixedTag<std::int32_t, 4> d32;
  const hn::FixedTag<std::uint64_t, 2> d64;
  const std::uint8_t* at = centre - 16 + first;

  const auto middle = hn::And(hn::LoadU(d8, at), hn::Load(d8, kRoundPatch.keep[0] + first));
  auto left = hn::PromoteTo(d16, hn::LowerHalf(d8_half, middle));
  auto right = hn::PromoteTo(d16, hn::UpperHalf(d8_half, middle));
  // sum over v of v (row v - row -v) is the sum over k >= 1 of the sum over v >= k of the
  // differences: no multiplication. Differences may be negative; modulo 2^64 that is all the same.
  auto beyond = hn::Zero(d64);
  auto vertical = hn::Zero(d64);
  for (int v = kPatchRadius; v >= 1; --v) {
    const auto keep = hn::Load(d8, kRoundPatch.keep[v] + first);
    const auto below = hn::And(hn::LoadU(d8, at + v * stride), keep);
    const auto above = hn::And(hn::LoadU(d8, at - v * stride), keep);
    beyond = hn::Add(beyond, hn::Sub(hn::SumsOf8(below), hn::SumsOf8(above)));
    vertical = hn::Add(vertical, beyond);
    left = hn::Add(left, hn::Add(hn::PromoteTo(d16, hn::LowerHalf(d8_half, below)),
                                 hn::PromoteTo(d16, hn::LowerHalf(d8_half, above))));
    right = hn::Add(right, hn::Add(hn::PromoteTo(d16, hn::UpperHalf(d8_half, below)),
                                   hn::PromoteTo(d16, hn::UpperHalf(d8_half, above))));
  }
  auto rest = hn::Zero(d32);
  auto horizontal = hn::ReorderWidenMulAccumulate(d32, hn::BitCast(di16, left),
                                                  hn::Load(di16, kRoundPatch.column + first),
                                                  hn::Zero(d32), rest);
  horizontal = hn::ReorderWidenMulAccumulate(d32, hn::BitCast(di16, right),
                                             hn::Load(di16, kRoundPatch.column + first + 8),
                                             horizontal, rest);
  const auto m10 = hn::SumOfLanes(d32, hn::Add(horizontal, rest));
  const auto m01 = hn::SumOfLanes(d64, vertical);
  return {hn::GetLane(m10), static_cast<std::int32_t>(hn::GetLane(m01))};
}

void patch_moments_simd(const PixelBlock& level, const Corner* corners, int count,
                        std::int32_t* m10, std::int32_t* m01) {
  for (int i = 0; i < count; ++i) {
    const std::uint8_t* centre = level.row(corners[i].y) + corners[i].x;
    const Moments left = moments_of_half(centre, level.stride, 0);
    const Moments right = moments_of_half(centre, level.stride, 16);
    m10[i] = left.m10 + right.m10;
    m01[i] = left.m01 + right.m01;
  }
}

// ---------------------------------------------------------------------------------------------
// Description
// ---------------------------------------------------------------------------------------------

/// The pattern as arrays of coordinates: first points of the pairs, then the second ones.
struct Pattern {
  alignas(64) float x[2 * kPairs];
  alignas(64) float y[2 * kPairs];

  constexpr Pattern() : x(), y() {
    for (int i = 0; i < kPairs; ++i) {
      x[i] = kOrbPattern[i][0];
      y[i] = kOrbPattern[i][1];
      x[kPairs + i] = kOrbPattern[i][2];
      y[kPairs + i] = kOrbPattern[i][3];
    }
  }
};
constexpr Pattern kPattern;

/// Distances in bytes from the key point to the turned points of the pattern.
HWY_INLINE void turn_pattern(const Rotation& rotation, std::ptrdiff_t stride,
                             std::int32_t* HWY_RESTRICT offsets) {
  const hn::ScalableTag<float> df;
  const hn::RebindToSigned<decltype(df)> di;
  const int lanes = static_cast<int>(hn::Lanes(df));
  const auto cos = hn::Set(df, rotation.cos);
  const auto sin = hn::Set(df, rotation.sin);
  const auto row = hn::Set(di, static_cast<std::int32_t>(stride));
  for (int i = 0; i < 2 * kPairs; i += lanes) {
    const auto x = hn::Load(df, kPattern.x + i);
    const auto y = hn::Load(df, kPattern.y + i);
    const auto turned_x = hn::Sub(hn::Mul(x, cos), hn::Mul(y, sin));
    const auto turned_y = hn::Add(hn::Mul(x, sin), hn::Mul(y, cos));
    const auto offset = hn::Add(hn::Mul(hn::NearestInt(turned_y), row), hn::NearestInt(turned_x));
    hn::Store(offset, di, offsets + i);
  }
}

/// Eight tests. Pixels are fetched one by one: gathering instructions are no faster where they are
/// good, and much slower where they are not. Written out, because compilers leave the loop be.
HWY_INLINE std::uint8_t eight_tests(const std::uint8_t* centre, const std::int32_t* first) {
  const std::int32_t* second = first + kPairs;
  const auto test = [=](int i) HWY_ATTR {
    return static_cast<unsigned>(centre[first[i]] < centre[second[i]]) << i;
  };
  return static_cast<std::uint8_t>((test(0) | test(1) | test(2) | test(3)) |
                                   (test(4) | test(5) | test(6) | test(7)));
}

void rotated_brief_simd(const PixelBlock& blurred, const Corner* corners, const Rotation* rotations,
                        int count, std::uint8_t* descriptors) {
  alignas(64) std::int32_t offsets[2 * kPairs];
  for (int i = 0; i < count; ++i) {
    turn_pattern(rotations[i], blurred.stride, offsets);
    const std::uint8_t* centre = blurred.row(corners[i].y) + corners[i].x;
    std::uint8_t* descriptor = descriptors + static_cast<std::ptrdiff_t>(i) * kPairs / 8;
    for (int byte = 0; byte < kPairs / 8; ++byte) {
      descriptor[byte] = eight_tests(centre, offsets + 8 * byte);
    }
  }
}

#endif

}  // namespace

// Names for the dispatch tables, which cannot see into an anonymous namespace.
void patch_moments_target(const PixelBlock& level, const Corner* corners, int count,
                          std::int32_t* m10, std::int32_t* m01) {
  patch_moments_simd(level, corners, count, m10, m01);
}

void rotated_brief_target(const PixelBlock& blurred, const Corner* corners,
                          const Rotation* rotations, int count, std::uint8_t* descriptors) {
  rotated_brief_simd(blurred, corners, rotations, count, descriptors);
}

}  // namespace dynslam::features::detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::features::detail {

HWY_EXPORT(patch_moments_target);
HWY_EXPORT(rotated_brief_target);

void patch_moments(const PixelBlock& level, const Corner* corners, int count, std::int32_t* m10,
                   std::int32_t* m01) {
  HWY_DYNAMIC_DISPATCH(patch_moments_target)(level, corners, count, m10, m01);
}

void rotated_brief(const PixelBlock& blurred, const Corner* corners, const Rotation* rotations,
                   int count, std::uint8_t* descriptors) {
  HWY_DYNAMIC_DISPATCH(rotated_brief_target)(blurred, corners, rotations, count, descriptors);
}

}  // namespace dynslam::features::detail
#endif
