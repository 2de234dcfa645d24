#include "attention/pointwise_kernels.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "attention/simd.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "attention/pointwise_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "attention/vector_math-inl.hpp"

HWY_BEFORE_NAMESPACE();
namespace dynslam::attention::detail::HWY_NAMESPACE {
namespace {

// Output channels that are summed at once, so that sums and operands fit in the registers: 8 x 3
// of 32, 4 x 3 of 16.
#if HWY_TARGET == HWY_AVX3 || HWY_TARGET == HWY_AVX3_DL || HWY_TARGET == HWY_NEON
constexpr std::size_t kRows = 8;
#else
constexpr std::size_t kRows = 4;
#endif

// Columns of weights that are summed at once, so that their part of a panel stays in the first
// cache (24 KiB of 32 or 48). What was summed so far waits in the output.
constexpr std::size_t kDepthBlock = 128;

/// A part of the depth: whether sums start there and whether they end there.
struct Part {
  int depth = 0;
  bool first = true;
  bool last = true;
};

/// One vector of pixels for twice as many output channels: for the last pixels of a map, of which
/// a tile of three would waste most.
template <Activation kActivation, std::size_t... kIndex>
HWY_INLINE void narrow_tile(const float* HWY_RESTRICT weights, const float* bias,
                            const float* HWY_RESTRICT panel, std::size_t pitch, const Part& part,
                            float* output, std::size_t output_stride, std::size_t rows,
                            std::size_t pixels, std::index_sequence<kIndex...>) {
  const D d;
  V sums[sizeof...(kIndex)] = {
      (part.first ? hn::Set(d, bias[kIndex])
                  : load_up_to(output + std::min(kIndex, rows - 1) * output_stride, pixels))...};
  for (int k = 0; k < part.depth; ++k) {
    const V x = hn::LoadU(d, panel);
    ((sums[kIndex] = hn::MulAdd(hn::Set(d, weights[kIndex]), x, sums[kIndex])), ...);
    panel += pitch;
    weights += kPackedRows;
  }
  ((kIndex < rows ? store_up_to(part.last ? activate<kActivation>(sums[kIndex]) : sums[kIndex],
                                output + kIndex * output_stride, pixels)
                  : void()),
   ...);
}

/// A row of the tile: three vectors of neighbouring pixels.
struct Row {
  V a;
  V b;
  V c;
};

HWY_INLINE void accumulate(Row& row, V weight, V x, V y, V z) {
  row.a = hn::MulAdd(weight, x, row.a);
  row.b = hn::MulAdd(weight, y, row.b);
  row.c = hn::MulAdd(weight, z, row.c);
}

HWY_INLINE Row start_row(const Part& part, float bias, const float* sums, std::size_t pixels) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const V start = hn::Set(d, bias);
  if (part.first) return {start, start, start};
  if (pixels == 3 * lanes) {
    return {hn::LoadU(d, sums), hn::LoadU(d, sums + lanes), hn::LoadU(d, sums + 2 * lanes)};
  }
  return {load_up_to(sums, pixels),
          pixels > lanes ? load_up_to(sums + lanes, pixels - lanes) : start,
          pixels > 2 * lanes ? load_up_to(sums + 2 * lanes, pixels - 2 * lanes) : start};
}

template <Activation kActivation>
HWY_INLINE void store_row(const Row& row, float* at, std::size_t pixels) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const V a = activate<kActivation>(row.a);
  const V b = activate<kActivation>(row.b);
  const V c = activate<kActivation>(row.c);
  if (pixels == 3 * lanes) {
    hn::StoreU(a, d, at);
    hn::StoreU(b, d, at + lanes);
    hn::StoreU(c, d, at + 2 * lanes);
    return;
  }
  store_up_to(a, at, pixels);
  if (pixels > lanes) store_up_to(b, at + lanes, pixels - lanes);
  if (pixels > 2 * lanes) store_up_to(c, at + 2 * lanes, pixels - 2 * lanes);
}

