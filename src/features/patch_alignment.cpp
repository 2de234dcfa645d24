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

WindowSums compare(const WindowTemplate& window, const std::uint8_t* corner, std::ptrdiff_t stride,
                   float a, float b) {
  const D d;
  const V w11 = hn::Set(d, a * b), w10 = hn::Set(d, (1.0F - a) * b);
  const V w01 = hn::Set(d, a * (1.0F - b)), w00 = hn::Set(d, (1.0F - a) * (1.0F - b));
  V r1 = hn::Zero(d), rr = hn::Zero(d), rx = hn::Zero(d), ry = hn::Zero(d), rt = hn::Zero(d);
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
      rt = hn::MulAdd(r, t, rt);
    }
  }
  return {total(d, r1), total(d, rr), total(d, rx), total(d, ry), total(d, rt)};
}

}  // namespace
}  // namespace dynslam::features::detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::features {
namespace detail {

HWY_EXPORT(compare);

WindowSums compare(const WindowTemplate& window, const std::uint8_t* corner, std::ptrdiff_t stride,
                   float a, float b) {
  return HWY_DYNAMIC_DISPATCH(compare)(window, corner, stride, a, b);
}

}  // namespace detail

namespace {

using detail::kWindow;
using detail::WindowTemplate;

constexpr int kPixels = kWindow * kWindow;
constexpr float kMiddle = 0.5F * static_cast<float>(kWindow - 1);  // of the window, its pixels
constexpr float kSettled = 0.02F;  // pixels: a shorter step is the last

/// The patch as the level should show it, with a rim of one pixel for the slopes.
constexpr int kRimmed = kWindow + 2;
using Rimmed = std::array<float, kRimmed * kRimmed>;

// False if the window leaves the patch.
bool warp(const Patch& patch, const Eigen::Matrix2f& A, Rimmed& values) {
  const float reach = kMiddle + 1.0F;
  const Eigen::Vector2f middle =
      patch.offset + Eigen::Vector2f::Constant(static_cast<float>(Patch::kRadius));
  const Eigen::Vector2f extent = reach * A.cwiseAbs().rowwise().sum();
  const float last = static_cast<float>(Patch::kSide - 1);
  if (!((middle - extent).minCoeff() >= 0.0F && (middle + extent).maxCoeff() < last)) return false;
  for (int v = 0; v < kRimmed; ++v) {
    for (int u = 0; u < kRimmed; ++u) {
      const Eigen::Vector2f at = middle + A * Eigen::Vector2f(static_cast<float>(u) - reach,
                                                              static_cast<float>(v) - reach);
      const int x = static_cast<int>(at.x()), y = static_cast<int>(at.y());
      const float a = at.x() - static_cast<float>(x), b = at.y() - static_cast<float>(y);
      const std::uint8_t* upper = patch.pixels.data() + y * Patch::kSide + x;
      const std::uint8_t* lower = upper + Patch::kSide;
      const float top = upper[0] + a * static_cast<float>(upper[1] - upper[0]);
      const float bottom = lower[0] + a * static_cast<float>(lower[1] - lower[0]);
      values[static_cast<std::size_t>(v * kRimmed + u)] = top + b * (bottom - top);
    }
  }
  return true;
}

void subtract_mean(float* values) {
  float sum = 0.0F;
  for (int i = 0; i < kPixels; ++i) sum += values[i];
  for (int i = 0; i < kPixels; ++i) values[i] -= sum / static_cast<float>(kPixels);
}

// Without their means neither brightness nor what is left of it enters the sums.
void fill(const Rimmed& values, WindowTemplate& window) {
  for (int v = 0; v < kWindow; ++v) {
    const float* row = values.data() + (v + 1) * kRimmed + 1;
    for (int u = 0; u < kWindow; ++u) {
      const int at = v * kWindow + u;
      window.gray[at] = row[u];
      window.slope_x[at] = 0.5F * (row[u + 1] - row[u - 1]);
      window.slope_y[at] = 0.5F * (row[u + kRimmed] - row[u - kRimmed]);
    }
  }
  subtract_mean(window.gray);
  subtract_mean(window.slope_x);
  subtract_mean(window.slope_y);
}

/// Normal equations of shift and contrast.
Eigen::Matrix3f normal_matrix(const WindowTemplate& window) {
  using Row = Eigen::Map<const Eigen::Matrix<float, 1, kPixels>>;
  Eigen::Matrix<float, 3, kPixels> J;
  J << Row(window.slope_x), Row(window.slope_y), Row(window.gray);
  return J * J.transpose();
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
  Rimmed rimmed;
  WindowTemplate window;
  if (!warp(patch, A_patch_level, rimmed)) return {PatchStatus::kDistorted, start};
  fill(rimmed, window);
  const Eigen::Matrix3f H = normal_matrix(window);
  if (!(least_slope(H) >= options.min_gradient * options.min_gradient)) {
    return {PatchStatus::kFlat, start};
  }
  const Eigen::Matrix3f inverse = H.inverse();
  Eigen::Vector2f at = start;
  for (int i = 0; i < options.max_iterations; ++i) {
    const Eigen::Vector2f corner = at - Eigen::Vector2f::Constant(kMiddle);
    const float right = static_cast<float>(level.width - kWindow);
    const float below = static_cast<float>(level.height - kWindow);
    const bool inside = corner.minCoeff() >= 0.0F && corner.x() < right && corner.y() < below;
    if (!inside) return {PatchStatus::kOutside, at};
    const int x = static_cast<int>(corner.x()), y = static_cast<int>(corner.y());
    const detail::WindowSums sums =
        detail::compare(window, level.row(y) + x, level.stride_bytes,
                        corner.x() - static_cast<float>(x), corner.y() - static_cast<float>(y));
    const Eigen::Vector3f b(sums.rx, sums.ry, sums.rt);
    const Eigen::Vector3f step = inverse * b;
    at -= step.head<2>();
    if (!((at - start).squaredNorm() <= options.max_shift * options.max_shift)) {
      return {PatchStatus::kAstray, at};
    }
    if (step.head<2>().squaredNorm() > kSettled * kSettled) continue;
    const float unlike = sums.rr - sums.r * sums.r / static_cast<float>(kPixels) - b.dot(step);
    const bool alike = unlike <= options.max_unlike * H(2, 2);
    return {alike ? PatchStatus::kAligned : PatchStatus::kUnlike, at};
  }
  return {PatchStatus::kAstray, at};
}

}  // namespace dynslam::features
#endif  // HWY_ONCE
