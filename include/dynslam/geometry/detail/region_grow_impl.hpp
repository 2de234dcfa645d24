// Implementation of region_grow.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>

#include "dynslam/core/errors.hpp"
#include "dynslam/geometry/detail/mask_painting.hpp"
#include "dynslam/geometry/detail/region_completion.hpp"
#include "dynslam/geometry/detail/surface_links.hpp"

namespace dynslam::geometry {

inline void RegionGrowOptions::validate() const {
  const char* me = "RegionGrowOptions";
  require(std::isfinite(jump) && jump > 0.0, me, "jump", jump, "a positive number");
  require(std::isfinite(reach) && reach > 0.0, me, "reach", reach, "a positive number");
  require(fill_share > 0.0 && fill_share <= 1.0, me, "fill_share", fill_share,
          "a number in (0, 1]");
  require(known_share >= 0.0 && known_share <= 1.0, me, "known_share", known_share,
          "a number in [0, 1]");
  require(max_fill > 0.0 && max_fill <= 1.0, me, "max_fill", max_fill, "a number in (0, 1]");
  require(min_cells >= 1, me, "min_cells", min_cells, "at least 1");
  require(std::isfinite(decision) && decision > 0.0, me, "decision", decision, "a positive number");
  require(std::isfinite(doubt) && doubt >= 0.0, me, "doubt", doubt, "a finite number >= 0");
  require(std::isfinite(feature_weight) && feature_weight >= 0.0, me, "feature_weight",
          feature_weight, "a finite number >= 0");
  require(std::isfinite(completion) && completion >= 0.0, me, "completion", completion,
          "a finite number >= 0");
  require(dilate >= 0, me, "dilate", dilate, "a number of pixels >= 0");
}

namespace detail {

/// Fills depth-connected regions that are mostly dynamic: such a region has a dynamic cell to start
/// from.
inline void fill_regions(const DepthEvidence& e, const RegionGrowOptions& o,
                         RegionGrowWorkspace& w) {
  const int cells = e.width * e.height;
  std::fill(w.region.begin(), w.region.end(), -1);
  for (int seed = 0; seed < cells; ++seed) {
    const std::size_t s = static_cast<std::size_t>(seed);
    if (w.label[s] == 0 || w.region[s] >= 0 || e.depth[s] <= 0.0F) continue;
    flood(e, seed, seed, w, [](int, bool linked) { return linked; });
    int dynamic = 0, judged = 0;
    for (const int i : w.queue) {
      const std::size_t k = static_cast<std::size_t>(i);
      judged += w.weight[k] > kJudged ? 1 : 0;
      dynamic += w.label[k] != 0 ? 1 : 0;
    }
    if (dynamic < o.fill_share * judged) continue;
    if (dynamic < o.known_share * static_cast<double>(w.queue.size())) continue;
    if (static_cast<double>(w.queue.size()) > o.max_fill * cells) continue;
    for (const int i : w.queue) w.label[static_cast<std::size_t>(i)] = 255;
  }
}

/// Removes dynamic patches of fewer than `min_cells` cells.
inline void remove_small(const DepthEvidence& e, int min_cells, RegionGrowWorkspace& w) {
  const int cells = e.width * e.height;
  std::fill(w.region.begin(), w.region.end(), -1);
  for (int seed = 0; seed < cells; ++seed) {
    const std::size_t s = static_cast<std::size_t>(seed);
    if (w.region[s] >= 0 || w.label[s] == 0) continue;
    flood(e, seed, seed, w,
          [&](int to, bool) { return w.label[static_cast<std::size_t>(to)] != 0; });
    if (static_cast<int>(w.queue.size()) >= min_cells) continue;
    for (const int i : w.queue) w.label[static_cast<std::size_t>(i)] = 0;
  }
}

/// Cells without depth (contours, shadows, holes) take the label of most of their neighbours, if
/// two thirds of them agree.
inline void close_holes(const DepthEvidence& e, RegionGrowWorkspace& w) {
  constexpr int kRings = 1;
  constexpr int kOpen = -2;
  for (std::size_t i = 0; i < e.depth.size(); ++i) w.region[i] = e.depth[i] > 0.0F ? 0 : kOpen;
  for (int ring = 1; ring <= kRings; ++ring) {
    for (int y = 0; y < e.height; ++y) {
      for (int x = 0; x < e.width; ++x) {
        const std::size_t i = static_cast<std::size_t>(y) * e.width + x;
        if (w.region[i] != kOpen) continue;
        int dynamic = 0, asked = 0;
        for (int v = std::max(0, y - 1); v <= std::min(e.height - 1, y + 1); ++v) {
          for (int u = std::max(0, x - 1); u <= std::min(e.width - 1, x + 1); ++u) {
            const std::size_t k = static_cast<std::size_t>(v) * e.width + u;
            if (w.region[k] < 0 || w.region[k] >= ring) continue;
            ++asked;
            dynamic += w.label[k] >> 7;
          }
        }
        if (asked == 0) continue;
        w.label[i] = 3 * dynamic > 2 * asked ? 255 : 0;
        w.region[i] = ring;
      }
    }
  }
}

/// Grows the mask by `radius` pixels (square), one axis after the other.
inline void dilate_mask(ImageView<std::uint8_t> mask, int radius, RegionGrowWorkspace& w) {
  const auto line = [&](std::uint8_t* first, int n, std::ptrdiff_t step) {
    w.line.assign(static_cast<std::size_t>(n), 0);
    int until = -1;  // last pixel covered by a set one to the left
    for (int i = 0; i < n; ++i) {
      if (first[i * step] != 0) until = i + radius;
      if (i <= until) w.line[static_cast<std::size_t>(i)] = 255;
    }
    until = n;
    for (int i = n - 1; i >= 0; --i) {
      if (first[i * step] != 0) until = i - radius;
      if (i >= until) w.line[static_cast<std::size_t>(i)] = 255;
    }
    for (int i = 0; i < n; ++i) first[i * step] = w.line[static_cast<std::size_t>(i)];
  };
  for (int y = 0; y < mask.height; ++y) line(mask.row(y), mask.width, 1);
  for (int x = 0; x < mask.width; ++x) line(mask.data + x, mask.height, mask.stride_bytes);
}

inline double dynamic_share(ImageView<std::uint8_t> mask) {
  constexpr std::uint64_t kOnes = 0x0101010101010101;
  std::size_t set = 0;
  for (int y = 0; y < mask.height; ++y) {
    const std::uint8_t* row = mask.row(y);
    int x = 0;
    for (; x + 8 <= mask.width; x += 8) {
      std::uint64_t eight = 0;
      std::memcpy(&eight, row + x, 8);
      set += (eight >> 7 & kOnes) * kOnes >> 56;  // the product's first byte is the sum
    }
    for (; x < mask.width; ++x) set += row[x] >> 7;
  }
  return static_cast<double>(set) / (static_cast<double>(mask.width) * mask.height);
}

}  // namespace detail

inline double grow_regions(ImageView<const float> depth, const DepthEvidence& evidence,
                           Pixels pixels, Span<const FeatureVerdict> verdicts,
                           const RegionGrowOptions& options, RegionGrowWorkspace& w,
                           ImageView<std::uint8_t> mask, ImageView<const std::uint8_t> guide) {
  const char* me = "grow_regions";
  options.validate();
  require(mask.data != nullptr && mask.same_size(depth), me, "mask.width x height",
          std::to_string(mask.width) + " x " + std::to_string(mask.height),
          std::to_string(depth.width) + " x " + std::to_string(depth.height) + ", the depth's");
  require(guide.empty() || guide.same_size(depth), me, "guide.width x height",
          std::to_string(guide.width) + " x " + std::to_string(guide.height),
          std::to_string(depth.width) + " x " + std::to_string(depth.height) + ", the depth's");
  const int stride = evidence.stride;
  require(stride >= 1 && evidence.width == (depth.width + stride - 1) / stride &&
              evidence.height == (depth.height + stride - 1) / stride,
          me, "evidence", "cells of an image of another size", "cells of this depth image");
  require(verdicts.size() == pixels.size(), me, "verdicts.size", verdicts.size(),
          std::to_string(pixels.size()) + ", the number of pixels");

  const std::size_t cells = evidence.depth.size();
  for (auto* v : {&w.sum, &w.weight, &w.gain, &w.right, &w.down}) v->resize(cells);
  w.label.resize(cells);
  w.region.resize(cells);
  w.queue.reserve(cells);
  for (std::size_t i = 0; i < cells; ++i) {
    w.sum[i] = evidence.log_odds[i];
    w.weight[i] = std::min(1.0F, std::abs(evidence.log_odds[i]));
  }
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const Eigen::Vector2f p = pixels[i];
    if (!(p.x() >= 0.0F && p.y() >= 0.0F && p.x() < static_cast<float>(depth.width) &&
          p.y() < static_cast<float>(depth.height)) ||
        verdicts[i].verdict == Verdict::kUnknown) {
      continue;
    }
    const std::size_t at = static_cast<std::size_t>(p.y()) / stride * evidence.width +
                           static_cast<std::size_t>(p.x()) / stride;
    w.sum[at] += static_cast<float>(options.feature_weight) * verdicts[i].log_odds;
    w.weight[at] += static_cast<float>(options.feature_weight);
  }

