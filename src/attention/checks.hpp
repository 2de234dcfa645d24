// Contracts of the layers' views.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "dynslam/attention/tensor_batch.hpp"
#include "dynslam/core/errors.hpp"

namespace dynslam::attention::detail {

template <typename T>
std::string shape_text(const TensorBatch<T>& view) {
  return std::to_string(view.batch) + "x" + std::to_string(view.channels) + "x" +
         std::to_string(view.height) + "x" + std::to_string(view.width);
}

/// Throws unless `view` is there and has this shape.
template <typename T>
void require_shape(const TensorBatch<T>& view, int batch, int channels, int height, int width,
                   std::string_view function, std::string_view parameter) {
  if (view.empty()) throw_invalid_argument(function, parameter, "an empty view", "values");
  if (view.batch != batch || view.channels != channels || view.height != height ||
      view.width != width) {
    throw_invalid_argument(
        function, parameter, shape_text(view),
        shape_text(TensorBatch<const float>(nullptr, batch, channels, height, width)));
  }
}

/// Throws unless `input` is there and has so many channels.
inline void require_channels(const TensorBatch<const float>& input, int channels,
                             std::string_view function, std::string_view parameter) {
  if (input.empty()) throw_invalid_argument(function, parameter, "an empty view", "values");
  require(input.channels == channels, function, std::string(parameter) + ".channels",
          input.channels, channels);
}

inline bool overlap(const TensorBatch<const float>& a, const TensorBatch<const float>& b) {
  const auto first_a = reinterpret_cast<std::uintptr_t>(a.data);
  const auto first_b = reinterpret_cast<std::uintptr_t>(b.data);
  return first_a < first_b + b.size() * sizeof(float) &&
         first_b < first_a + a.size() * sizeof(float);
}

/// Throws if `output` shares memory with `input`, unless both are the same and that is allowed.
inline void require_apart(const TensorBatch<const float>& input,
                          const TensorBatch<const float>& output, bool same_is_allowed,
                          std::string_view function) {
  const bool same = input.data == output.data && input.size() == output.size();
  if (overlap(input, output) && !(same && same_is_allowed)) {
    throw_invalid_argument(
        function, "output", "memory that overlaps an input",
        same_is_allowed ? "the same view as the input or memory of its own" : "memory of its own");
  }
}

}  // namespace dynslam::attention::detail
