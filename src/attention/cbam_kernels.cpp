#include "attention/cbam_kernels.hpp"

#include <algorithm>
#include <cstdint>
#include <limits>

#include "attention/simd.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "attention/cbam_kernels.cpp"
#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "attention/vector_math-inl.hpp"

HWY_BEFORE_NAMESPACE();
namespace dynslam::attention::detail::HWY_NAMESPACE {
namespace {

constexpr float kLowest = -std::numeric_limits<float>::infinity();

/// Products of one row with two vectors.
HWY_INLINE void two_dots(const float* row, const float* a, const float* b, std::size_t count,
                         float* of_a, float* of_b) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  V a0 = hn::Zero(d);
  V a1 = a0;
  V b0 = a0;
  V b1 = a0;
  std::size_t i = 0;
  for (; i + 2 * lanes <= count; i += 2 * lanes) {
    const V w0 = hn::LoadU(d, row + i);
    const V w1 = hn::LoadU(d, row + i + lanes);
    a0 = hn::MulAdd(w0, hn::LoadU(d, a + i), a0);
    a1 = hn::MulAdd(w1, hn::LoadU(d, a + i + lanes), a1);
    b0 = hn::MulAdd(w0, hn::LoadU(d, b + i), b0);
    b1 = hn::MulAdd(w1, hn::LoadU(d, b + i + lanes), b1);
  }
  for (; i < count; i += lanes) {
    const V w = load_up_to(row + i, count - i);
    a0 = hn::MulAdd(w, load_up_to(a + i, count - i), a0);
    b0 = hn::MulAdd(w, load_up_to(b + i, count - i), b0);
  }
  *of_a = sum_of(hn::Add(a0, a1));
  *of_b = sum_of(hn::Add(b0, b1));
}

/// Four channels of up to `count` pixels into the running maxima and sums.
template <bool kFirst, bool kGated>
HWY_INLINE void pool_four(const float* x, std::size_t plane, const float* gates, std::size_t count,
                          float* largest, float* sums) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const V g0 = hn::Set(d, kGated ? gates[0] : 1.0F);
  const V g1 = hn::Set(d, kGated ? gates[1] : 1.0F);
  const V g2 = hn::Set(d, kGated ? gates[2] : 1.0F);
  const V g3 = hn::Set(d, kGated ? gates[3] : 1.0F);
  for (std::size_t i = 0; i < count; i += lanes) {
    const std::size_t rest = count - i;
    V a = load_up_to(x + i, rest);
    V b = load_up_to(x + plane + i, rest);
    V c = load_up_to(x + 2 * plane + i, rest);
    V e = load_up_to(x + 3 * plane + i, rest);
    if constexpr (kGated) {
      a = hn::Mul(a, g0);
      b = hn::Mul(b, g1);
      c = hn::Mul(c, g2);
      e = hn::Mul(e, g3);
    }
    V top = hn::Max(hn::Max(a, b), hn::Max(c, e));
    V sum = hn::Add(hn::Add(a, b), hn::Add(c, e));
    if constexpr (!kFirst) {
      top = hn::Max(top, hn::LoadU(d, largest + i));
      sum = hn::Add(sum, hn::LoadU(d, sums + i));
    }
    // The buffers have room for a whole vector behind the last pixel.
    hn::StoreU(top, d, largest + i);
    hn::StoreU(sum, d, sums + i);
  }
}

template <bool kGated>
HWY_INLINE void pool_one(const float* x, const float* gate, std::size_t count, float* largest,
                         float* sums) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const V g = hn::Set(d, kGated ? *gate : 1.0F);
  for (std::size_t i = 0; i < count; i += lanes) {
    V a = load_up_to(x + i, count - i);
    if constexpr (kGated) a = hn::Mul(a, g);
    hn::StoreU(hn::Max(a, hn::LoadU(d, largest + i)), d, largest + i);
    hn::StoreU(hn::Add(a, hn::LoadU(d, sums + i)), d, sums + i);
  }
}

template <bool kGated>
void pool_all(const Pixels& pixels, const float* gates, float* largest, float* sums) {
  const float* x = pixels.input;
  int c = 0;
  if (pixels.channels >= 4) {
    pool_four<true, kGated>(x, pixels.plane, gates, pixels.count, largest, sums);
    c = 4;
  } else {
    std::fill(largest, largest + pixels.count + 16, kLowest);
    std::fill(sums, sums + pixels.count + 16, 0.0F);
  }
  for (; c + 4 <= pixels.channels; c += 4) {
    pool_four<false, kGated>(x + static_cast<std::size_t>(c) * pixels.plane, pixels.plane,
                             kGated ? gates + c : nullptr, pixels.count, largest, sums);
  }
  for (; c < pixels.channels; ++c) {
    pool_one<kGated>(x + static_cast<std::size_t>(c) * pixels.plane, kGated ? gates + c : nullptr,
                     pixels.count, largest, sums);
  }
}

