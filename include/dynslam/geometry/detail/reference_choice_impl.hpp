// Implementation of reference_choice.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "dynslam/core/errors.hpp"
#include "dynslam/geometry/reference_choice.hpp"

namespace dynslam::geometry {

inline void DepthReferenceOptions::validate() const {
  const char* me = "DepthReferenceOptions";
  require(std::isfinite(first_gap) && first_gap > 0.0, me, "first_gap", first_gap,
          "a positive number of seconds");
  require(std::isfinite(ratio) && ratio > 1.0, me, "ratio", ratio, "a number > 1");
  require(min_overlap >= 0.0 && min_overlap <= 1.0, me, "min_overlap", min_overlap,
          "a number in [0, 1]");
  require(std::isfinite(depth) && depth > 0.0, me, "depth", depth, "a positive number of metres");
}

template <typename Observers>
std::size_t choose_by_covisibility(Span<const std::uint64_t> points, Observers&& observers,
                                   int min_shared, ReferenceChoiceWorkspace& workspace,
                                   Span<SharedKeyframe> out) {
  require(min_shared >= 1, "choose_by_covisibility", "min_shared", min_shared, "at least 1");
  workspace.counts.clear();
  for (const std::uint64_t point : points) {
    observers(point, [&](std::uint64_t keyframe) { ++workspace.counts[keyframe]; });
  }
  auto& ranked = workspace.ranked;
  ranked.clear();
  for (const auto& [id, shared] : workspace.counts) {
    if (shared >= min_shared) ranked.push_back({id, shared});
  }
  const std::size_t n = std::min(out.size(), ranked.size());
  std::partial_sort(ranked.begin(), ranked.begin() + static_cast<std::ptrdiff_t>(n), ranked.end(),
                    [](const SharedKeyframe& a, const SharedKeyframe& b) {
                      return a.shared != b.shared ? a.shared > b.shared : a.id > b.id;
                    });
  std::copy_n(ranked.begin(), n, out.begin());
  return n;
}

namespace detail {

/// Share of a 4 x 3 grid of current pixels at `depth` that the reference had in view.
inline double view_overlap(const PinholeCamera& camera, const RigidTransform& T_cur_ref,
                           double depth) {
  if (!T_cur_ref.all_finite()) return 0.0;
  const RigidTransform T_ref_cur = T_cur_ref.inverse();
  int seen = 0;
  for (int y = 0; y < 3; ++y) {
    for (int x = 0; x < 4; ++x) {
      const Eigen::Vector2d p((x + 0.5) * camera.width / 4.0, (y + 0.5) * camera.height / 3.0);
      if (camera.project_into_image(T_ref_cur * camera.unproject(p, depth))) ++seen;
    }
  }
  return seen / 12.0;
}

}  // namespace detail

inline std::size_t choose_depth_references(const PinholeCamera& camera, double time,
                                           Span<const ReferenceCandidate> candidates,
                                           const DepthReferenceOptions& options, Span<int> out) {
  options.validate();
  camera.validate();
  std::size_t chosen = 0;
  double wanted = options.first_gap;
  for (std::size_t slot = 0; slot < out.size(); ++slot, wanted *= options.ratio) {
    int best = -1;
    double best_distance = 0.0;
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      const double gap = time - candidates[i].time;
      if (!(gap > 0.5 * options.first_gap)) continue;
      const double distance = std::abs(std::log(gap / wanted));
      if (best >= 0 && distance >= best_distance) continue;
      const int index = static_cast<int>(i);
      if (std::find(out.begin(), out.begin() + chosen, index) != out.begin() + chosen) continue;
      if (detail::view_overlap(camera, candidates[i].T_cur_ref, options.depth) <
          options.min_overlap) {
        continue;
      }
      best = index;
      best_distance = distance;
    }
    if (best < 0) break;
    out[chosen++] = best;
  }
  std::sort(out.begin(), out.begin() + chosen, [&](int a, int b) {
    return candidates[static_cast<std::size_t>(a)].time >
           candidates[static_cast<std::size_t>(b)].time;
  });
  return chosen;
}

}  // namespace dynslam::geometry
