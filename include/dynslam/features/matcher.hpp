// Matching of binary descriptors by Hamming distance: all against all, or in
// windows around predicted positions.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include <opencv2/core/types.hpp>

#include "dynslam/core/image_view.hpp"
#include "dynslam/core/match.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/features/keypoint_grid.hpp"

namespace dynslam::features {

/// Settings of match_brute_force.
struct BruteForceOptions {
  /// Largest distance of a match in bits, >= 0. Of 256 bits, 50 is strict and
  /// 100 lax; off by default.
  int max_distance = std::numeric_limits<int>::max();
  /// A match is kept if distance < ratio x distance to the second nearest train
  /// descriptor; in (0, 1], 1 switches the test off. Lowe 2004: 0.8. A lone
  /// train descriptor passes.
  float ratio = 1.0F;
  /// Keep only pairs that are each other's nearest.
  bool cross_check = false;

  /// Throws InvalidArgument naming the first member that breaks its rule.
  void validate() const;
};

/// Nearest train descriptor of every query descriptor.
///
/// Replaces `matches`, ascending in `query`, at most one per query. Of equally
/// near descriptors the first row is taken, on both sides. Either set empty: no
/// matches. Throws InvalidArgument if the options are invalid or the widths
/// differ (both sets not empty); `matches` is then untouched. O(queries x
/// trains x bytes); allocates as `matches` grows, and O(queries + trains)
/// scratch. Thread-safe, deterministic, the same on every SIMD target.
void match_brute_force(DescriptorsView query, DescriptorsView train,
                       const BruteForceOptions& options, std::vector<Match>& matches);

/// Where the features of the map (or of another frame) are expected in this
/// frame: P of them, everything bound without a copy.
struct WindowPredictions {
  /// Predicted pixel, P. A prediction with a NaN or infinity here or in the
  /// radius is skipped.
  StridedSpan<const cv::Point2f> positions;
  /// Half side of the square search window in pixels, P. A radius <= 0 skips
  /// the prediction.
  StridedSpan<const float> radii;
  /// Lowest octave accepted, P; empty: no bound.
  StridedSpan<const int> min_octaves;
  /// Highest octave accepted, P; empty: no bound.
  StridedSpan<const int> max_octaves;
  /// P rows. May be empty if P = 0.
  DescriptorsView descriptors;
};

/// Features of the frame that is searched: N of them.
struct WindowFeatures {
  /// Grid built over the features' positions; required, grid->size() == N.
  const KeypointGrid* grid = nullptr;
  /// Octave of each feature, N; may be empty if no prediction bounds octaves
  /// and `ratio_within_octave` is off. Bind with `field(keypoints,
  /// &cv::KeyPoint::octave)`.
  StridedSpan<const int> octaves;
  /// N rows. May be empty if N = 0.
  DescriptorsView descriptors;
  /// Features not to be matched (already taken) have a value other than 0, N;
  /// empty: all are free.
  Span<const std::uint8_t> taken;
};

/// Settings of match_windowed.
struct WindowOptions {
  /// Largest distance of a match in bits, >= 0. Engineering: 100 of 256,
  /// windows being small.
  int max_distance = 100;
  /// Kept if distance < ratio x distance to the second nearest feature in the
  /// window; in (0, 1], 1 switches the test off. A lone feature passes.
  float ratio = 1.0F;
  /// Apply the ratio only if the two nearest have the same octave: one corner
  /// seen on two levels gives two descriptors nearly alike, which is no
  /// ambiguity.
  bool ratio_within_octave = false;
  /// Give each feature to the nearest prediction only (the first of equally
  /// near ones); the others go without. Off: a feature may serve several
  /// predictions.
  bool one_to_one = true;

  /// Throws InvalidArgument naming the first member that breaks its rule.
  void validate() const;
};

/// Best feature in the window of every prediction.
///
/// Replaces `matches` (query = prediction, train = feature), ascending in
/// `query`. Of equally near features the one with the lowest index is taken.
/// The second nearest for `ratio` is sought among the same candidates: in the
/// window, in the octave range, not taken. Throws InvalidArgument if the
/// options are invalid, the grid is missing, sizes disagree or descriptor
/// widths differ; `matches` is then untouched. O(candidates x bytes + M log M
/// for `one_to_one`); allocates only as `matches` grows. Thread-safe,
/// deterministic, the same on every SIMD target.
void match_windowed(const WindowPredictions& predictions, const WindowFeatures& features,
                    const WindowOptions& options, std::vector<Match>& matches);

}  // namespace dynslam::features
