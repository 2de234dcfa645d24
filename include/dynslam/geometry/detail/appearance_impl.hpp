// Implementation of appearance.hpp.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <string>

#include "dynslam/core/errors.hpp"
#include "dynslam/geometry/appearance.hpp"

namespace dynslam::geometry {

inline void AppearanceOptions::validate() const {
  const char* me = "AppearanceOptions";
  require(radius >= 1 && radius <= 16, me, "radius", radius, "1..16 cells");
  require(std::isfinite(noise) && noise > 0.0, me, "noise", noise, "a positive number");
  require(std::isfinite(texture) && texture >= 0.0, me, "texture", texture, "a finite number >= 0");
  require(neutral > -1.0 && neutral < 1.0, me, "neutral", neutral, "a number in (-1, 1)");
  require(std::isfinite(below) && below >= 0.0, me, "below", below, "a finite number >= 0");
  require(std::isfinite(scale) && scale > 0.0, me, "scale", scale, "a positive number");
  require(std::isfinite(evidence) && evidence > 0.0, me, "evidence", evidence, "a positive number");
  require(least_seen > 0.0 && least_seen <= 1.0, me, "least_seen", least_seen,
          "a number in (0, 1]");
}

namespace detail {

/// Grey levels are kept about this one, so that single precision suffices for their squares.
inline constexpr float kMiddleGray = 128.0F;

/// Grey level at a position in whole cells' centres, between four of them.
inline float gray_between(ImageView<const std::uint8_t> gray, float x, float y) {
  const int u = static_cast<int>(x), v = static_cast<int>(y);
  const float a = x - static_cast<float>(u), b = y - static_cast<float>(v);
  const std::uint8_t *top = gray.row(v) + u, *bottom = gray.row(v + 1) + u;
  return (1.0F - b) * ((1.0F - a) * top[0] + a * top[1]) +
         b * ((1.0F - a) * bottom[0] + a * bottom[1]);
}

/// Grey levels of a reference where the cells would have been if they stood still: `before`, and 1
/// in `seen` where the depths agree; 0 in both elsewhere.
inline void look_back(const PinholeCamera& camera, const DepthReference& reference,
                      ImageView<const std::uint8_t> gray, const MarginModel& model,
                      const DepthEvidence& e, AppearanceWorkspace& w) {
  const RigidTransform T_ref_cur = reference.T_cur_ref.inverse();
  const Outlook cells(*reference.cells);
  const Eigen::Vector3f t = T_ref_cur.t.cast<float>();
  const Eigen::Vector3f step = (T_ref_cur.R.col(0) * (e.stride / camera.fx)).cast<float>();
  const double middle = 0.5 * (e.stride - 1);  // of a cell's pixels
  const float per_pixel = 1.0F / static_cast<float>(e.stride);
  const float to_middle = static_cast<float>(middle);
  for (int y = 0; y < e.height; ++y) {
    const Eigen::Vector3d first = T_ref_cur.R * camera.bearing({middle, y * e.stride + middle});
    const Eigen::Vector3f origin = first.cast<float>();
    const std::size_t row = static_cast<std::size_t>(y) * e.width;
    for (int x = 0; x < e.width; ++x) {
      const std::size_t i = row + static_cast<std::size_t>(x);
      w.seen[i] = w.before[i] = 0.0F;
      const float z = e.depth[i];
      if (z <= 0.0F) continue;
      const Eigen::Vector3f P = z * (origin + static_cast<float>(x) * step) + t;
      const Sight sight = look(P, z, cells, model).sight;
      if (sight != Sight::kSeen && sight != Sight::kMover && sight != Sight::kEdge) continue;
      const float u = (cells.fx * P.x() / P.z() + cells.cx - to_middle) * per_pixel;
      const float v = (cells.fy * P.y() / P.z() + cells.cy - to_middle) * per_pixel;
      if (!(u >= 0.0F && v >= 0.0F && u < static_cast<float>(gray.width - 1) &&
            v < static_cast<float>(gray.height - 1))) {
        continue;
      }
      w.seen[i] = 1.0F;
      w.before[i] = gray_between(gray, u, v) - kMiddleGray;
    }
  }
}

/// Sums over the window of `radius` cells around each cell.
inline void sum_windows(const std::vector<float>& values, int width, int height, int radius,
                        std::vector<float>& row, std::vector<float>& sums) {
  const std::size_t n = static_cast<std::size_t>(width), r = static_cast<std::size_t>(radius);
  row.assign(n + 2 * r, 0.0F);
  float* inner = row.data() + r;
  for (int y = 0; y < height; ++y) {
    std::fill(inner, inner + n, 0.0F);
    for (int v = std::max(0, y - radius); v <= std::min(height - 1, y + radius); ++v) {
      const float* from = &values[static_cast<std::size_t>(v) * n];
      for (std::size_t x = 0; x < n; ++x) inner[x] += from[x];
    }
    float* to = &sums[static_cast<std::size_t>(y) * n];
    std::fill(to, to + n, 0.0F);
    for (std::size_t k = 0; k <= 2 * r; ++k) {
      const float* from = row.data() + k;
      for (std::size_t x = 0; x < n; ++x) to[x] += from[x];
    }
  }
}

/// What correlation needs of the windows: cells seen, and the sums of a, b, aa, bb and ab.
inline void sum_moments(const DepthEvidence& e, int radius, AppearanceWorkspace& w) {
  enum { kSeen, kNow, kBefore, kNow2, kBefore2, kBoth };
  const std::vector<float>*a = &w.now, *b = &w.before, *s = &w.seen;
  const auto sum = [&](int which, const std::vector<float>& first,
                       const std::vector<float>& second) {
    for (std::size_t i = 0; i < first.size(); ++i) w.product[i] = first[i] * second[i] * (*s)[i];
    sum_windows(w.product, e.width, e.height, radius, w.rows, w.sums[which]);
  };
  sum(kSeen, *s, *s);
  sum(kNow, *a, *s);
  sum(kBefore, *b, *s);
  sum(kNow2, *a, *a);
  sum(kBefore2, *b, *b);
  sum(kBoth, *a, *b);
}

/// Likeness of the cells of which it can be told, in `w.product`; kUntold elsewhere.
inline constexpr float kUntold = -2.0F;
inline void correlate(const AppearanceOptions& o, AppearanceWorkspace& w) {
  const int side = 2 * o.radius + 1;
  const float least = static_cast<float>(o.least_seen * side * side);
  const float noise = static_cast<float>(o.noise * o.noise);
  const float texture = static_cast<float>(o.texture * o.texture);
  for (std::size_t i = 0; i < w.product.size(); ++i) {
    const float n = std::max(1.0F, w.sums[0][i]);
    const float a = w.sums[1][i] / n, b = w.sums[2][i] / n;
    const float aa = std::max(0.0F, w.sums[3][i] / n - a * a);
    const float bb = std::max(0.0F, w.sums[4][i] / n - b * b);
    const float ab = w.sums[5][i] / n - a * b;
    const float likeness = ab / std::sqrt((aa + noise) * (bb + noise));
    const bool told = w.seen[i] > 0.0F && n >= least && std::max(aa, bb) >= texture;
    w.product[i] = told ? likeness : kUntold;
  }
}

/// Median likeness, to a hundredth, of the cells that stand still as far as is known; 1 if there
/// are none.
inline float median_likeness(const AppearanceWorkspace& w, const DepthEvidence& e) {
  constexpr int kBins = 200;  // from -1 to 1
  constexpr float kStill = -0.3F;
  std::array<int, kBins + 1> counts{};
  int told = 0;
  for (std::size_t i = 0; i < w.product.size(); ++i) {
    if (w.product[i] == kUntold || e.log_odds[i] > kStill) continue;
    ++counts[static_cast<std::size_t>(0.5F * kBins * (1.0F + w.product[i]))];
    ++told;
  }
  int below = 0;
  for (int bin = 0; bin < kBins; ++bin) {
    below += counts[static_cast<std::size_t>(bin)];
    if (2 * below > told) return 2.0F * (static_cast<float>(bin) + 0.5F) / kBins - 1.0F;
  }
  return 1.0F;
}

/// Adds what one reference says.
inline void vote_by_likeness(const AppearanceOptions& o, const AppearanceWorkspace& w,
                             DepthEvidence& e) {
  const float neutral =
      std::min(static_cast<float>(o.neutral), median_likeness(w, e) - static_cast<float>(o.below));
  const float rate = static_cast<float>(1.0 / o.scale);
  const float most = static_cast<float>(o.evidence);
  for (std::size_t i = 0; i < e.log_odds.size(); ++i) {
    const float vote = std::min(1.0F, std::max(-1.0F, (neutral - w.product[i]) * rate));
    e.log_odds[i] += w.product[i] == kUntold ? 0.0F : most * vote;
  }
}

}  // namespace detail

inline void add_appearance(const PinholeCamera& camera, ImageView<const std::uint8_t> gray,
                           Span<const DepthReference> references,
                           Span<const ImageView<const std::uint8_t>> grays,
                           const DepthConsistencyOptions& consistency,
                           const AppearanceOptions& options, AppearanceWorkspace& w,
                           DepthEvidence& evidence) {
  const char* me = "add_appearance";
  consistency.validate();
  options.validate();
  camera.validate();
  DepthEvidence& e = evidence;
  require(e.stride >= 1 && e.width == (camera.width + e.stride - 1) / e.stride &&
              e.height == (camera.height + e.stride - 1) / e.stride,
          me, "evidence", "cells of another camera", "cells of this camera");
  require(gray.data != nullptr && gray.width == camera.width / e.stride &&
              gray.height == camera.height / e.stride,
          me, "gray.width x height",
          std::to_string(gray.width) + " x " + std::to_string(gray.height),
          "the whole cells of this camera");
  require(grays.size() == references.size(), me, "grays.size", grays.size(),
          std::to_string(references.size()) + ", the number of references");
  for (const ImageView<const std::uint8_t>& each : grays) {
    require(each.empty() || each.same_size(gray), me, "grays.width x height",
            std::to_string(each.width) + " x " + std::to_string(each.height), "that of gray");
  }
  const std::size_t cells = e.depth.size();
  for (auto* v : {&w.now, &w.seen, &w.before, &w.product}) v->resize(cells);
  for (auto& sums : w.sums) sums.resize(cells);
  for (int y = 0; y < e.height; ++y) {  // a cell that is not whole looks like its neighbour
    const std::uint8_t* row = gray.row(std::min(y, gray.height - 1));
    float* to = &w.now[static_cast<std::size_t>(y) * e.width];
    for (int x = 0; x < e.width; ++x) {
      to[x] = static_cast<float>(row[std::min(x, gray.width - 1)]) - detail::kMiddleGray;
    }
  }
  const detail::MarginModel model(consistency);
  for (std::size_t r = 0; r < references.size(); ++r) {
    if (!detail::usable(references[r]) || grays[r].empty()) continue;
    detail::look_back(camera, references[r], grays[r], model, e, w);
    detail::sum_moments(e, options.radius, w);
    detail::correlate(options, w);
    detail::vote_by_likeness(options, w, e);
  }
}

}  // namespace dynslam::geometry
