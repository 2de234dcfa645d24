// Which keyframes to compare the current frame with.
#pragma once

#include <cstdint>
#include <unordered_map>
#include <utility>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam::geometry {

/// A keyframe and how many map points it shares with the current frame.
struct SharedKeyframe {
  std::uint64_t id = 0;
  int shared = 0;
};

/// Scratch of `choose_by_covisibility`.
struct ReferenceChoiceWorkspace {
  std::unordered_map<std::uint64_t, int> counts;
  std::vector<SharedKeyframe> ranked;
};

/// The keyframes that share the most map points with the current frame (P-Static: 5).
///
/// `points`: ids of the map points the current frame sees. `observers(point, visit)` must call
/// `visit(keyframe_id)` for each keyframe that observes the point: the host's map stays its own.
/// Best first; ties go to the greater (newer) id. Keyframes with fewer than `min_shared` are left
/// out. Returns how many of `out` were filled. O(observations + K log K).
template <typename Observers>
std::size_t choose_by_covisibility(Span<const std::uint64_t> points, Observers&& observers,
                                   int min_shared, ReferenceChoiceWorkspace& workspace,
                                   Span<SharedKeyframe> out);

/// A frame that could serve as depth reference.
struct ReferenceCandidate {
  std::uint64_t id = 0;
  double time = 0.0;         ///< seconds
  RigidTransform T_cur_ref;  ///< reference camera to current camera
};

struct DepthReferenceOptions {
  double first_gap = 0.2;  ///< seconds, > 0: youngest useful reference; younger ones hardly differ
  double ratio = 2.0;      ///< > 1: wanted gaps are first_gap, first_gap ratio, ...; engineering
  double min_overlap = 0.3;  ///< share of the current image (at `depth`) that it must have seen
  double depth = 2.0;        ///< metres, > 0: typical scene depth for the overlap

  void validate() const;
};

/// References for `judge_depth`: gaps in time that grow geometrically, so that fast movers are
/// caught by the young and slow ones by the old, each with enough common view.
///
/// Writes indices into `candidates`, youngest first; returns how many. Each wanted gap takes the
/// candidate nearest to it in log time that is not taken yet. O(candidates x out), no allocation.
std::size_t choose_depth_references(const PinholeCamera& camera, double time,
                                    Span<const ReferenceCandidate> candidates,
                                    const DepthReferenceOptions& options, Span<int> out);

}  // namespace dynslam::geometry

#include "dynslam/geometry/detail/reference_choice_impl.hpp"
