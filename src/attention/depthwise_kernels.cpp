#include "attention/depthwise_kernels.hpp"

#include <algorithm>
#include <cstring>

#include "attention/simd.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "attention/depthwise_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "attention/vector_math-inl.hpp"

HWY_BEFORE_NAMESPACE();
namespace dynslam::attention::detail::HWY_NAMESPACE {
namespace {

/// The plane with `pad` zeros around it and zeros behind every row that vectors may read.
void pad_plane(const float* input, int height, int width, std::size_t pad, std::size_t pitch,
               float* padded) {
  const auto columns = static_cast<std::size_t>(width);
  std::fill(padded, padded + pad * pitch + pad, 0.0F);
  float* row = padded + pad * pitch + pad;
  for (int y = 0; y < height; ++y) {
    std::memcpy(row, input, columns * sizeof(float));
    std::fill(row + columns, row + pitch, 0.0F);
    input += columns;
    row += pitch;
  }
  std::fill(row, row + pad * pitch + kRowSlack, 0.0F);
}

template <Activation kActivation>
HWY_INLINE void finish(V sum, const DepthwisePlane& plane, std::size_t at, std::size_t count) {
  V v = activate<kActivation>(sum);
  if (plane.add != nullptr) v = hn::Add(v, load_up_to(plane.add + at, count));
  store_up_to(v, plane.output + at, count);
}

/// 3x3 with stride 1: two rows at a time share the rows between them.
template <Activation kActivation>
void rows_of_3(const DepthwisePlane& plane, const float* padded, std::size_t pitch) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const auto width = static_cast<std::size_t>(plane.width);
  const V bias = hn::Set(d, plane.bias);
  V w[9] = {hn::Set(d, plane.weight[0]), hn::Set(d, plane.weight[1]), hn::Set(d, plane.weight[2]),
            hn::Set(d, plane.weight[3]), hn::Set(d, plane.weight[4]), hn::Set(d, plane.weight[5]),
            hn::Set(d, plane.weight[6]), hn::Set(d, plane.weight[7]), hn::Set(d, plane.weight[8])};
  const auto taps = [&](V sum, std::size_t row, V a, V b, V c) HWY_ATTR {
    sum = hn::MulAdd(w[3 * row], a, sum);
    sum = hn::MulAdd(w[3 * row + 1], b, sum);
    return hn::MulAdd(w[3 * row + 2], c, sum);
  };
  for (int y = 0; y < plane.height; y += 2) {
    const bool two = y + 1 < plane.height;
    const float* row = padded + static_cast<std::size_t>(y) * pitch;
    const std::size_t out = static_cast<std::size_t>(y) * width;
    for (std::size_t x = 0; x < width; x += lanes) {
      const float* at = row + x;
      V upper = taps(bias, 0, hn::LoadU(d, at), hn::LoadU(d, at + 1), hn::LoadU(d, at + 2));
      at += pitch;
      V a = hn::LoadU(d, at);
      V b = hn::LoadU(d, at + 1);
      V c = hn::LoadU(d, at + 2);
      upper = taps(upper, 1, a, b, c);
      V lower = taps(bias, 0, a, b, c);
      at += pitch;
      a = hn::LoadU(d, at);
      b = hn::LoadU(d, at + 1);
      c = hn::LoadU(d, at + 2);
      upper = taps(upper, 2, a, b, c);
      finish<kActivation>(upper, plane, out + x, width - x);
      if (!two) continue;
      lower = taps(lower, 1, a, b, c);
      at += pitch;
      lower = taps(lower, 2, hn::LoadU(d, at), hn::LoadU(d, at + 1), hn::LoadU(d, at + 2));
      finish<kActivation>(lower, plane, out + width + x, width - x);
    }
  }
}

template <Activation kActivation>
void rows_of_any(const DepthwisePlane& plane, const float* padded, std::size_t pitch) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const auto stride = static_cast<std::size_t>(plane.stride);
  const int height = (plane.height - 1) / plane.stride + 1;
  const auto width = static_cast<std::size_t>((plane.width - 1) / plane.stride + 1);
  const auto kernel = static_cast<std::size_t>(plane.kernel);
  alignas(64) float gathered[16] = {};
  for (int y = 0; y < height; ++y) {
    const float* row = padded + static_cast<std::size_t>(y) * stride * pitch;
    for (std::size_t x = 0; x < width; x += lanes) {
      const std::size_t count = std::min(lanes, width - x);
      V sum = hn::Set(d, plane.bias);
      for (std::size_t k = 0; k < kernel * kernel; ++k) {
        const float* at = row + k / kernel * pitch + k % kernel + x * stride;
        if (stride == 1) {
          sum = hn::MulAdd(hn::Set(d, plane.weight[k]), hn::LoadU(d, at), sum);
          continue;
        }
        for (std::size_t i = 0; i < count; ++i) gathered[i] = at[i * stride];
        sum = hn::MulAdd(hn::Set(d, plane.weight[k]), hn::Load(d, gathered), sum);
      }
      finish<kActivation>(sum, plane, static_cast<std::size_t>(y) * width + x, width - x);
    }
  }
}

