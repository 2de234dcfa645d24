// Motion and structure from two images of one camera, without anything else known.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/points.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam::slam {

/// What relates the two images.
enum class TwoViewModel {
  kEssential,   ///< a scene with depth
  kHomography,  ///< a plane, or a camera that only turned
};

/// Why a pair of images was taken or refused.
enum class TwoViewStatus {
  kOk,
  kTooFewMatches,      ///< fewer than TwoViewOptions::min_points
  kNoModel,            ///< no motion explains enough matches
  kAmbiguous,          ///< two motions explain the matches about as well
  kTooLittleParallax,  ///< the camera hardly moved: turned, or stood still, or looks far away
};

/// "Essential" etc.
const char* to_string(TwoViewModel model);
/// "Ok" etc.
const char* to_string(TwoViewStatus status);

/// Settings of reconstruct_two_views.
struct TwoViewOptions {
  /// Points below which nothing is believed, >= 8. Engineering.
  int min_points = 50;
  /// Angle that the rays of `min_points` points must make at least, degrees, > 0. Engineering (the
  /// field's habit: 1).
  double min_parallax_deg = 1.0;
  /// Angle from which a point takes part at all, degrees, > 0 and <= min_parallax_deg: nearer to
  /// parallel, noise decides on which side of the camera it lies. Engineering.
  double min_point_parallax_deg = 0.35;
  /// The homography is taken when its share S_H / (S_H + S_E) of both models' scores is above
  /// this, (0, 1). Source: Mur-Artal et al. 2015, section IV.
  double homography_share = 0.45;
  /// A motion is clear when its squared errors (over their variance, truncated at 95 %) sum to so
  /// much less than those of any other, >= 0: twice the log of the likelihood ratio. Engineering.
  double min_likelihood_gap = 25.0;
  /// Largest standard deviation of the direction of translation, degrees, > 0: a small step across
  /// the image and a small turn look alike. Engineering.
  double max_direction_deg = 3.0;
  /// Share of a model's matches with enough parallax that must lie in front of both cameras under
  /// the motion, (0, 1]. Engineering.
  double min_front_share = 0.75;
  /// Share of the matches on their epipolar lines that must have become points, (0, 1]: where much
  /// shows no parallax at all, the camera may stand still and what has some may move by itself.
  /// Engineering: a road with trees far ahead leaves three in four, people who walk before a room
  /// half.
  double min_point_share = 0.67;
  /// Most random samples of each model, >= 1.
  int max_iterations = 2000;

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Result of reconstruct_two_views.
struct TwoViewReconstruction {
  TwoViewStatus status = TwoViewStatus::kTooFewMatches;
  TwoViewModel model = TwoViewModel::kEssential;  ///< that won by score
  double homography_share = 0.0;                  ///< S_H / (S_H + S_E)
  double direction_deg = 0.0;           ///< standard deviation of the direction of translation
  RigidTransform T_second_first;        ///< the median depth in the first camera is 1
  std::vector<Eigen::Vector3d> points;  ///< of each match, in the first camera
  std::vector<std::uint8_t> good;       ///< of each match: 1 when its point is believed
  std::size_t count = 0;                ///< of good ones

  bool ok() const { return status == TwoViewStatus::kOk; }
};

/// Relative pose and points of matched pixels (columns of `first` and `second`), up to scale.
///
/// A homography and an essential matrix are estimated by RANSAC and scored by their symmetric
/// errors, each truncated at 95 % and counted as Gamma - s (Gamma = 5.991), which tells the model.
/// The at most four motions of each compete with up to four valleys of the epipolar errors, found
/// by descent from directions all around: over a small step, or before a plane, random samples may
/// lead to a wrong motion only. Each that is supported is refined by bundle adjustment of both
/// views; then the likeliest must be clear of every other, put enough points in front of both
/// cameras with enough parallax, leave the direction of translation in little doubt, and not most
/// of what it explains without parallax. Points that fail the tests of `triangulate` are dropped. A
/// plane that two motions explain is refused.
/// `first_scales`, `second_scales`: side of each match's pyramid level in the first and the second
/// image, its standard deviation in pixels; empty: 1.
///
/// Anything but kOk leaves `points`, `good` and the motion without meaning. Columns with NaN never
/// take part. Throws InvalidArgument for an invalid camera or options and for sizes that differ.
/// O(iterations * matches), allocates. Thread-safe, deterministic.
/// Source: Mur-Artal, Montiel, Tardos, "ORB-SLAM: a versatile and accurate monocular SLAM system",
/// T-RO 2015, section IV. Departures: the calibrated essential matrix by five points in place of
/// the fundamental by eight, the search for all motions, likelihoods after refinement in place of
/// counts, the test of certainty.
TwoViewReconstruction reconstruct_two_views(const PinholeCamera& camera, const Points2d& first,
                                            const Points2d& second,
                                            Span<const float> first_scales = {},
                                            Span<const float> second_scales = {},
                                            const TwoViewOptions& options = {});

}  // namespace dynslam::slam
