// Implementation of mask_evidence.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

#include "dynslam/geometry/mask_evidence.hpp"

namespace dynslam::geometry {

inline void MaskEvidenceOptions::validate() const {
  const char* me = "MaskEvidenceOptions";
  require(std::isfinite(under) && under > 0.0, me, "under", under, "a positive number");
  require(std::isfinite(beside) && beside >= 0.0, me, "beside", beside, "a finite number >= 0");
  require(margin >= 1 && margin <= 64, me, "margin", margin, "1..64 pixels");
}

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

/// Whether there is a mask `margin` pixels to one of the four sides of a pixel.
inline bool beside_mask(MaskView mask, int x, int y, int margin) {
  const auto masked = [&](int u, int v) { return mask.contains(u, v) && mask(u, v) != 0; };
  return masked(x - margin, y) || masked(x + margin, y) || masked(x, y - margin) ||
         masked(x, y + margin);
}

/// What a mask says of a cell, as log-odds.
inline float mask_says(MaskView mask, int stride, int cx, int cy, const MaskEvidenceOptions& o) {
  const float share = masked_share(mask, stride, cx, cy);
  if (share > 0.5F) return static_cast<float>(o.under) * (2.0F * share - 1.0F);
  const int half = stride / 2;
  const bool beside =
      share > 0.0F || beside_mask(mask, cx * stride + half, cy * stride + half, o.margin);
  return beside ? static_cast<float>(-o.beside) : 0.0F;
}

}  // namespace detail

inline void add_mask(ImageView<const float> depth, MaskView mask,
                     const MaskEvidenceOptions& options, DepthEvidence& evidence) {
  const char* me = "add_mask";
  options.validate();
  require(mask.same_size(depth), me, "mask.width x height",
          std::to_string(mask.width) + " x " + std::to_string(mask.height),
          std::to_string(depth.width) + " x " + std::to_string(depth.height) + ", the depth's");
  const int stride = evidence.stride;
  require(stride >= 1 && evidence.width == (depth.width + stride - 1) / stride &&
              evidence.height == (depth.height + stride - 1) / stride,
          me, "evidence", "cells of an image of another size", "cells of this depth image");
  detail::gather_depth(depth, evidence);
  for (int y = 0; y < evidence.height; ++y) {
    for (int x = 0; x < evidence.width; ++x) {
      evidence.log_odds[static_cast<std::size_t>(y) * evidence.width + x] +=
          detail::mask_says(mask, stride, x, y, options);
    }
  }
}

}  // namespace dynslam::geometry