template <bool kSpatial, bool kStream>
HWY_INLINE void apply_run(const float* x, V gate, const float* spatial, float* out,
                          std::size_t count) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  std::size_t i = 0;
  const auto product = [&](V v, V s) HWY_ATTR {
    return kSpatial ? hn::Mul(hn::Mul(v, gate), s) : hn::Mul(v, gate);
  };
  if constexpr (kStream) {
    // Up to a whole line.
    const std::size_t beyond =
        reinterpret_cast<std::uintptr_t>(out) / sizeof(float) % lanes;  // NOLINT
    const std::size_t head = std::min(count, beyond == 0 ? 0 : lanes - beyond);
    if (head > 0) {
      const V s = kSpatial ? load_up_to(spatial, head) : gate;
      store_up_to(product(load_up_to(x, head), s), out, head);
      i = head;
    }
  }
  for (; i + lanes <= count; i += lanes) {
    const V s = kSpatial ? hn::LoadU(d, spatial + i) : gate;
    const V v = product(hn::LoadU(d, x + i), s);
    if constexpr (kStream) {
      hn::Stream(v, d, out + i);
    } else {
      hn::StoreU(v, d, out + i);
    }
  }
  if (i < count) {
    const std::size_t rest = count - i;
    const V s = kSpatial ? load_first(spatial + i, rest) : gate;
    store_first(product(load_first(x + i, rest), s), out + i, rest);
  }
}

template <bool kSpatial, bool kStream>
void apply_all(const Pixels& pixels, const float* gates, const float* spatial, float* output) {
  for (int c = 0; c < pixels.channels; ++c) {
    const std::size_t at = static_cast<std::size_t>(c) * pixels.plane;
    const V gate = hn::Set(D(), gates == nullptr ? 1.0F : gates[c]);
    apply_run<kSpatial, kStream>(pixels.input + at, gate, spatial, output + at, pixels.count);
  }
}

}  // namespace

// Names for the dispatch tables, which cannot see into an anonymous namespace.
void pool_values_target(const float* values, std::size_t count, float* sum, float* largest) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  V s[4] = {hn::Zero(d), hn::Zero(d), hn::Zero(d), hn::Zero(d)};
  V m[4] = {hn::Set(d, kLowest), hn::Set(d, kLowest), hn::Set(d, kLowest), hn::Set(d, kLowest)};
  std::size_t i = 0;
  const auto take = [&](V v, std::size_t k) HWY_ATTR {
    s[k] = hn::Add(s[k], v);
    m[k] = hn::Max(m[k], v);
  };
  for (; i + 4 * lanes <= count; i += 4 * lanes) {
    take(hn::LoadU(d, values + i), 0);
    take(hn::LoadU(d, values + i + lanes), 1);
    take(hn::LoadU(d, values + i + 2 * lanes), 2);
    take(hn::LoadU(d, values + i + 3 * lanes), 3);
  }
  for (; i + lanes <= count; i += lanes) take(hn::LoadU(d, values + i), 0);
  *sum = sum_of(hn::Add(hn::Add(s[0], s[1]), hn::Add(s[2], s[3])));
  *largest = max_of(hn::Max(hn::Max(m[0], m[1]), hn::Max(m[2], m[3])));
  for (; i < count; ++i) {
    *sum += values[i];
    *largest = std::max(*largest, values[i]);
  }
}

void channel_gates_target(const Perceptron& net, const float* mean, const float* largest,
                          float* hidden, float* gates) {
  const D d;
  const auto channels = static_cast<std::size_t>(net.channels);
  const auto reduced = static_cast<std::size_t>(net.reduced);
  for (std::size_t r = 0; r < reduced; ++r) {
    const float* row = net.hidden_weight + r * channels;
    const float bias = net.hidden_bias == nullptr ? 0.0F : net.hidden_bias[r];
    float a = 0.0F;
    float b = 0.0F;
    two_dots(row, mean, largest, channels, &a, &b);
    a += bias;
    b += bias;
    hidden[r] = (a < 0.0F ? 0.0F : a) + (b < 0.0F ? 0.0F : b);
  }
  // Two rows at once, the last one twice where they are odd.
  for (std::size_t c = 0; c < channels; c += 2) {
    const std::size_t next = std::min(c + 1, channels - 1);
    float first = 0.0F;
    float second = 0.0F;
    two_dots(hidden, net.output_weight + c * reduced, net.output_weight + next * reduced, reduced,
             &first, &second);
    gates[next] = second + 2.0F * (net.output_bias == nullptr ? 0.0F : net.output_bias[next]);
    gates[c] = first + 2.0F * (net.output_bias == nullptr ? 0.0F : net.output_bias[c]);
  }
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t c = 0; c < channels; c += lanes) {
    store_up_to(sigmoid(load_up_to(gates + c, channels - c)), gates + c, channels - c);
  }
}

