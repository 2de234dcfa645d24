// Errors of an estimated trajectory: absolute, relative, KITTI's.
#pragma once

#include <cstddef>
#include <limits>
#include <string_view>
#include <vector>

#include "dynslam/core/span.hpp"
#include "dynslam/core/trajectory.hpp"
#include "dynslam/evaluation/alignment.hpp"
#include "dynslam/evaluation/association.hpp"

namespace dynslam::evaluation {

/// Summary of a set of errors; NaN in every member when `count` is 0.
struct Statistics {
  double rmse = std::numeric_limits<double>::quiet_NaN();  ///< sqrt(mean of squares)
  double mean = std::numeric_limits<double>::quiet_NaN();
  double median = std::numeric_limits<double>::quiet_NaN();  ///< mean of the middle two if even
  double std =
      std::numeric_limits<double>::quiet_NaN();  ///< of the population, sqrt(1/n sum (x-mean)^2)
  double min = std::numeric_limits<double>::quiet_NaN();
  double max = std::numeric_limits<double>::quiet_NaN();
  std::size_t count = 0;
};

/// Summary of `values`. Throws InvalidArgument when one is not finite. O(n), allocates a copy.
Statistics statistics(Span<const double> values);

/// Quantile by linear interpolation between order statistics (numpy's default), share in [0, 1];
/// NaN values are left out; NaN when none is left. O(n), allocates a copy.
double quantile(Span<const double> values, double share);

/// (a - b) / a in percent: how much smaller the error b is than the error a. NaN when a is 0.
double improvement_percent(double a, double b);

/// How much of the truth an estimate covers.
struct Coverage {
  std::size_t truth_poses = 0;
  std::size_t estimate_poses = 0;
  std::size_t pairs = 0;
  /// Share of the truth's duration, 0..1, that lies between consecutive associated poses no more
  /// than three median steps apart: a truth at 100 Hz and an estimate at 30 Hz cover fully, a track
  /// lost for half of the time covers half. A truth of one pose is covered when it is associated.
  double time_share = 0.0;
};

struct AteOptions {
  Alignment alignment = Alignment::kSE3;
  AssociationOptions association;

  void validate() const;
};

/// Absolute trajectory error.
struct AteResult {
  Statistics error;             ///< metres, over the associated poses
  std::vector<double> errors;   ///< metres, errors[k] belongs to pairs[k]
  std::vector<PosePair> pairs;  ///< in order of time
  AlignmentResult alignment;
  Trajectory aligned;  ///< the whole estimate, associated or not, in the truth's frame
  Coverage coverage;
};

/// Distance of every associated pose from the truth after alignment:
/// e_k = | t_truth(k) - S t_estimate(k) |.
///
/// Without associated poses (also for empty trajectories) `error.count` is 0 and `aligned` is the
/// estimate as it is; with few poses see AlignmentStatus. Throws InvalidArgument when a timestamp
/// or pose is not finite, timestamps do not increase strictly, or options are broken.
/// O(n + m), allocates the result. Thread-safe.
/// Source: Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012.
AteResult ate(Span<const StampedPose> truth, Span<const StampedPose> estimate,
              const AteOptions& options = {});

enum class RpeUnit { kFrames, kSeconds, kMetres };

/// Which pairs of poses are compared.
enum class RpePairs {
  kAuto,         ///< kConsecutive for frames and metres, kAll for seconds
  kConsecutive,  ///< pairs end to end, no stretch is counted twice
  kAll,          ///< a pair begins at every pose that has a partner
};

/// Whose path length counts when the step is in metres.
enum class RpePath { kEstimate, kTruth };

struct RpeOptions {
  double delta = 1.0;  ///< step, > 0; a whole number for frames. P-Static: 1 frame, 1 s or k metres
  RpeUnit unit = RpeUnit::kFrames;
  RpePairs pairs = RpePairs::kAuto;
  /// kEstimate gives the published reference figures.
  RpePath path = RpePath::kEstimate;
  /// In seconds, and for all pairs in metres: the partner's step may differ from delta by this
  /// share of delta, in (0, 1). Engineering.
  double tolerance = 0.1;
  /// Relative errors do not feel a rigid alignment; kSim3 corrects the scale.
  Alignment alignment = Alignment::kNone;
  AssociationOptions association;

