// ORB features spread evenly over the image and kept off a mask of what moves.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <opencv2/core/mat.hpp>
#include <opencv2/core/types.hpp>

#include "dynslam/core/image_view.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam::features {

/// Bytes of an ORB descriptor.
inline constexpr int kOrbDescriptorBytes = 32;

/// Diameter in level pixels of the patch that gives a key point its angle.
inline constexpr int kOrbPatchSize = 31;

/// Where a level of the pyramid shows a level-0 column or row; both are in pixels of their level,
/// whose centres lie at integers. `scale` is the level's of OrbExtractor::scale_factors().
inline float to_level(float level0, float scale) { return (level0 + 0.5F) / scale - 0.5F; }

/// The inverse of `to_level`.
inline float from_level(float on_level, float scale) { return (on_level + 0.5F) * scale - 0.5F; }

/// Nearest that the pixel of a key point comes to the border of its pyramid level, in level pixels;
/// rotated test pairs reach 18.
inline constexpr int kOrbBorder = 19;

/// Settings of OrbExtractor.
struct OrbOptions {
  /// Most key points returned for an image; >= 1. Engineering: 1000 at 640x480,
  /// 2000 for KITTI.
  int max_features = 1000;
  /// Side of a pyramid level over the side of the next, > 1 and <= 4. ORB
  /// paper: about sqrt(2), the field's habit (and existing vocabularies): 1.2.
  float scale_factor = 1.2F;
  /// Levels of the pyramid, 1..32. Levels too small to hold a patch are left
  /// out.
  int levels = 8;
  /// Contrast of a corner in grey values, 1..254: centre against nine
  /// contiguous pixels of the circle of radius 3 (FAST-9). Tried first in each
  /// cell.
  int fast_threshold = 20;
  /// Contrast tried in cells that `fast_threshold` leaves
  /// empty, 1..fast_threshold. Set equal to `fast_threshold` to switch the
  /// second try off.
  int min_fast_threshold = 7;
  /// Share of each level's budget that is spread evenly over the image, 0..1; the rest goes to the
  /// strongest corners left, wherever they are. Even features hold a pose better, strong ones are
  /// found again more often. 0: the strongest only, as cv::ORB; 1: evenly only. Engineering.
  float spread = 0.5F;
  /// Side in level pixels of the cells of the two thresholds, >= 8.
  /// Engineering.
  int cell_size = 32;
  /// Put key points where the scores around a corner peak, not on the corner's pixel. Engineering:
  /// it halves their error, see docs/components/features.md. Descriptors and angles are of the
  /// pixel.
  bool subpixel = true;
  /// A key point is dropped if any mask pixel within this many level-0 pixels
  /// of it (a square window) is set; 0..1024. 0 asks the pixel under the key
  /// point only, right for masks that were dilated already.
  int mask_margin = 0;

  /// Throws InvalidArgument naming the first member that breaks its rule.
  void validate() const;
};

/// How many key points an image gets, and where.
struct OrbBudget {
  /// Most key points outside of `crowd`, >= 1.
  int max_features = 1000;
  /// Empty, or of the image's size: where it is not 0 key points have a budget of their own, so
  /// that what is of less use there takes none from the rest of the image.
  MaskView crowd = {};
  /// Most key points on `crowd`, >= 0, beside `max_features`.
  int max_in_crowd = 0;
};

