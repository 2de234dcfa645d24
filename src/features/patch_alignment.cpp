#include "dynslam/features/patch_alignment.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>

#include <Eigen/LU>

#include "features/simd.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "features/patch_alignment.cpp"
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

#include "features/patch_window.hpp"

HWY_BEFORE_NAMESPACE();
namespace dynslam::features::detail::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<float, kWindow>;
using V = hn::Vec<D>;

HWY_INLINE float total(D d, V v) { return hn::GetLane(hn::SumOfLanes(d, v)); }

HWY_INLINE V load_pixels(D d, const std::uint8_t* pixels) {
  const hn::Rebind<std::int32_t, D> di;
  const hn::Rebind<std::uint8_t, D> du;
  return hn::ConvertTo(d, hn::PromoteTo(di, hn::LoadU(du, pixels)));
}

void subtract_mean(float* values) {
  const D d;
  constexpr int kPixels = kWindow * kWindow;
  V sum = hn::Zero(d);
  for (int i = 0; i < kPixels; i += static_cast<int>(hn::Lanes(d))) {
    sum = hn::Add(sum, hn::LoadU(d, values + i));
  }
  const V mean = hn::Set(d, total(d, sum) / static_cast<float>(kPixels));
  for (int i = 0; i < kPixels; i += static_cast<int>(hn::Lanes(d))) {
    hn::StoreU(hn::Sub(hn::LoadU(d, values + i), mean), d, values + i);
  }
}

TemplateSums make_template(const RimmedWindow& rimmed, WindowTemplate& window) {
  const D d;
  const V half = hn::Set(d, 0.5F);
  for (int v = 0; v < kWindow; ++v) {
    const float* row = rimmed.gray + (v + 1) * kRimmed + 1;
    for (int u = 0; u < kWindow; u += static_cast<int>(hn::Lanes(d))) {
      const int at = v * kWindow + u;
      const auto beside = [&](int offset) HWY_ATTR { return hn::LoadU(d, row + u + offset); };
      hn::StoreU(beside(0), d, window.gray + at);
      hn::StoreU(hn::Mul(half, hn::Sub(beside(1), beside(-1))), d, window.slope_x + at);
      hn::StoreU(hn::Mul(half, hn::Sub(beside(kRimmed), beside(-kRimmed))), d, window.slope_y + at);
    }
  }
  // Without their means neither brightness nor what is left of it enters the sums.
  subtract_mean(window.gray);
  subtract_mean(window.slope_x);
  subtract_mean(window.slope_y);
  V xx = hn::Zero(d), xy = xx, xg = xx, yy = xx, yg = xx, gg = xx;
  for (int i = 0; i < kWindow * kWindow; i += static_cast<int>(hn::Lanes(d))) {
    const V x = hn::LoadU(d, window.slope_x + i), y = hn::LoadU(d, window.slope_y + i);
    const V g = hn::LoadU(d, window.gray + i);
    xx = hn::MulAdd(x, x, xx), xy = hn::MulAdd(x, y, xy), xg = hn::MulAdd(x, g, xg);
    yy = hn::MulAdd(y, y, yy), yg = hn::MulAdd(y, g, yg), gg = hn::MulAdd(g, g, gg);
  }
  return {total(d, xx), total(d, xy), total(d, xg), total(d, yy), total(d, yg), total(d, gg)};
}