template <Activation kActivation>
void convolve_plane(const DepthwisePlane& plane) {
  const auto pad = static_cast<std::size_t>((plane.kernel - 1) / 2);
  const std::size_t pitch = padded_pitch(plane.kernel, plane.width);
  pad_plane(plane.input, plane.height, plane.width, pad, pitch, plane.scratch);
  if (plane.kernel == 3 && plane.stride == 1) {
    rows_of_3<kActivation>(plane, plane.scratch, pitch);
  } else {
    rows_of_any<kActivation>(plane, plane.scratch, pitch);
  }
}

/// sum_k weights[k] from[i + k * step] + bias for i < count, and more up to a whole vector.
/// kTaps 0: any number of them.
template <std::size_t kTaps, bool kSigmoid>
HWY_INLINE void slide(const float* weights, std::size_t taps, float bias, const float* from,
                      std::size_t step, float* to, std::size_t count) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const std::size_t n = kTaps == 0 ? taps : kTaps;
  for (std::size_t i = 0; i < count; i += lanes) {
    const float* at = from + i;
    V sum = hn::Set(d, bias);
    for (std::size_t k = 0; k < n; ++k) {
      sum = hn::MulAdd(hn::Set(d, weights[k]), hn::LoadU(d, at + k * step), sum);
    }
    hn::StoreU(kSigmoid ? sigmoid(sum) : sum, d, to + i);
  }
}

template <bool kSigmoid>
HWY_INLINE void slide_any(const float* weights, int taps, float bias, const float* from,
                          std::size_t step, float* to, std::size_t count) {
  if (taps == 5) {
    slide<5, kSigmoid>(weights, 5, bias, from, step, to, count);
  } else {
    slide<0, kSigmoid>(weights, static_cast<std::size_t>(taps), bias, from, step, to, count);
  }
}

/// Rows one behind the other with `pad` zeros before, between and behind them. Whole vectors are
/// written, of which the next row covers what is too much.
HWY_INLINE void space_rows(const float* from, std::size_t height, std::size_t width,
                           std::size_t pad, std::size_t pitch, float* to) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  std::fill(to, to + pad, 0.0F);
  float* row = to + pad;
  for (std::size_t y = 0; y < height; ++y, row += pitch, from += width) {
    const std::size_t rest = (height - y) * width;
    for (std::size_t x = 0; x < width; x += lanes) {
      hn::StoreU(load_up_to(from + x, rest - x), d, row + x);
    }
    std::size_t x = width;
    do {
      hn::StoreU(hn::Zero(d), d, row + x);
      x += lanes;
    } while (x < pitch);
  }
  std::fill(row, row + pad + kRowSlack, 0.0F);
}

HWY_INLINE void multiply_up_to(V gate, const float* features, float* out, std::size_t count) {
  store_up_to(hn::Mul(load_up_to(features, count), gate), out, count);
}

/// Two rows of the output from one of gates: every gate serves 2x2 values.
HWY_INLINE void multiply_doubled(const float* gates, const float* features, float* out,
                                 std::size_t width) {
#if HWY_TARGET == HWY_SCALAR
  for (std::size_t i = 0; i < width; ++i) {
    out[i] = features[i] * gates[i / 2];
    out[width + i] = features[width + i] * gates[i / 2];
  }
#else
  const D d;
  const hn::RebindToSigned<D> di;
  const std::size_t lanes = hn::Lanes(d);
  const auto iota = hn::ShiftRight<1>(hn::Iota(di, 0));
  const auto low = hn::IndicesFromVec(d, iota);
  const auto high =
      hn::IndicesFromVec(d, hn::Add(iota, hn::Set(di, static_cast<std::int32_t>(lanes / 2))));
  for (std::size_t x = 0; x < width; x += 2 * lanes) {
    const V v = hn::LoadU(d, gates + x / 2);
    const V first = hn::TableLookupLanes(v, low);
    multiply_up_to(first, features + x, out + x, width - x);
    multiply_up_to(first, features + width + x, out + width + x, width - x);
    if (x + lanes >= width) break;
    const std::size_t next = x + lanes;
    const V second = hn::TableLookupLanes(v, high);
    multiply_up_to(second, features + next, out + next, width - next);
    multiply_up_to(second, features + width + next, out + width + next, width - next);
  }
#endif
}

HWY_INLINE void multiply_row(const float* a, const float* b, float* out, std::size_t count) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  std::size_t x = 0;
  for (; x + lanes <= count; x += lanes) {
    hn::StoreU(hn::Mul(hn::LoadU(d, a + x), hn::LoadU(d, b + x)), d, out + x);
  }
  if (x < count) {
    const std::size_t rest = count - x;
    store_first(hn::Mul(load_first(a + x, rest), load_first(b + x, rest)), out + x, rest);
  }
}

}  // namespace