  detail::link_cells(evidence, static_cast<float>(options.jump), w.right, w.down);
  detail::share_evidence(evidence, options.reach, w);
  const auto decision = static_cast<float>(options.decision);
  const auto doubt = static_cast<float>(options.doubt);
  for (std::size_t i = 0; i < cells; ++i) {
    const bool dynamic = w.sum[i] > decision * (w.weight[i] + doubt);
    w.label[i] = dynamic ? 255 : 0;
  }
  detail::fill_regions(evidence, options, w);
  detail::remove_small(evidence, options.min_cells, w);
  const bool complete = options.completion > 0.0;
  w.strays.clear();
  if (complete) detail::complete_regions(evidence, options, w);
  detail::close_holes(evidence, w);
  detail::find_borders(evidence, w);
  detail::paint(depth, evidence, w, mask);
  if (complete) detail::settle_strays(depth, evidence, w, mask);
  if (!guide.empty() && complete) {
    detail::settle_holes(evidence, w, [&](int cx, int cy) {
      detail::settle_by_likeness(depth, stride, cx, cy, guide, mask);
    });
  } else if (!guide.empty()) {
    w.known.fill(depth);
    detail::settle_holes(evidence, w, [&](int cx, int cy) {
      detail::settle_by_vote(w.known, stride, cx, cy, guide, mask);
    });
  }
  if (options.dilate > 0) detail::dilate_mask(mask, options.dilate, w);
  return detail::dynamic_share(mask);
}

}  // namespace dynslam::geometry