/// Finds FAST-9 corners on an image pyramid, spreads them, and describes them with the steered
/// 256-pair BRIEF of the ORB paper.
///
/// Descriptors use OpenCV's learned test pairs, so vocabularies trained on cv::ORB (and on systems
/// derived from it) work unchanged. Levels get shares of the budget in inverse proportion to their
/// scale, and what a level cannot fill goes to the others. Of each share a part is spread by a
/// quadtree: all squares of a size are quartered before any smaller one, the fullest first, until
/// there are as many squares with corners as are asked for; each keeps its strongest corner. The
/// other part goes to the strongest of the other corners (see OrbOptions::spread).
///
/// Each key point carries
/// - `pt`: level-0 pixels, pixel centres at integers. Pixel i of a level is from_level(i, scale).
///   With OrbOptions::subpixel, in each direction where the parabola through the scores of the
///   pixel and its two neighbours peaks, less than half a level pixel away.
/// - `octave`: level of the pyramid.
/// - `angle`: degrees in [0, 360), clockwise in the image (x right, y down), of the intensity
///   centroid of a round patch 31 pixels wide.
/// - `size`: 31 scale_factors()[octave].
/// - `response`: FAST score in grey values, the largest threshold at which the pixel is a corner.
/// - `class_id`: -1.
///
/// Buffers are kept between calls: one extractor per thread, not thread-safe. The output depends on
/// the image, the mask and the options alone, bit for bit: not on earlier calls, on the vector
/// instructions of the machine or on OpenCV's number of threads.
///
/// Source: Rublee, Rabaud, Konolige, Bradski, "ORB: an efficient alternative to SIFT or SURF", ICCV
/// 2011. Departures: FAST score instead of the Harris measure, quadtree beside the strongest of the
/// whole image, two thresholds, parabolas. Departure from OpenCV: `pt` is where the pixel's centre
/// really lies; OpenCV's i * scale is off by (scale - 1) / 2, which is 1.3 pixels on the eighth
/// level.
class OrbExtractor {
 public:
  /// Throws InvalidArgument if the options are invalid.
  explicit OrbExtractor(const OrbOptions& options = {});
  ~OrbExtractor();
  OrbExtractor(OrbExtractor&&) noexcept;
  OrbExtractor& operator=(OrbExtractor&&) noexcept;
  OrbExtractor(const OrbExtractor&) = delete;
  OrbExtractor& operator=(const OrbExtractor&) = delete;

  /// Replaces `keypoints` and `descriptors` (N x 32, CV_8U, N <= max_features;
  /// an empty matrix if N = 0) by the features of `image`, ordered by octave.
  ///
  /// `mask` is empty or has the image's size; where it is not 0 no key point is
  /// returned and the budget goes to the rest. The pixel asked is the one
  /// nearest to `pt`. Images too small for a patch, flat images and fully
  /// masked ones give zero features.
  ///
  /// Throws InvalidArgument if the image is empty, has a side above 65535, or the mask has another
  /// size; outputs are then untouched. O(pixels + corners log corners); allocates
  /// only when an image is larger or has more corners than any before.
  /// `descriptors` is reallocated only if its shape must change: like all of OpenCV's functions
  /// this writes into the matrix it is given, so hand in a fresh one to keep the old rows.
  void extract(GrayView image, MaskView mask, std::vector<cv::KeyPoint>& keypoints,
               cv::Mat& descriptors);

  /// The same with a budget for this image alone, in place of OrbOptions::max_features. Throws
  /// InvalidArgument as well if a number of the budget breaks its rule or the crowd has another
  /// size than the image.
  void extract(GrayView image, MaskView mask, const OrbBudget& budget,
               std::vector<cv::KeyPoint>& keypoints, cv::Mat& descriptors);

  /// Descriptors (N x 32, CV_8U) of key points found elsewhere, at their `pt`,
  /// `angle` (degrees) and `octave`; row i belongs to keypoints[i].
  ///
  /// Pixels beyond the border of a level are those of the nearest border pixel,
  /// so any key point inside the image has a descriptor. Throws InvalidArgument
  /// if the image is empty, or if a key point has a non-finite position or
  /// angle, lies outside the image, or has an octave that the pyramid of this
  /// image lacks; outputs are then untouched. Cost as `extract` without the
  /// search.
  void describe(GrayView image, Span<const cv::KeyPoint> keypoints, cv::Mat& descriptors);

  /// A level of the pyramid of the last image, for what is done with its key points; empty if that
  /// image was too small for it. Valid until the next call of another member.
  GrayView level(int octave) const;

  /// Side of a pixel of each level in level-0 pixels; `levels` entries, the first 1.
  const std::vector<float>& scale_factors() const;

  /// Most features that each level is asked for; sums to max_features.
  const std::vector<int>& features_per_level() const;

  const OrbOptions& options() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dynslam::features