/// kRows output channels of one panel. The sequence stands for loops that must be unrolled.
template <Activation kActivation, std::size_t... kIndex>
HWY_INLINE void tile(const float* HWY_RESTRICT weights, const float* bias,
                     const float* HWY_RESTRICT panel, std::size_t pitch, const Part& part,
                     float* output, std::size_t output_stride, std::size_t rows, std::size_t pixels,
                     std::index_sequence<kIndex...>) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  Row tile_rows[kRows] = {start_row(
      part, bias[kIndex], output + std::min(kIndex, rows - 1) * output_stride, pixels)...};
  for (int k = 0; k < part.depth; ++k) {
    const V x = hn::LoadU(d, panel);
    const V y = hn::LoadU(d, panel + lanes);
    const V z = hn::LoadU(d, panel + 2 * lanes);
    (accumulate(tile_rows[kIndex], hn::Set(d, weights[kIndex]), x, y, z), ...);
    panel += pitch;
    weights += kPackedRows;
  }
  if (part.last) {
    ((kIndex < rows
          ? store_row<kActivation>(tile_rows[kIndex], output + kIndex * output_stride, pixels)
          : void()),
     ...);
  } else {
    ((kIndex < rows
          ? store_row<Activation::kNone>(tile_rows[kIndex], output + kIndex * output_stride, pixels)
          : void()),
     ...);
  }
}

/// All output channels over one part of the depth, `at` columns in.
template <Activation kActivation>
void part_of_rows(const Product& product, const float* panel, std::size_t pitch, std::size_t begin,
                  std::size_t pixels, std::size_t at, const Part& part) {
  const PackedWeights& weights = *product.weights;
  const auto rows = static_cast<std::size_t>(weights.rows);
  const auto depth = static_cast<std::size_t>(weights.depth);
  const bool narrow = pixels <= hn::Lanes(D());
  const std::size_t step = narrow ? kPackedRows : kRows;
  for (std::size_t row = 0; row < rows; row += step) {
    const float* block = weights.values.data() + row / kPackedRows * kPackedRows * depth +
                         row % kPackedRows + at * kPackedRows;
    const float* bias = weights.bias.data() + row;
    float* output = product.output + row * product.output_stride + begin;
    if (narrow) {
      narrow_tile<kActivation>(block, bias, panel, pitch, part, output, product.output_stride,
                               rows - row, pixels, std::make_index_sequence<kPackedRows>());
    } else {
      tile<kActivation>(block, bias, panel, pitch, part, output, product.output_stride, rows - row,
                        pixels, std::make_index_sequence<kRows>());
    }
  }
}

template <Activation kActivation>
void all_rows(const Product& product, const float* panel, std::size_t pitch, std::size_t begin,
              std::size_t pixels) {
  const auto depth = static_cast<std::size_t>(product.weights->depth);
  for (std::size_t at = 0; at < depth; at += kDepthBlock) {
    const std::size_t columns = std::min(kDepthBlock, depth - at);
    const Part part = {static_cast<int>(columns), at == 0, at + columns == depth};
    part_of_rows<kActivation>(product, panel + at * pitch, pitch, begin, pixels, at, part);
  }
}

/// Pixels [begin, begin + pixels) of every channel, padded by zeros to `pitch`.
void pack_plain(const Product& product, std::size_t begin, std::size_t pixels, std::size_t pitch) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const std::size_t plane =
      static_cast<std::size_t>(product.height) * static_cast<std::size_t>(product.width);
  const float* from = product.input + begin;
  float* to = product.panel;
  for (int k = 0; k < product.weights->depth; ++k) {
    if (pixels == pitch) {
      for (std::size_t i = 0; i < pitch; i += lanes) hn::StoreU(hn::LoadU(d, from + i), d, to + i);
    } else {
      std::memcpy(to, from, pixels * sizeof(float));
      std::fill(to + pixels, to + pitch, 0.0F);
    }
    from += plane;
    to += pitch;
  }
}

/// Sums of neighbouring pairs: lanes values from twice as many.
HWY_INLINE V pair_sums(V low, V high) {
#if HWY_TARGET == HWY_SCALAR
  return hn::Add(low, high);
#else
  const D d;
  return hn::Add(hn::ConcatEven(d, high, low), hn::ConcatOdd(d, high, low));
#endif
}

/// Means over 2x2 of `count` neighbouring pixels of one row of the halved map.
HWY_INLINE void pool_run(const float* upper, const float* lower, float* to, std::size_t count) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const V quarter = hn::Set(d, 0.25F);
  std::size_t i = 0;
  for (; i + lanes <= count; i += lanes) {
    const V low = hn::Add(hn::LoadU(d, upper + 2 * i), hn::LoadU(d, lower + 2 * i));
    const V high =
        hn::Add(hn::LoadU(d, upper + 2 * i + lanes), hn::LoadU(d, lower + 2 * i + lanes));
    hn::StoreU(hn::Mul(quarter, pair_sums(low, high)), d, to + i);
  }
  if (i < count) {
    // Up to two vectors of each row; what lies beyond is 0.
    const std::size_t rest = 2 * (count - i);
    const V low = hn::Add(load_up_to(upper + 2 * i, rest), load_up_to(lower + 2 * i, rest));
    V high = hn::Zero(d);
    if (rest > lanes) {
      high = hn::Add(load_up_to(upper + 2 * i + lanes, rest - lanes),
                     load_up_to(lower + 2 * i + lanes, rest - lanes));
    }
    store_up_to(hn::Mul(quarter, pair_sums(low, high)), to + i, count - i);
  }
}

