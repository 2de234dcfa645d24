// Weighted geometric constraint: which features move, from their matches in reference keyframes.
#pragma once

#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/image_view.hpp"
#include "dynslam/core/match.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/geometry/depth_cells.hpp"
#include "dynslam/geometry/verdict.hpp"
#include "dynslam/geometry/views.hpp"

namespace dynslam::geometry {

/// A keyframe in which some of the current features were seen before.
struct ReferenceView {
  RigidTransform T_cur_ref;           ///< reference camera to current camera
  FeaturesView features;              ///< all features of the reference; not only the matched
  Span<const Match> matches;          ///< query: current feature, train: feature of the reference;
                                      ///< a current feature occurs at most once
  const DepthCells* cells = nullptr;  ///< the reference's depth image; null = not kept. Arbitrates
                                      ///< between mover and (un)covered background
};

/// How the references' votes make one verdict.
enum class Combination : std::uint8_t {
  kNull,      ///< no test at all: everything unknown
  kAny,       ///< dynamic if one reference says so, else static if one says so
  kMajority,  ///< the side with more votes; a tie is unknown
  kMean,      ///< mean normalized residual against the threshold
  kLogOdds,   ///< sum of log-likelihood ratios (default)
};

struct WeightedConstraintOptions {
  Combination combination = Combination::kLogOdds;  ///< engineering; the paper leaves it open
  double threshold = 4.0;         ///< sigma1 and sigma2 of the paper in standard deviations of c
                                  ///< and dz, > 0; engineering (a chi-square tail with room for
                                  ///< outliers of the noise model)
  double pixel_sigma = 1.0;       ///< pixels at level 0, > 0; ORB's localization, engineering
  DepthNoise depth_noise;         ///< of both measurements
  PoseNoise pose_noise;           ///< of T_cur_ref
  double min_baseline = 0.02;     ///< metres, >= 0: no epipolar vote where |t| is less
                                  ///< (pure rotation); engineering
  double min_parallax = 0.0035;   ///< radians, >= 0: no epipolar vote where the baseline seen
                                  ///< from the point (|t x f1| / z) is less; engineering: 2 px
  double min_scene_depth = 0.3;   ///< metres, > 0: nothing is nearer; bounds what translation can
                                  ///< do to a point without depth; engineering
  double depth_floor = 0.02;      ///< metres, >= 0, added to the threshold of dz: registration
                                  ///< and interpolation error of real sensors; engineering
  bool use_epipolar = true;       ///< the |c| test (paper)
  bool use_depth = true;          ///< the dz test (paper)
  bool use_transfer = true;       ///< displacement along the epipolar line beyond what the depth
                                  ///< of the reference explains; not in the paper, whose tests
                                  ///< miss a point that moves parallel to the baseline
  double dynamic_evidence = 2.0;  ///< largest log-odds one reference adds, > 0; engineering
  double static_evidence = 0.7;   ///< largest log-odds one reference takes away, > 0: less,
                                  ///< as a mover passes a test by chance more easily
  double decision = 0.6;          ///< |log-odds| below which the verdict is unknown, >= 0

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Scratch of `judge_features`; keep one per thread. Grows to the largest frame, then no
/// allocation.
struct WeightedConstraintWorkspace {
  std::vector<double> delta_sum;
  std::vector<double> residual_sum;
};

/// Judges N current features against their matches in the references.
///
/// For a feature with unit bearing f1 (depth z1) in a reference and f2 (depth z) now,
/// n = t x (R f1), c = n.f2 / (|n||f2|), z' = (R z1 f1 + t)_z, dz = z - z':
///
///     |c| > k sigma_c              -> dynamic, delta = |c|
///     else |dz| > k sigma_dz       -> dynamic, delta = |dz|
///     else |e| > k sigma_e         -> dynamic (e: displacement along the epipolar line)
///
/// with sigma_c from pixel noise of both rays (scaled by octave) and pose noise, sigma_dz from the
/// depth noise of both measurements, pose noise and the depth spread around the features. No
/// epipolar vote below `min_baseline` or `min_parallax`; no depth vote without both depths. Where
/// the reference's depth cells are given, a violated depth test counts only if the reference saw
/// free space at the current point; if the point was hidden there (or is hidden now by something
/// that was there before) the reference has no vote.
///
/// `out` has the size of `current`. NaN pixels or poses: kUnknown, kNotFinite. No references, no
/// matches: kUnknown, kNoReference. Throws InvalidArgument for invalid options or camera, arrays of
/// unequal size, a match whose index is out of range; `out` is then untouched.
/// O(matches), no allocation after warm-up; thread-safe with one workspace per thread.
/// Source: P-Static (LOP 2024, 10.3788/LOP231254) section 3.2; departures as said.
void judge_features(const PinholeCamera& camera, const FeaturesView& current,
                    Span<const ReferenceView> references, const WeightedConstraintOptions& options,
                    WeightedConstraintWorkspace& workspace, Span<FeatureVerdict> out);

/// Depth and depth spread of features from a depth image (metres, 0 or NaN = none).
///
/// Depth of the nearest pixel (0 if none or outside the image), spread = farthest minus nearest
/// depth in the (2 radius + 1)^2 window around it; a window with a quarter or more of its pixels
/// without depth counts as an edge: spread = infinity. Throws InvalidArgument for outputs whose
/// size is not that of `pixels` (an empty `spreads` is not wanted), an empty image, radius < 0.
/// O(N radius^2), does not allocate.
void measure_depths(ImageView<const float> depth, Pixels pixels, int radius, Span<float> depths,
                    Span<float> spreads);

}  // namespace dynslam::geometry

#include "dynslam/geometry/detail/weighted_constraint_impl.hpp"