WindowSums compare(const WindowTemplate& window, const std::uint8_t* corner, std::ptrdiff_t stride,
                   float a, float b) {
  const D d;
  const V w11 = hn::Set(d, a * b), w10 = hn::Set(d, (1.0F - a) * b);
  const V w01 = hn::Set(d, a * (1.0F - b)), w00 = hn::Set(d, (1.0F - a) * (1.0F - b));
  V r1 = hn::Zero(d), rr = hn::Zero(d), rx = hn::Zero(d), ry = hn::Zero(d), rg = hn::Zero(d);
  for (int v = 0; v < kWindow; ++v) {
    const std::uint8_t* upper = corner + v * stride;
    const std::uint8_t* lower = upper + stride;
    for (int u = 0; u < kWindow; u += static_cast<int>(hn::Lanes(d))) {
      const V top =
          hn::MulAdd(w01, load_pixels(d, upper + u + 1), hn::Mul(w00, load_pixels(d, upper + u)));
      const V both = hn::MulAdd(w10, load_pixels(d, lower + u), top);
      const V value = hn::MulAdd(w11, load_pixels(d, lower + u + 1), both);
      const int at = v * kWindow + u;
      const V t = hn::LoadU(d, window.gray + at);
      const V r = hn::Sub(value, t);
      r1 = hn::Add(r1, r);
      rr = hn::MulAdd(r, r, rr);
      rx = hn::MulAdd(r, hn::LoadU(d, window.slope_x + at), rx);
      ry = hn::MulAdd(r, hn::LoadU(d, window.slope_y + at), ry);
      rg = hn::MulAdd(r, t, rg);
    }
  }
  return {total(d, r1), total(d, rr), total(d, rx), total(d, ry), total(d, rg)};
}

}  // namespace
}  // namespace dynslam::features::detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::features {
namespace detail {

HWY_EXPORT(compare);
HWY_EXPORT(make_template);

TemplateSums make_template(const RimmedWindow& rimmed, WindowTemplate& window) {
  return HWY_DYNAMIC_DISPATCH(make_template)(rimmed, window);
}

WindowSums compare(const WindowTemplate& window, const std::uint8_t* corner, std::ptrdiff_t stride,
                   float a, float b) {
  return HWY_DYNAMIC_DISPATCH(compare)(window, corner, stride, a, b);
}

}  // namespace detail

namespace {

using detail::kWindow;
using detail::RimmedWindow;
using detail::WindowTemplate;

constexpr int kPixels = kWindow * kWindow;
constexpr float kMiddle = 0.5F * static_cast<float>(kWindow - 1);  // of the window, its pixels
constexpr float kMargin = 0.01F;                                   // pixels of a patch
constexpr float kDegrees =
    static_cast<float>(kPixels - 4);     // of freedom: place, brightness, contrast
constexpr float kLeastVariance = 1e-6F;  // pixels^2 of a level
constexpr float kSettled = 0.02F;        // pixels: a shorter step is the last

// The patch as the level should show it; false if the window leaves the patch.
bool warp(const Patch& patch, const Eigen::Matrix2f& A, RimmedWindow& window) {
  const float reach = kMiddle + 1.0F;
  const Eigen::Vector2f middle =
      patch.offset + Eigen::Vector2f::Constant(static_cast<float>(Patch::kRadius));
  const Eigen::Vector2f extent = reach * A.cwiseAbs().rowwise().sum();
  const float last = static_cast<float>(Patch::kSide - 1);
  // Steps in fixed point may end a little beside.
  const bool inside = ((middle - extent).array() > kMargin).all() &&
                      ((middle + extent).array() < last - kMargin).all();
  if (!inside) return false;
  constexpr float kOne = 65536.0F;  // of places in fixed point
  const auto fixed = [](float v) { return static_cast<std::int32_t>(v * kOne); };
  const Eigen::Vector2f first = middle - reach * A.rowwise().sum();
  const std::int32_t x0 = fixed(first.x()), y0 = fixed(first.y());
  const std::int32_t xu = fixed(A(0, 0)), xv = fixed(A(0, 1));
  const std::int32_t yu = fixed(A(1, 0)), yv = fixed(A(1, 1));
  float* out = window.gray;
  for (int v = 0; v < detail::kRimmed; ++v) {
    std::int32_t x = x0 + v * xv, y = y0 + v * yv;
    for (int u = 0; u < detail::kRimmed; ++u, x += xu, y += yu) {
      const std::uint8_t* upper = patch.pixels.data() + (y >> 16) * Patch::kSide + (x >> 16);
      const std::uint8_t* lower = upper + Patch::kSide;
      const std::int32_t a = (x & 0xFFFF) >> 8, b = (y & 0xFFFF) >> 8;  // of 256
      const std::int32_t top = upper[0] * (256 - a) + upper[1] * a;
      const std::int32_t bottom = lower[0] * (256 - a) + lower[1] * a;
      *out++ = static_cast<float>(top * (256 - b) + bottom * b) * (1.0F / 65536.0F);
    }
  }
  return true;
}

// The least of the slope in any direction, mean square, besides what contrast could explain.
float least_slope(const Eigen::Matrix3f& H) {
  const Eigen::Vector2f with_gray = H.block<2, 1>(0, 2);
  const Eigen::Matrix2f S =
      H.topLeftCorner<2, 2>() - with_gray * with_gray.transpose() / std::max(H(2, 2), 1e-3F);
  const float half = 0.5F * (S(0, 0) - S(1, 1));
  const float mean = 0.5F * (S(0, 0) + S(1, 1));
  return (mean - std::sqrt(half * half + S(0, 1) * S(0, 1))) / static_cast<float>(kPixels);
}

}  // namespace

