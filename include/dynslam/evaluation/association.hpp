// Which pose of one trajectory belongs to which pose of another: association by time.
#pragma once

#include <cstddef>
#include <vector>

#include "dynslam/core/span.hpp"
#include "dynslam/core/trajectory.hpp"

namespace dynslam::evaluation {

/// How poses are associated.
struct AssociationOptions {
  /// Largest time between associated poses, seconds, >= 0. Source: TUM RGB-D tools.
  double max_difference = 0.02;
  /// Added to the estimate's timestamps before comparing, seconds, finite.
  double offset = 0.0;

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Pose `truth` of one trajectory belongs to pose `estimate` of the other.
struct PosePair {
  std::size_t truth = 0;
  std::size_t estimate = 0;

  friend bool operator==(const PosePair& a, const PosePair& b) {
    return a.truth == b.truth && a.estimate == b.estimate;
  }
};

/// Associates poses by their timestamps, one to one.
///
/// Candidates are a truth and an estimate that follow each other when all poses are put in order of
/// time; of these the closest in time are taken first (the earlier one of two equally close), each
/// pose at most once, up to `max_difference` apart (inclusive, with 1e-9 s of slack for rounding).
/// So the pairs come in order of time on both sides and never cross, which taking the closest of
/// all pairs does not promise.
///
/// Empty trajectories give no pairs. Throws InvalidArgument when timestamps are not finite and
/// strictly increasing, and for broken options. O(n + m), allocates. Thread-safe.
std::vector<PosePair> associate(Span<const StampedPose> truth, Span<const StampedPose> estimate,
                                const AssociationOptions& options = {});

}  // namespace dynslam::evaluation