void pack_pooled(const Product& product, std::size_t begin, std::size_t pixels, std::size_t pitch) {
  const auto width = static_cast<std::size_t>(product.width);
  const std::size_t plane = static_cast<std::size_t>(product.height) * width;
  const std::size_t half = width / 2;
  float* to = product.panel;
  for (int k = 0; k < product.weights->depth; ++k) {
    const float* from = product.input + static_cast<std::size_t>(k) * plane;
    std::size_t done = 0;
    while (done < pixels) {
      const std::size_t y = (begin + done) / half;
      const std::size_t x = (begin + done) % half;
      const std::size_t run = std::min(half - x, pixels - done);
      const float* upper = from + 2 * y * width + 2 * x;
      pool_run(upper, upper + width, to + done, run);
      done += run;
    }
    std::fill(to + pixels, to + pitch, 0.0F);
    to += pitch;
  }
}

/// `count` values of a row from column `x` on, which may lie outside of the row, where they are 0.
void copy_window(const float* row, std::ptrdiff_t x, std::ptrdiff_t width, float* to,
                 std::size_t count) {
  const auto n = static_cast<std::ptrdiff_t>(count);
  const std::ptrdiff_t first = std::clamp<std::ptrdiff_t>(-x, 0, n);
  const std::ptrdiff_t last = std::clamp<std::ptrdiff_t>(width - x, first, n);
  std::fill(to, to + first, 0.0F);
  std::copy(row + x + first, row + x + last, to + first);
  std::fill(to + last, to + n, 0.0F);
}

void pack_window(const Product& product, std::size_t begin, std::size_t pixels, std::size_t pitch) {
  const auto width = static_cast<std::size_t>(product.width);
  const std::size_t plane = static_cast<std::size_t>(product.height) * width;
  float* to = product.panel;
  for (int k = 0; k < product.weights->depth; ++k, to += pitch) {
    const float* from = product.input + static_cast<std::size_t>(k / 9) * plane;
    const int dy = k % 9 / 3 - 1;
    const int dx = k % 3 - 1;
    std::size_t done = 0;
    while (done < pixels) {
      const std::size_t y = (begin + done) / width;
      const std::size_t x = (begin + done) % width;
      const std::size_t run = std::min(width - x, pixels - done);
      const std::ptrdiff_t row = static_cast<std::ptrdiff_t>(y) + dy;
      if (row < 0 || row >= product.height) {
        std::fill(to + done, to + done + run, 0.0F);
      } else {
        copy_window(from + static_cast<std::size_t>(row) * width,
                    static_cast<std::ptrdiff_t>(x) + dx, product.width, to + done, run);
      }
      done += run;
    }
    std::fill(to + pixels, to + pitch, 0.0F);
  }
}

template <Activation kActivation>
void multiply_panels(const Product& product) {
  const D d;
  const std::size_t pitch = 3 * hn::Lanes(d);
  const std::size_t plane =
      static_cast<std::size_t>(product.height) * static_cast<std::size_t>(product.width);
  // A panel that is read only once or twice is not worth a copy.
  const bool in_place =
      product.source == Source::kPlain && product.weights->rows <= 2 * static_cast<int>(kRows);
  for (std::size_t at = product.begin; at < product.end; at += pitch) {
    const std::size_t pixels = std::min(pitch, product.end - at);
    if (in_place && pixels == pitch) {
      all_rows<kActivation>(product, product.input + at, plane, at, pixels);
      continue;
    }
    if (product.source == Source::kPlain) pack_plain(product, at, pixels, pitch);
    if (product.source == Source::kPooled2) pack_pooled(product, at, pixels, pitch);
    if (product.source == Source::kWindow3) pack_window(product, at, pixels, pitch);
    all_rows<kActivation>(product, product.panel, pitch, at, pixels);
  }
}

