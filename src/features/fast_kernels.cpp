// FAST-9 corners with their scores, and suppression of all but the strongest of neighbours.
#include <algorithm>
#include <cstring>

#include "features/orb_kernels.hpp"
#include "features/orb_reference.hpp"
#include "features/simd.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "features/fast_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace dynslam::features::detail::HWY_NAMESPACE {
namespace {

#if HWY_TARGET == HWY_SCALAR

int fast_corners_simd(const PixelBlock& level, int border, int threshold, std::uint8_t* scratch,
                      Corner* corners) {
  return reference::fast_corners(level, border, threshold, scratch, corners);
}

#else

namespace hn = hwy::HWY_NAMESPACE;
using D8 = hn::ScalableTag<std::uint8_t>;
using V8 = hn::Vec<D8>;

/// Min and max exchanged for one another: the darker arc is the brighter one of the negative.
struct Brighter {
  static HWY_INLINE V8 least(V8 a, V8 b) { return hn::Min(a, b); }
  static HWY_INLINE V8 most(V8 a, V8 b) { return hn::Max(a, b); }
};
struct Darker {
  static HWY_INLINE V8 least(V8 a, V8 b) { return hn::Max(a, b); }
  static HWY_INLINE V8 most(V8 a, V8 b) { return hn::Min(a, b); }
};

/// The sixteen pixels of the circle of 64 or fewer neighbouring centres, by number as in kCircle.
/// Everything below is written out instead of looped, so that the compiler keeps it in registers.
struct Circle {
  V8 p0, p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11, p12, p13, p14, p15;
};

/// most over the 16 arcs of the least over the arc's nine pixels.
///
/// Two arcs that start at k and k + 1 share the eight pixels k + 1 .. k + 8; what they add is the
/// pixel k or k + 9. So eight runs of eight do for sixteen of nine.
template <class Sense>
HWY_INLINE V8 best_arc(const Circle& c) {
  const auto least = [](V8 a, V8 b) HWY_ATTR { return Sense::least(a, b); };
  const auto most = [](V8 a, V8 b) HWY_ATTR { return Sense::most(a, b); };
  // Runs of two and of four that start at 1, 3, .. 15.
  const V8 two1 = least(c.p1, c.p2), two3 = least(c.p3, c.p4);
  const V8 two5 = least(c.p5, c.p6), two7 = least(c.p7, c.p8);
  const V8 two9 = least(c.p9, c.p10), two11 = least(c.p11, c.p12);
  const V8 two13 = least(c.p13, c.p14), two15 = least(c.p15, c.p0);
  const V8 four1 = least(two1, two3), four3 = least(two3, two5);
  const V8 four5 = least(two5, two7), four7 = least(two7, two9);
  const V8 four9 = least(two9, two11), four11 = least(two11, two13);
  const V8 four13 = least(two13, two15), four15 = least(two15, two1);
  // Runs of eight with the better of their two neighbours.
  const V8 arc0 = least(least(four1, four5), most(c.p0, c.p9));
  const V8 arc2 = least(least(four3, four7), most(c.p2, c.p11));
  const V8 arc4 = least(least(four5, four9), most(c.p4, c.p13));
  const V8 arc6 = least(least(four7, four11), most(c.p6, c.p15));
  const V8 arc8 = least(least(four9, four13), most(c.p8, c.p1));
  const V8 arc10 = least(least(four11, four15), most(c.p10, c.p3));
  const V8 arc12 = least(least(four13, four1), most(c.p12, c.p5));
  const V8 arc14 = least(least(four15, four3), most(c.p14, c.p7));
  return most(most(most(arc0, arc2), most(arc4, arc6)),
              most(most(arc8, arc10), most(arc12, arc14)));
}

/// An arc of nine holds at least one of two opposite pixels: a corner needs, in each opposite pair,
/// a pixel beyond the threshold. Narrows the bounds by the pair (k, k + 8).
HWY_INLINE void narrow(V8 a, V8 b, V8& least_max, V8& most_min) {
  least_max = hn::Min(least_max, hn::Max(a, b));
  most_min = hn::Max(most_min, hn::Min(a, b));
}

HWY_INLINE bool none_beyond(D8 d, V8 values, V8 bound) {
  return hn::AllTrue(d, hn::Eq(hn::SaturatedSub(values, bound), hn::Zero(d)));
}

/// Scores of the pixels begin .. end of a row and of a few behind them.
void score_row(const std::uint8_t* HWY_RESTRICT row, std::ptrdiff_t stride, int begin, int end,
               int threshold, std::uint8_t* HWY_RESTRICT scores) {
  const D8 d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const V8 bound = hn::Set(d, static_cast<std::uint8_t>(threshold));
  const auto pixel = [=](int k, int x) HWY_ATTR {
    return hn::LoadU(d, row + kCircle[k].y * stride + kCircle[k].x + x);
  };
  for (int x = begin; x < end; x += lanes) {
    const V8 centre = hn::LoadU(d, row + x);
    const V8 bright_bound = hn::SaturatedAdd(centre, bound);
    const V8 dark_bound = hn::SaturatedSub(centre, bound);
    Circle c;
    c.p0 = pixel(0, x), c.p4 = pixel(4, x), c.p8 = pixel(8, x), c.p12 = pixel(12, x);
    V8 least_max = hn::Max(c.p0, c.p8);
    V8 most_min = hn::Min(c.p0, c.p8);
    narrow(c.p4, c.p12, least_max, most_min);
    if (none_beyond(d, least_max, bright_bound) && none_beyond(d, dark_bound, most_min)) {
      hn::StoreU(hn::Zero(d), d, scores + x);
      continue;
    }
    c.p1 = pixel(1, x), c.p2 = pixel(2, x), c.p3 = pixel(3, x), c.p5 = pixel(5, x);
    c.p6 = pixel(6, x), c.p7 = pixel(7, x), c.p9 = pixel(9, x), c.p10 = pixel(10, x);
    c.p11 = pixel(11, x), c.p13 = pixel(13, x), c.p14 = pixel(14, x), c.p15 = pixel(15, x);
    narrow(c.p1, c.p9, least_max, most_min);
    narrow(c.p2, c.p10, least_max, most_min);
    narrow(c.p3, c.p11, least_max, most_min);
    narrow(c.p5, c.p13, least_max, most_min);
    narrow(c.p6, c.p14, least_max, most_min);
    narrow(c.p7, c.p15, least_max, most_min);
    V8 contrast = hn::Zero(d);
    if (!none_beyond(d, least_max, bright_bound)) {
      contrast = hn::SaturatedSub(best_arc<Brighter>(c), centre);
    }
    if (!none_beyond(d, dark_bound, most_min)) {
      contrast = hn::Max(contrast, hn::SaturatedSub(centre, best_arc<Darker>(c)));
    }
    // contrast - 1 where contrast > threshold, else 0.
    const auto flat = hn::Eq(hn::Max(contrast, bound), bound);
    const V8 score = hn::SaturatedSub(contrast, hn::Set(d, std::uint8_t{1}));
    hn::StoreU(hn::IfThenZeroElse(flat, score), d, scores + x);
  }
}

/// Appends the peaks among the pixels begin .. end of the middle row.
Corner* collect_peaks(const std::uint8_t* above, const std::uint8_t* scores,
                      const std::uint8_t* below, int begin, int end, int y, Corner* corners) {
  const D8 d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const V8 zero = hn::Zero(d);
  const auto max3 = [&](const std::uint8_t* at) HWY_ATTR {
    return hn::Max(hn::Max(hn::LoadU(d, at - 1), hn::LoadU(d, at)), hn::LoadU(d, at + 1));
  };
  for (int x = begin; x < end; x += lanes) {
    const V8 score = hn::LoadU(d, scores + x);
    if (hn::AllTrue(d, hn::Eq(score, zero))) continue;
    const V8 before = hn::Max(max3(above + x), hn::LoadU(d, scores + x - 1));
    const V8 after = hn::Max(max3(below + x), hn::LoadU(d, scores + x + 1));
    // score > before and score >= after
    const auto weaker = hn::Or(hn::Eq(hn::SaturatedSub(score, before), zero),
                               hn::Ne(hn::SaturatedSub(after, score), zero));
    // The bits of one vector's mask; the longest has 64 lanes.
    std::uint64_t peaks = 0;
    hn::StoreMaskBits(d, hn::Not(weaker), reinterpret_cast<std::uint8_t*>(&peaks));
    const int rest = end - x;
    if (rest < 64) peaks &= (std::uint64_t{1} << rest) - 1;
    for (; peaks != 0; peaks &= peaks - 1) {
      const int at = x + static_cast<int>(hwy::Num0BitsBelowLS1Bit_Nonzero64(peaks));
      *corners++ = {static_cast<std::uint16_t>(at), static_cast<std::uint16_t>(y), scores[at],
                    peak_offset(scores[at - 1], scores[at], scores[at + 1]),
                    peak_offset(above[at], scores[at], below[at])};
    }
  }
  return corners;
}

int fast_corners_simd(const PixelBlock& level, int border, int threshold, std::uint8_t* scratch,
                      Corner* corners) {
  // Scores of three rows, one row ahead of the row whose peaks are sought.
  Corner* end = corners;
  for (int y = border - 1; y <= level.height - border; ++y) {
    std::uint8_t* scores = scratch + (y % 3) * level.stride;
    score_row(level.row(y), level.stride, border - 1, level.width - border + 1, threshold, scores);
    if (y < border + 1) continue;
    end = collect_peaks(scratch + ((y - 2) % 3) * level.stride,
                        scratch + ((y - 1) % 3) * level.stride, scores, border,
                        level.width - border, y - 1, end);
  }
  return static_cast<int>(end - corners);
}

#endif

}  // namespace

// A name for the dispatch table, which cannot see into an anonymous namespace.
int fast_corners_target(const PixelBlock& level, int border, int threshold, std::uint8_t* scratch,
                        Corner* corners) {
  return fast_corners_simd(level, border, threshold, scratch, corners);
}

}  // namespace dynslam::features::detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::features::detail {

HWY_EXPORT(fast_corners_target);

int fast_corners(const PixelBlock& level, int border, int threshold, std::uint8_t* scratch,
                 Corner* corners) {
  return HWY_DYNAMIC_DISPATCH(fast_corners_target)(level, border, threshold, scratch, corners);
}

}  // namespace dynslam::features::detail
#endif