// Names for the dispatch tables, which cannot see into an anonymous namespace.
void depthwise_target(const DepthwisePlane& plane) {
  switch (plane.activation) {
    case Activation::kNone:
      return convolve_plane<Activation::kNone>(plane);
    case Activation::kRelu:
      return convolve_plane<Activation::kRelu>(plane);
    case Activation::kSilu:
      return convolve_plane<Activation::kSilu>(plane);
  }
}

void dfc_plane_target(const DfcPlane& plane) {
  const auto map_width = static_cast<std::size_t>(plane.map_width);
  const auto map_height = static_cast<std::size_t>(plane.map_height);
  const auto width = static_cast<std::size_t>(plane.width);
  const auto pad = static_cast<std::size_t>((plane.horizontal_kernel - 1) / 2);
  const auto above = static_cast<std::size_t>((plane.vertical_kernel - 1) / 2);
  // The rows stand one behind the other with `pad` zeros between them, which are the right border
  // of one and the left of the next, so that both convolutions run along the whole plane at once.
  const std::size_t pitch = map_width + pad;
  const std::size_t count = map_height * pitch;
  float* rows = plane.scratch;
  float* smoothed = rows + pad + count + pad + 2 * kRowSlack;
  float* wide = smoothed + count + 2 * above * pitch + 2 * kRowSlack;

  space_rows(plane.map, map_height, map_width, pad, pitch, rows);

  float* middle = smoothed + above * pitch;
  std::fill(smoothed, middle, 0.0F);
  slide_any<false>(plane.horizontal, plane.horizontal_kernel, plane.horizontal_bias, rows, 1,
                   middle, count);
  std::fill(middle + count, middle + count + above * pitch + kRowSlack, 0.0F);
  const bool doubled = width == 2 * map_width && plane.height == 2 * plane.map_height;
  // A few rows of gates, and the output that needs them: the sums of one overlap with the memory
  // traffic of the other.
  const std::size_t some = doubled ? std::max<std::size_t>(1, 64 / pitch) : map_height;
  for (std::size_t first = 0; first < map_height; first += some) {
    const std::size_t last = std::min(first + some, map_height);
    slide_any<true>(plane.vertical, plane.vertical_kernel, plane.vertical_bias,
                    smoothed + first * pitch, pitch, rows + first * pitch, (last - first) * pitch);
    for (std::size_t y = first; doubled && y < last; ++y) {
      const std::size_t at = 2 * y * width;
      multiply_doubled(rows + y * pitch, plane.features + at, plane.output + at, width);
    }
  }
  if (doubled) return;
  for (int y = 0; y < plane.height; ++y) {
    const auto source = static_cast<std::size_t>(nearest_source(y, plane.height, plane.map_height));
    for (int x = 0; x < plane.width; ++x) {
      wide[x] = rows[source * pitch +
                     static_cast<std::size_t>(nearest_source(x, plane.width, plane.map_width))];
    }
    const std::size_t at = static_cast<std::size_t>(y) * width;
    multiply_row(plane.features + at, wide, plane.output + at, width);
  }
}

void add_target(const float* a, const float* b, float* out, std::size_t count) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t x = 0; x < count; x += lanes) {
    store_up_to(hn::Add(load_up_to(a + x, count - x), load_up_to(b + x, count - x)), out + x,
                count - x);
  }
}

}  // namespace dynslam::attention::detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::attention::detail {

HWY_EXPORT(depthwise_target);
HWY_EXPORT(dfc_plane_target);
HWY_EXPORT(add_target);

void depthwise(const DepthwisePlane& plane) { HWY_DYNAMIC_DISPATCH(depthwise_target)(plane); }

void dfc_plane(const DfcPlane& plane) { HWY_DYNAMIC_DISPATCH(dfc_plane_target)(plane); }

void add(const float* a, const float* b, float* out, std::size_t count) {
  HWY_DYNAMIC_DISPATCH(add_target)(a, b, out, count);
}

void add_upsampled(const float* coarse, int coarse_height, int coarse_width, float* out, int height,
                   int width) {
  const auto columns = static_cast<std::size_t>(width);
  for (int y = 0; y < height; ++y) {
    const float* row = coarse + static_cast<std::size_t>(nearest_source(y, height, coarse_height)) *
                                    static_cast<std::size_t>(coarse_width);
    float* to = out + static_cast<std::size_t>(y) * columns;
    if (width == 2 * coarse_width) {
      for (std::size_t x = 0; x < columns; ++x) to[x] += row[x / 2];
    } else {
      for (int x = 0; x < width; ++x) to[x] += row[nearest_source(x, width, coarse_width)];
    }
  }
}

}  // namespace dynslam::attention::detail
#endif