/// Four rows of c, so that a row of b is read once for them.
HWY_INLINE void small_rows(const float* a, const float* b, float* c, std::size_t rows, int k,
                           std::size_t n) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const auto depth = static_cast<std::size_t>(k);
  const float* a1 = a + (rows > 1 ? depth : 0);
  const float* a2 = a + (rows > 2 ? 2 * depth : 0);
  const float* a3 = a + (rows > 3 ? 3 * depth : 0);
  for (std::size_t x = 0; x < n; x += lanes) {
    V s0 = hn::Zero(d);
    V s1 = s0;
    V s2 = s0;
    V s3 = s0;
    for (std::size_t j = 0; j < depth; ++j) {
      const V v = load_up_to(b + j * n + x, n - x);
      s0 = hn::MulAdd(hn::Set(d, a[j]), v, s0);
      s1 = hn::MulAdd(hn::Set(d, a1[j]), v, s1);
      s2 = hn::MulAdd(hn::Set(d, a2[j]), v, s2);
      s3 = hn::MulAdd(hn::Set(d, a3[j]), v, s3);
    }
    store_up_to(s0, c + x, n - x);
    if (rows > 1) store_up_to(s1, c + n + x, n - x);
    if (rows > 2) store_up_to(s2, c + 2 * n + x, n - x);
    if (rows > 3) store_up_to(s3, c + 3 * n + x, n - x);
  }
}

}  // namespace

// Names for the dispatch tables, which cannot see into an anonymous namespace.
void multiply_target(const Product& product) {
  switch (product.activation) {
    case Activation::kNone:
      return multiply_panels<Activation::kNone>(product);
    case Activation::kRelu:
      return multiply_panels<Activation::kRelu>(product);
    case Activation::kSilu:
      return multiply_panels<Activation::kSilu>(product);
  }
}

void multiply_small_target(const float* a, const float* b, float* c, int m, int k, int n) {
  const auto columns = static_cast<std::size_t>(n);
  for (int i = 0; i < m; i += 4) {
    const auto row = static_cast<std::size_t>(i);
    small_rows(a + row * static_cast<std::size_t>(k), b, c + row * columns,
               static_cast<std::size_t>(std::min(4, m - i)), k, columns);
  }
}

void multiply_columns_target(const float* a, const float* b, float* out, int m, int k, int n) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const auto columns = static_cast<std::size_t>(n);
  for (int i = 0; i < m; ++i) {
    for (std::size_t x = 0; x < columns; x += lanes) {
      V sum = hn::Zero(d);
      const float* from = a + x;
      for (int j = 0; j < k; ++j, from += columns) {
        const V v = load_up_to(b + static_cast<std::size_t>(j) * columns + x, columns - x);
        sum = hn::MulAdd(load_up_to(from, columns - x), v, sum);
      }
      store_up_to(sum, out + static_cast<std::size_t>(i) * columns + x, columns - x);
    }
    a += static_cast<std::size_t>(k) * columns;
  }
}

}  // namespace dynslam::attention::detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::attention::detail {

HWY_EXPORT(multiply_target);
HWY_EXPORT(multiply_small_target);
HWY_EXPORT(multiply_columns_target);

PackedWeights pack(const Convolution& convolution) {
  PackedWeights packed;
  packed.rows = convolution.out_channels;
  packed.depth = convolution.group_channels * convolution.kernel_height * convolution.kernel_width;
  const auto rows = static_cast<std::size_t>(packed.rows);
  const auto depth = static_cast<std::size_t>(packed.depth);
  const std::size_t padded = (rows + kPackedRows - 1) / kPackedRows * kPackedRows;
  packed.values.assign(padded * depth, 0.0F);
  packed.bias.assign(padded, 0.0F);
  std::copy(convolution.bias.begin(), convolution.bias.end(), packed.bias.begin());
  for (std::size_t r = 0; r < rows; ++r) {
    float* block = packed.values.data() + r / kPackedRows * kPackedRows * depth + r % kPackedRows;
    for (std::size_t k = 0; k < depth; ++k) {
      block[k * kPackedRows] = convolution.weight[r * depth + k];
    }
  }
  return packed;
}

void multiply(const Product& product) { HWY_DYNAMIC_DISPATCH(multiply_target)(product); }

void multiply_small(const float* a, const float* b, float* c, int m, int k, int n) {
  HWY_DYNAMIC_DISPATCH(multiply_small_target)(a, b, c, m, k, n);
}

void multiply_columns(const float* a, const float* b, float* out, int m, int k, int n) {
  HWY_DYNAMIC_DISPATCH(multiply_columns_target)(a, b, out, m, k, n);
}

}  // namespace dynslam::attention::detail
#endif