  void validate() const;
};

/// A stretch between two associated poses and its error.
struct RelativeError {
  PosePair first;
  PosePair second;
  double time = 0.0;          ///< seconds, the truth's timestamp of `second`
  double translation = 0.0;   ///< metres
  double rotation_deg = 0.0;  ///< degrees, 0..180
};

/// Relative pose error.
struct RpeResult {
  Statistics translation;   ///< metres
  Statistics rotation_deg;  ///< degrees
  std::vector<RelativeError> errors;
  AlignmentResult alignment;
  Coverage coverage;
};

/// Error of the motion between two poses, for pairs a step apart:
/// E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j) with the truth Q and the estimate P; |t(E)| and angle(R(E)).
///
/// Steps are counted over the associated poses. Pairs (i, j), by unit and rule:
///  - frames: j = i + delta; consecutive begins at pose 0, then at j.
///  - seconds: j is the pose nearest in the estimate's time to time(i) + delta; a pair that is off
///    by more than the tolerance is left out (consecutive then tries the next i).
///  - metres, consecutive: the path is summed up from pose 0; each pose at which the sum reaches
///    delta is a knot and sets the sum back to 0; pairs are neighbouring knots. The stretch before
///    the first knot is not used.
///  - metres, all: j is the pose whose path from i is nearest to delta, within the tolerance.
///
/// No pair gives count 0. Throws as `ate`. O(n + m), with a binary search per pose for seconds and
/// for all pairs in metres; allocates the result. Thread-safe. Source: Sturm et al., IROS 2012; the
/// metre rule is the one of the published figures that the tests reproduce.
RpeResult rpe(Span<const StampedPose> truth, Span<const StampedPose> estimate,
              const RpeOptions& options = {});

struct KittiOptions {
  /// Lengths of the stretches, metres, > 0. Source: KITTI odometry benchmark.
  std::vector<double> lengths = {100, 200, 300, 400, 500, 600, 700, 800};
  int step = 10;  ///< a stretch begins at every step-th frame, >= 1. Source: KITTI
  /// kSim3 corrects the scale; a rigid alignment changes nothing.
  Alignment alignment = Alignment::kNone;
  AssociationOptions association;

  void validate() const;
};

/// One stretch of KITTI's metric.
struct KittiSegment {
  PosePair first;
  PosePair last;
  double length = 0.0;               ///< metres, the nominal one
  double translation_percent = 0.0;  ///< of the length
  double rotation_deg_per_100m = 0.0;
};

/// Means over stretches: of one length, or of all.
struct KittiMean {
  double length = 0.0;  ///< metres; 0 for all lengths together
  double translation_percent = std::numeric_limits<double>::quiet_NaN();
  double rotation_deg_per_100m = std::numeric_limits<double>::quiet_NaN();
  std::size_t count = 0;
};

struct KittiResult {
  KittiMean all;  ///< the benchmark's two figures; count 0 when the path is too short
  std::vector<KittiMean> by_length;  ///< one for each of KittiOptions::lengths
  std::vector<KittiSegment> segments;
  Coverage coverage;
};

/// KITTI's odometry metric: relative errors over stretches of fixed length, divided by the length.
///
/// A stretch begins at every `step`-th associated pose and ends at the first whose path along the
/// truth is longer than the length. Throws as `ate`. O(n + m + lengths * n / step * log n),
/// allocates the result. Thread-safe. Source: Geiger et al., "Are we ready for autonomous
/// driving?", CVPR 2012, and the benchmark's development kit.
KittiResult kitti_metric(Span<const StampedPose> truth, Span<const StampedPose> estimate,
                         const KittiOptions& options = {});

}  // namespace dynslam::evaluation