void pool_channels_target(const Pixels& pixels, const float* gates, float* largest, float* mean) {
  if (gates == nullptr) {
    pool_all<false>(pixels, gates, largest, mean);
  } else {
    pool_all<true>(pixels, gates, largest, mean);
  }
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const V scale = hn::Set(d, 1.0F / static_cast<float>(pixels.channels));
  for (std::size_t i = 0; i < pixels.count; i += lanes) {
    hn::StoreU(hn::Mul(hn::LoadU(d, mean + i), scale), d, mean + i);
  }
}

void spatial_gates_target(const SpatialRow& row, float* gates) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const auto width = static_cast<std::size_t>(row.width);
  const auto kernel = static_cast<std::size_t>(row.kernel);
  const std::size_t taps = kernel * kernel;
  for (std::size_t x = 0; x < width; x += lanes) {
    V sum = hn::Set(d, row.bias);
    V other = hn::Zero(d);
    for (std::size_t k = 0; k < taps; ++k) {
      const std::size_t at = k / kernel * row.pitch + k % kernel + x;
      sum = hn::MulAdd(hn::Set(d, row.weight[k]), hn::LoadU(d, row.largest + at), sum);
      other = hn::MulAdd(hn::Set(d, row.weight[taps + k]), hn::LoadU(d, row.mean + at), other);
    }
    store_up_to(sigmoid(hn::Add(sum, other)), gates + x, width - x);
  }
}

void pool_gated_target(const Pixels& pixels, const float* spatial, int first, int last, float* sums,
                       float* largest) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  for (int c = first; c < last; ++c) {
    const float* x = pixels.input + static_cast<std::size_t>(c) * pixels.plane;
    V sum = hn::Zero(d);
    V top = hn::Set(d, kLowest);
    std::size_t i = 0;
    for (; i + lanes <= pixels.count; i += lanes) {
      const V v = hn::Mul(hn::LoadU(d, x + i), hn::LoadU(d, spatial + i));
      sum = hn::Add(sum, v);
      top = hn::Max(top, v);
    }
    float total = sum_of(sum);
    float most = max_of(top);
    for (; i < pixels.count; ++i) {
      const float v = x[i] * spatial[i];
      total += v;
      most = std::max(most, v);
    }
    sums[c] += total;
    largest[c] = std::max(largest[c], most);
  }
}

void apply_gates_target(const Pixels& pixels, const float* gates, const float* spatial, bool stream,
                        float* output) {
  if (stream) {
    if (spatial != nullptr) {
      apply_all<true, true>(pixels, gates, spatial, output);
    } else {
      apply_all<false, true>(pixels, gates, spatial, output);
    }
    hwy::FlushStream();
  } else if (spatial != nullptr) {
    apply_all<true, false>(pixels, gates, spatial, output);
  } else {
    apply_all<false, false>(pixels, gates, spatial, output);
  }
}

}  // namespace dynslam::attention::detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::attention::detail {

HWY_EXPORT(pool_values_target);
HWY_EXPORT(channel_gates_target);
HWY_EXPORT(pool_channels_target);
HWY_EXPORT(spatial_gates_target);
HWY_EXPORT(pool_gated_target);
HWY_EXPORT(apply_gates_target);

void pool_values(const float* values, std::size_t count, float* sum, float* largest) {
  HWY_DYNAMIC_DISPATCH(pool_values_target)(values, count, sum, largest);
}

void channel_gates(const Perceptron& perceptron, const float* mean, const float* largest,
                   float* hidden, float* gates) {
  HWY_DYNAMIC_DISPATCH(channel_gates_target)(perceptron, mean, largest, hidden, gates);
}

void pool_channels(const Pixels& pixels, const float* gates, float* largest, float* mean) {
  HWY_DYNAMIC_DISPATCH(pool_channels_target)(pixels, gates, largest, mean);
}

void spatial_gates(const SpatialRow& row, float* gates) {
  HWY_DYNAMIC_DISPATCH(spatial_gates_target)(row, gates);
}

void pool_gated(const Pixels& pixels, const float* spatial, int first, int last, float* sums,
                float* largest) {
  HWY_DYNAMIC_DISPATCH(pool_gated_target)(pixels, spatial, first, last, sums, largest);
}

void apply_gates(const Pixels& pixels, const float* gates, const float* spatial, bool stream,
                 float* output) {
  HWY_DYNAMIC_DISPATCH(apply_gates_target)(pixels, gates, spatial, stream, output);
}

}  // namespace dynslam::attention::detail
#endif
