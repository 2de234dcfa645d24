#include "factors/schur_kernels.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "factors/schur_kernels.cpp"
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace dynslam::factors::kernels {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<double, 8>;

// Y = W V^-1 for one entry, and rhs -= Y b.
HWY_INLINE void scale_entry(const double* HWY_RESTRICT W, const double* HWY_RESTRICT inverse,
                            const double* HWY_RESTRICT b, double* HWY_RESTRICT Y,
                            double* HWY_RESTRICT rhs) {
  const D d;
  for (std::size_t r = 0; r < kColumn; r += hn::Lanes(d)) {
    const auto w0 = hn::Load(d, W + r), w1 = hn::Load(d, W + kColumn + r);
    const auto w2 = hn::Load(d, W + 2 * kColumn + r);
    auto sum = hn::Load(d, rhs + r);
    for (std::size_t m = 0; m < 3; ++m) {
      auto y = hn::Mul(w0, hn::Set(d, inverse[m]));
      y = hn::MulAdd(w1, hn::Set(d, inverse[3 + m]), y);
      y = hn::MulAdd(w2, hn::Set(d, inverse[6 + m]), y);
      hn::Store(y, d, Y + m * kColumn + r);
      sum = hn::NegMulAdd(y, hn::Set(d, b[m]), sum);
    }
    hn::Store(sum, d, rhs + r);
  }
}

// block -= Y W'.
HWY_INLINE void subtract_product(const double* HWY_RESTRICT Y, const double* HWY_RESTRICT W,
                                 double* HWY_RESTRICT block) {
  const D d;
  for (std::size_t r = 0; r < kColumn; r += hn::Lanes(d)) {
    const auto y0 = hn::Load(d, Y + r), y1 = hn::Load(d, Y + kColumn + r);
    const auto y2 = hn::Load(d, Y + 2 * kColumn + r);
    for (std::size_t c = 0; c < 6; ++c) {
      auto sum = hn::Load(d, block + c * kColumn + r);
      sum = hn::NegMulAdd(y0, hn::Set(d, W[c]), sum);
      sum = hn::NegMulAdd(y1, hn::Set(d, W[kColumn + c]), sum);
      sum = hn::NegMulAdd(y2, hn::Set(d, W[2 * kColumn + c]), sum);
      hn::Store(sum, d, block + c * kColumn + r);
    }
  }
}

void eliminate_points(const Elimination& e) {
  const std::uint32_t* pair = e.pair_block;
  for (std::size_t p = 0; p < e.points; ++p) {
    const std::size_t begin = e.entry_begin[p], end = e.entry_begin[p + 1];
    for (std::size_t a = begin; a < end; ++a) {
      scale_entry(e.cross + a * kCross, e.inverse + 9 * p, e.gradient + 3 * p,
                  e.scratch + (a - begin) * kCross, e.rhs + e.entry_camera[a] * kColumn);
    }
    for (std::size_t a = begin; a < end; ++a) {
      const double* Y = e.scratch + (a - begin) * kCross;
      for (std::size_t b = a; b < end; ++b)
        subtract_product(Y, e.cross + b * kCross, e.blocks + std::size_t{*pair++} * kSquare);
    }
  }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace dynslam::factors::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::factors::kernels {

HWY_EXPORT(eliminate_points);

void eliminate_points(const Elimination& e) { HWY_DYNAMIC_DISPATCH(eliminate_points)(e); }

}  // namespace dynslam::factors::kernels
#endif
