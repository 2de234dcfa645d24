// What lies behind something takes after what continues it; a part of region_grow.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "dynslam/geometry/detail/surface_links.hpp"

namespace dynslam::geometry::detail {

/// Shared weight of evidence from which a cell counts as judged.
inline constexpr float kJudged = 0.05F;

/// Metres by which surfaces of one object may differ in depth, and a gap's edge from its bottom.
inline float behind_tolerance(float z) { return 0.1F + 0.02F * z; }

/// How the surfaces that continue something behind what stands in front of it are labelled.
struct Continuation {
  int dynamic = 0, still = 0;
};

/// Looks from a cell along the four axes for the first one as far away as `z` past nearer cells.
/// Surfaces with nothing nearer between them are two, however alike in depth. Cells for which `own`
/// holds end the search, as do cells of which nothing is known.
template <typename Own>
void look_behind(const DepthEvidence& e, const RegionGrowWorkspace& w, int cx, int cy, float z,
                 const Own& own, Continuation& votes) {
  constexpr int kSteps[4][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}};
  const float tolerance = behind_tolerance(z);
  for (const auto& step : kSteps) {
    int x = cx + step[0], y = cy + step[1];
    bool passed = false;
    for (; x >= 0 && y >= 0 && x < e.width && y < e.height; x += step[0], y += step[1]) {
      const std::size_t i = static_cast<std::size_t>(y) * e.width + x;
      if (own(i)) break;
      const float other = e.depth[i];
      if (other <= 0.0F) continue;
      if (other < z - tolerance) {
        passed = true;
        continue;
      }
      if (!passed || other > z + tolerance || w.weight[i] < kJudged) break;
      (w.label[i] != 0 ? votes.dynamic : votes.still) += 1;
      break;
    }
  }
}

/// What the surfaces that continue the region in `w.queue` say of it, -1 static .. 1 dynamic.
inline float continued_by(const DepthEvidence& e, const RegionGrowWorkspace& w, int region) {
  Continuation votes;
  const auto own = [&](std::size_t i) { return w.region[i] == region; };
  for (const int i : w.queue) {
    look_behind(e, w, i % e.width, i / e.width, e.depth[static_cast<std::size_t>(i)], own, votes);
  }
  const int all = votes.dynamic + votes.still;
  return all > 0 ? static_cast<float>(votes.dynamic - votes.still) / static_cast<float>(all) : 0.0F;
}

/// Regions of which little is known take after what they continue: legs under a table, a mover
/// that comes in where nothing was seen before.
inline void complete_regions(const DepthEvidence& e, const RegionGrowOptions& o,
                             RegionGrowWorkspace& w) {
  const int cells = e.width * e.height;
  const auto weight = static_cast<float>(o.completion);
  std::fill(w.region.begin(), w.region.end(), -1);
  for (int seed = 0; seed < cells; ++seed) {
    const std::size_t s = static_cast<std::size_t>(seed);
    if (w.region[s] >= 0 || e.depth[s] <= 0.0F) continue;
    flood(e, seed, seed, w, [](int, bool linked) { return linked; });
    if (static_cast<double>(w.queue.size()) > o.max_fill * cells) continue;
    float own = 0.0F;
    for (const int i : w.queue) own += w.sum[static_cast<std::size_t>(i)];
    own /= static_cast<float>(w.queue.size());
    // Surfaces that are sure of themselves need not be asked about.
    if (std::abs(own) > weight) continue;
    const float continued = continued_by(e, w, seed);
    if (continued <= 0.0F || own + weight * continued < static_cast<float>(o.decision)) continue;
    for (const int i : w.queue) w.label[static_cast<std::size_t>(i)] = 255;
  }
}

}  // namespace dynslam::geometry::detail
