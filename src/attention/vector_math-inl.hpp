// Vector functions shared by the kernel files, compiled once per target.
#if defined(DYNSLAM_ATTENTION_VECTOR_MATH_TOGGLE) == defined(HWY_TARGET_TOGGLE)
#ifdef DYNSLAM_ATTENTION_VECTOR_MATH_TOGGLE
#undef DYNSLAM_ATTENTION_VECTOR_MATH_TOGGLE
#else
#define DYNSLAM_ATTENTION_VECTOR_MATH_TOGGLE
#endif

#include <cstddef>
#include <cstdint>

#include <hwy/highway.h>

#include "dynslam/attention/weights.hpp"

HWY_BEFORE_NAMESPACE();
namespace dynslam::attention::detail::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

// At most 16 lanes, for which packed panels and padded rows provide.
using D = hn::CappedTag<float, 16>;
using V = hn::Vec<D>;

// Masked loads and stores touch nothing beyond their lanes on these targets; elsewhere they may.
#if HWY_TARGET == HWY_AVX2 || HWY_TARGET == HWY_AVX3 || HWY_TARGET == HWY_AVX3_DL

/// 0 < n < lanes values, the other lanes 0. Reads nothing beyond them.
HWY_INLINE V load_first(const float* at, std::size_t n) {
  const D d;
  return hn::MaskedLoad(hn::FirstN(d, n), d, at);
}

HWY_INLINE void store_first(V v, float* at, std::size_t n) {
  const D d;
  hn::BlendedStore(v, hn::FirstN(d, n), d, at);
}

#else

/// 0 < n < lanes values, the other lanes 0. Reads nothing beyond them.
HWY_INLINE V load_first(const float* at, std::size_t n) {
  const D d;
  alignas(64) float lanes[16] = {};
  for (std::size_t i = 0; i < n; ++i) lanes[i] = at[i];
  return hn::Load(d, lanes);
}

HWY_INLINE void store_first(V v, float* at, std::size_t n) {
  const D d;
  alignas(64) float lanes[16];
  hn::Store(v, d, lanes);
  for (std::size_t i = 0; i < n; ++i) at[i] = lanes[i];
}

#endif

HWY_INLINE V load_up_to(const float* at, std::size_t n) {
  const D d;
  return n >= hn::Lanes(d) ? hn::LoadU(d, at) : load_first(at, n);
}

HWY_INLINE void store_up_to(V v, float* at, std::size_t n) {
  const D d;
  if (n >= hn::Lanes(d)) {
    hn::StoreU(v, d, at);
  } else {
    store_first(v, at, n);
  }
}

/// 1 / x to about an ulp, 1 <= x < 2^125.
HWY_INLINE V reciprocal(V x) {
  const D d;
#if HWY_TARGET == HWY_AVX2 || HWY_TARGET == HWY_AVX3 || HWY_TARGET == HWY_AVX3_DL
  // Estimates of at least 12 bits: one step of Newton's doubles them.
  const V estimate = hn::ApproximateReciprocal(x);
  return hn::MulAdd(estimate, hn::NegMulAdd(x, estimate, hn::Set(d, 1.0F)), estimate);
#else
  return hn::Div(hn::Set(d, 1.0F), x);
#endif
}

/// 1 / (1 + exp(-x)), relative error below 4e-7 for |x| <= 86, beyond that the value at 86; NaN
/// stays NaN.
HWY_INLINE V sigmoid(V x) {
  const D d;
  const hn::RebindToSigned<D> di;
  const V limit = hn::Set(d, 86.0F);
  const V t = hn::Min(hn::Max(hn::Neg(x), hn::Neg(limit)), limit);
  // exp(t) = 2^n exp(r), |r| <= ln 2 / 2, exp(r) by its series.
  const auto n = hn::NearestInt(hn::Mul(t, hn::Set(d, 1.442695041F)));
  const V whole = hn::ConvertTo(d, n);
  V r = hn::NegMulAdd(whole, hn::Set(d, 0.693359375F), t);
  r = hn::NegMulAdd(whole, hn::Set(d, -2.12194440e-4F), r);
  V p = hn::Set(d, 1.0F / 720.0F);
  p = hn::MulAdd(p, r, hn::Set(d, 1.0F / 120.0F));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0F / 24.0F));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0F / 6.0F));
  p = hn::MulAdd(p, r, hn::Set(d, 0.5F));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0F));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0F));
  const V power = hn::BitCast(d, hn::ShiftLeft<23>(hn::Add(n, hn::Set(di, 127))));
  const V result = reciprocal(hn::MulAdd(p, power, hn::Set(d, 1.0F)));
  return hn::IfThenElse(hn::Eq(x, x), result, x);
}

template <Activation kActivation>
HWY_INLINE V activate(V x) {
  if constexpr (kActivation == Activation::kRelu) {
    // Not Max, which loses NaN on some machines.
    return hn::IfThenZeroElse(hn::Lt(x, hn::Zero(D())), x);
  } else if constexpr (kActivation == Activation::kSilu) {
    return hn::Mul(x, sigmoid(x));
  } else {
    return x;
  }
}

HWY_INLINE float sum_of(V v) { return hn::GetLane(hn::SumOfLanes(D(), v)); }
HWY_INLINE float max_of(V v) { return hn::GetLane(hn::MaxOfLanes(D(), v)); }

}  // namespace
}  // namespace dynslam::attention::detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