std::optional<Patch> cut_patch(GrayView level, const Eigen::Vector2f& at) {
  const float right = static_cast<float>(level.width), below = static_cast<float>(level.height);
  if (!(at.x() >= 0.0F && at.y() >= 0.0F && at.x() < right && at.y() < below)) return std::nullopt;
  const int x = static_cast<int>(std::lround(at.x())), y = static_cast<int>(std::lround(at.y()));
  if (!level.contains(x - Patch::kRadius, y - Patch::kRadius) ||
      !level.contains(x + Patch::kRadius, y + Patch::kRadius)) {
    return std::nullopt;
  }
  Patch patch;
  patch.offset = at - Eigen::Vector2f(static_cast<float>(x), static_cast<float>(y));
  for (int v = 0; v < Patch::kSide; ++v) {
    std::memcpy(patch.pixels.data() + v * Patch::kSide,
                level.row(y - Patch::kRadius + v) + x - Patch::kRadius, Patch::kSide);
  }
  return patch;
}

PatchAlignment align_patch(const Patch& patch, const Eigen::Matrix2f& A_patch_level, GrayView level,
                           const Eigen::Vector2f& start, const PatchAlignmentOptions& options) {
  RimmedWindow rimmed;
  WindowTemplate window;
  if (!warp(patch, A_patch_level, rimmed)) return {PatchStatus::kDistorted, start};
  const detail::TemplateSums sums_of = detail::make_template(rimmed, window);
  Eigen::Matrix3f H;
  H << sums_of.xx, sums_of.xy, sums_of.xg, sums_of.xy, sums_of.yy, sums_of.yg, sums_of.xg,
      sums_of.yg, sums_of.gg;
  if (!(least_slope(H) >= options.min_gradient * options.min_gradient)) {
    return {PatchStatus::kFlat, start};
  }
  const Eigen::Matrix3f inverse = H.inverse();
  Eigen::Vector2f at = start;
  for (int i = 0; i < options.max_iterations; ++i) {
    const Eigen::Vector2f corner = at - Eigen::Vector2f::Constant(kMiddle);
    const float right = static_cast<float>(level.width - kWindow);
    const float below = static_cast<float>(level.height - kWindow);
    const bool inside = (corner.array() >= 0.0F).all() && corner.x() < right && corner.y() < below;
    if (!inside) return {PatchStatus::kOutside, at};
    const int x = static_cast<int>(corner.x()), y = static_cast<int>(corner.y());
    const detail::WindowSums sums =
        detail::compare(window, level.row(y) + x, level.stride_bytes,
                        corner.x() - static_cast<float>(x), corner.y() - static_cast<float>(y));
    const Eigen::Vector3f b(sums.rx, sums.ry, sums.rg);
    const Eigen::Vector3f step = inverse * b;
    at -= step.head<2>();
    if (!((at - start).squaredNorm() <= options.max_shift * options.max_shift)) {
      return {PatchStatus::kAstray, at};
    }
    if (step.head<2>().squaredNorm() > kSettled * kSettled) continue;
    const float unlike = sums.rr - sums.r * sums.r / static_cast<float>(kPixels) - b.dot(step);
    const bool alike = unlike <= options.max_unlike * H(2, 2);
    const float variance = 0.5F * (inverse(0, 0) + inverse(1, 1)) * unlike / kDegrees;
    return {alike ? PatchStatus::kAligned : PatchStatus::kUnlike, at,
            std::sqrt(std::max(variance, kLeastVariance))};
  }
  return {PatchStatus::kAstray, at};
}

}  // namespace dynslam::features
#endif  // HWY_ONCE
