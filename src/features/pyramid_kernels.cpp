// Resizing and blurring of pyramid levels.
#include <algorithm>

#include "features/orb_kernels.hpp"
#include "features/orb_reference.hpp"
#include "features/simd.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "features/pyramid_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace dynslam::features::detail::HWY_NAMESPACE {
namespace {

#if HWY_TARGET == HWY_SCALAR

void resize_level_simd(const PixelBlock& source, const ResizeAxis& columns, const ResizeAxis& rows,
                       const MutablePixelBlock& target, std::uint16_t* /*scratch*/) {
  reference::resize_level(source, columns, rows, target);
}

void blur_level_simd(const PixelBlock& source, const MutablePixelBlock& target,
                     std::uint16_t* /*scratch*/) {
  reference::blur_level(source, target);
}

#else

namespace hn = hwy::HWY_NAMESPACE;

// Unsigned 16-bit numbers are kept as signed ones, 32768 less, because the multiplication of pairs
// is signed. Weights sum to 256, so the shift of a weighted sum is known: with it goes the half of
// 2^16 that turns truncation into rounding.
constexpr std::uint16_t kSignShift = 0x8000;
constexpr std::int32_t kUnshiftAndRound = 32768 * 256 + 32768;

/// sum of a_even b_even + a_odd b_odd for each pair of neighbouring lanes, plus `start`.
template <class D32, class V16, class V32>
HWY_INLINE V32 add_products_of_pairs(D32 d32, V16 a, V16 b, V32 start) {
  V32 rest = hn::Zero(d32);
  const V32 sum = hn::ReorderWidenMulAccumulate(d32, a, b, start, rest);
  return hn::RearrangeToOddPlusEven(sum, rest);
}

// ---------------------------------------------------------------------------------------------
// Resize: rows first (whole vectors), then pairs of columns picked by a byte shuffle.
// ---------------------------------------------------------------------------------------------

void blend_rows(const std::uint8_t* HWY_RESTRICT upper, const std::uint8_t* HWY_RESTRICT lower,
                int weight, int width, std::uint16_t* HWY_RESTRICT out) {
  const hn::ScalableTag<std::uint16_t> d16;
  const hn::Rebind<std::uint8_t, decltype(d16)> d8;
  const int lanes = static_cast<int>(hn::Lanes(d16));
  const auto upper_weight = hn::Set(d16, static_cast<std::uint16_t>(256 - weight));
  const auto lower_weight = hn::Set(d16, static_cast<std::uint16_t>(weight));
  const auto shift = hn::Set(d16, kSignShift);
  for (int x = 0; x < width; x += lanes) {
    const auto a = hn::PromoteTo(d16, hn::LoadU(d8, upper + x));
    const auto b = hn::PromoteTo(d16, hn::LoadU(d8, lower + x));
    const auto sum = hn::Add(hn::Mul(a, upper_weight), hn::Mul(b, lower_weight));
    hn::StoreU(hn::Xor(sum, shift), d16, out + x);
  }
}

/// Four outputs from eight neighbouring inputs.
struct ResizeStep {
  alignas(16) std::uint8_t shuffle[16];
  alignas(16) std::int16_t weights[8];
  std::int32_t first;
};

constexpr int kStepsAtOnce = 64;

/// Fills the steps for the outputs x .. x + 4 count. False if four outputs reach over more than
/// eight inputs.
bool plan_steps(const ResizeAxis& columns, int x, int count, int width, ResizeStep* steps) {
  for (int s = 0; s < count; ++s) {
    ResizeStep& step = steps[s];
    step.first = columns.first[std::min(x + 4 * s, width - 1)];
    for (int i = 0; i < 4; ++i) {
      const int column = std::min(x + 4 * s + i, width - 1);
      const int at = columns.first[column] - step.first;
      if (at + 1 >= 8) return false;
      for (int byte = 0; byte < 4; ++byte) {
        step.shuffle[4 * i + byte] = static_cast<std::uint8_t>(2 * at + byte);
      }
      step.weights[2 * i] = static_cast<std::int16_t>(256 - columns.weight[column]);
      step.weights[2 * i + 1] = static_cast<std::int16_t>(columns.weight[column]);
    }
  }
  return true;
}

HWY_INLINE hn::Vec<hn::FixedTag<std::int32_t, 4>> blend_columns(const std::uint16_t* row,
                                                                const ResizeStep& step) {
  const hn::FixedTag<std::uint8_t, 16> d8;
  const hn::FixedTag<std::int16_t, 8> d16;
  const hn::FixedTag<std::int32_t, 4> d32;
  const auto pixels = hn::LoadU(d8, reinterpret_cast<const std::uint8_t*>(row + step.first));
  const auto pairs = hn::BitCast(d16, hn::TableLookupBytes(pixels, hn::Load(d8, step.shuffle)));
  const auto sum = add_products_of_pairs(d32, pairs, hn::Load(d16, step.weights),
                                         hn::Set(d32, kUnshiftAndRound));
  return hn::ShiftRight<16>(sum);
}

/// Outputs x .. x + 4 count of a row; count is even.
HWY_INLINE void apply_steps(const std::uint16_t* row, const ResizeStep* steps, int count,
                            std::uint8_t* out) {
  const hn::FixedTag<std::int16_t, 8> d16;
  const hn::FixedTag<std::uint8_t, 8> d8;
  for (int s = 0; s < count; s += 2) {
    const auto words =
        hn::ReorderDemote2To(d16, blend_columns(row, steps[s]), blend_columns(row, steps[s + 1]));
    hn::StoreU(hn::DemoteTo(d8, words), d8, out + 4 * s);
  }
}

void blend_columns_one_by_one(const std::uint16_t* row, const ResizeAxis& columns, int begin,
                              int end, std::uint8_t* out) {
  for (int x = begin; x < end; ++x) {
    const int left = row[columns.first[x]] ^ kSignShift;
    const int right = row[columns.first[x] + 1] ^ kSignShift;
    const int weight = columns.weight[x];
    out[x] = static_cast<std::uint8_t>((left * (256 - weight) + right * weight + (1 << 15)) >> 16);
  }
}

void resize_level_simd(const PixelBlock& source, const ResizeAxis& columns, const ResizeAxis& rows,
                       const MutablePixelBlock& target, std::uint16_t* scratch) {
  // A strip of columns at a time, so that its steps are planned once and stay in the cache.
  constexpr int strip = 4 * kStepsAtOnce;
  ResizeStep steps[kStepsAtOnce];
  for (int x = 0; x < target.width; x += strip) {
    const int end = std::min(x + strip, target.width);
    const int count = ((end - x) + 7) / 8 * 2;
    const bool planned = plan_steps(columns, x, count, target.width, steps);
    const int source_begin = columns.first[x];
    const int source_end = std::min(columns.first[end - 1] + 2, source.width);
    for (int y = 0; y < target.height; ++y) {
      const std::uint8_t* upper = source.row(rows.first[y]);
      blend_rows(upper + source_begin, upper + source.stride + source_begin, rows.weight[y],
                 source_end - source_begin, scratch + source_begin);
      if (planned) {
        apply_steps(scratch, steps, count, target.row(y) + x);
      } else {
        blend_columns_one_by_one(scratch, columns, x, end, target.row(y));
      }
    }
  }
}

// ---------------------------------------------------------------------------------------------
// Blur: columns first into a row of 16-bit sums, then along that row.
// ---------------------------------------------------------------------------------------------

void blur_columns(const std::uint8_t* const rows[7], int width, std::uint16_t* HWY_RESTRICT out) {
  const hn::ScalableTag<std::uint16_t> d16;
  const hn::Rebind<std::uint8_t, decltype(d16)> d8;
  const int lanes = static_cast<int>(hn::Lanes(d16));
  const auto w0 = hn::Set(d16, static_cast<std::uint16_t>(kBlurWeights[0]));
  const auto w1 = hn::Set(d16, static_cast<std::uint16_t>(kBlurWeights[1]));
  const auto w2 = hn::Set(d16, static_cast<std::uint16_t>(kBlurWeights[2]));
  const auto w3 = hn::Set(d16, static_cast<std::uint16_t>(kBlurWeights[3]));
  const auto shift = hn::Set(d16, kSignShift);
  const auto pixels = [&](int row, int x)
                          HWY_ATTR { return hn::PromoteTo(d16, hn::LoadU(d8, rows[row] + x)); };
  for (int x = 0; x < width; x += lanes) {
    const auto outer = hn::Mul(hn::Add(pixels(0, x), pixels(6, x)), w0);
    const auto next = hn::Mul(hn::Add(pixels(1, x), pixels(5, x)), w1);
    const auto inner = hn::Mul(hn::Add(pixels(2, x), pixels(4, x)), w2);
    const auto centre = hn::Mul(pixels(3, x), w3);
    const auto sum = hn::Add(hn::Add(outer, next), hn::Add(inner, centre));
    hn::StoreU(hn::Xor(sum, shift), d16, out + x);
  }
}

/// `sums` reaches 3 numbers beyond both ends of the row.
void blur_along_row(const std::uint16_t* sums, int width, std::uint8_t* HWY_RESTRICT out) {
  const hn::ScalableTag<std::int16_t> d16;
  const hn::RepartitionToWide<decltype(d16)> d32;
  const hn::Rebind<std::uint8_t, decltype(d16)> d8;
  const int lanes = static_cast<int>(hn::Lanes(d16));
  const std::int16_t* in = reinterpret_cast<const std::int16_t*>(sums);
  const auto w0 = hn::Set(d16, static_cast<std::int16_t>(kBlurWeights[0]));
  const auto w1 = hn::Set(d16, static_cast<std::int16_t>(kBlurWeights[1]));
  const auto w2 = hn::Set(d16, static_cast<std::int16_t>(kBlurWeights[2]));
  // The centre is paired with 0.
  const auto w3 = hn::Set(d16, static_cast<std::int16_t>(kBlurWeights[3]));
  const auto start = hn::Set(d32, kUnshiftAndRound);
  const auto zero = hn::Zero(d16);
  for (int x = 0; x < width; x += lanes) {
    const auto a = hn::LoadU(d16, in + x - 3);
    const auto b = hn::LoadU(d16, in + x - 2);
    const auto c = hn::LoadU(d16, in + x - 1);
    const auto d = hn::LoadU(d16, in + x);
    const auto e = hn::LoadU(d16, in + x + 1);
    const auto f = hn::LoadU(d16, in + x + 2);
    const auto g = hn::LoadU(d16, in + x + 3);
    auto lower = add_products_of_pairs(d32, hn::InterleaveLower(d16, a, g), w0, start);
    auto upper = add_products_of_pairs(d32, hn::InterleaveUpper(d16, a, g), w0, start);
    lower = add_products_of_pairs(d32, hn::InterleaveLower(d16, b, f), w1, lower);
    upper = add_products_of_pairs(d32, hn::InterleaveUpper(d16, b, f), w1, upper);
    lower = add_products_of_pairs(d32, hn::InterleaveLower(d16, c, e), w2, lower);
    upper = add_products_of_pairs(d32, hn::InterleaveUpper(d16, c, e), w2, upper);
    lower = add_products_of_pairs(d32, hn::InterleaveLower(d16, d, zero), w3, lower);
    upper = add_products_of_pairs(d32, hn::InterleaveUpper(d16, d, zero), w3, upper);
    // Interleaving and narrowing both work on blocks of 128 bits, so the order is restored.
    const auto words =
        hn::ReorderDemote2To(d16, hn::ShiftRight<16>(lower), hn::ShiftRight<16>(upper));
    hn::StoreU(hn::DemoteTo(d8, words), d8, out + x);
  }
}

void blur_level_simd(const PixelBlock& source, const MutablePixelBlock& target,
                     std::uint16_t* scratch) {
  std::uint16_t* sums = scratch + kRowSlack;
  const int width = source.width;
  for (int y = 0; y < source.height; ++y) {
    const std::uint8_t* rows[7];
    for (int j = 0; j < 7; ++j) rows[j] = source.row(reference::mirrored(y + j - 3, source.height));
    blur_columns(rows, width, sums);
    for (int i = 1; i <= 3; ++i) {
      sums[-i] = sums[i];
      sums[width - 1 + i] = sums[width - 1 - i];
    }
    blur_along_row(sums, width, target.row(y));
  }
}

#endif

}  // namespace

// Names for the dispatch tables, which cannot see into an anonymous namespace.
void resize_level_target(const PixelBlock& source, const ResizeAxis& columns,
                         const ResizeAxis& rows, const MutablePixelBlock& target,
                         std::uint16_t* scratch) {
  resize_level_simd(source, columns, rows, target, scratch);
}

void blur_level_target(const PixelBlock& source, const MutablePixelBlock& target,
                       std::uint16_t* scratch) {
  blur_level_simd(source, target, scratch);
}

}  // namespace dynslam::features::detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::features::detail {

HWY_EXPORT(resize_level_target);
HWY_EXPORT(blur_level_target);

void resize_level(const PixelBlock& source, const ResizeAxis& columns, const ResizeAxis& rows,
                  const MutablePixelBlock& target, std::uint16_t* scratch) {
  HWY_DYNAMIC_DISPATCH(resize_level_target)(source, columns, rows, target, scratch);
}

void blur_level(const PixelBlock& source, const MutablePixelBlock& target, std::uint16_t* scratch) {
  HWY_DYNAMIC_DISPATCH(blur_level_target)(source, target, scratch);
}

}  // namespace dynslam::features::detail
#endif
