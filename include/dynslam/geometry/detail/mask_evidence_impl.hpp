// Implementation of mask_evidence.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

#include "dynslam/geometry/mask_evidence.hpp"

namespace dynslam::geometry {
namespace detail {

/// Share of a cell's pixels under the mask.
inline float masked_share(MaskView mask, int stride, int cx, int cy) {
  int masked = 0, pixels = 0;
  for (int y = cy * stride; y < std::min((cy + 1) * stride, mask.height); ++y) {
    for (int x = cx * stride; x < std::min((cx + 1) * stride, mask.width); ++x) {
      ++pixels;
      masked += mask(x, y) != 0;
    }
  }
  return static_cast<float>(masked) / static_cast<float>(pixels);
}

}  // namespace detail

inline void add_mask(ImageView<const float> depth, MaskView mask, double log_odds,
                     DepthEvidence& evidence) {
  const char* me = "add_mask";
  require(mask.same_size(depth), me, "mask.width x height",
          std::to_string(mask.width) + " x " + std::to_string(mask.height),
          std::to_string(depth.width) + " x " + std::to_string(depth.height) + ", the depth's");
  require(std::isfinite(log_odds) && log_odds > 0.0, me, "log_odds", log_odds, "a positive number");
  const int stride = evidence.stride;
  require(stride >= 1 && evidence.width == (depth.width + stride - 1) / stride &&
              evidence.height == (depth.height + stride - 1) / stride,
          me, "evidence", "cells of an image of another size", "cells of this depth image");
  detail::gather_depth(depth, evidence);
  for (int y = 0; y < evidence.height; ++y) {
    for (int x = 0; x < evidence.width; ++x) {
      const float share = detail::masked_share(mask, stride, x, y);
      if (share <= 0.5F) continue;
      evidence.log_odds[static_cast<std::size_t>(y) * evidence.width + x] +=
          static_cast<float>(log_odds) * (2.0F * share - 1.0F);
    }
  }
}

}  // namespace dynslam::geometry
