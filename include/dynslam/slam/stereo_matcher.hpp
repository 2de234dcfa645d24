// Depth of an image's features from the rectified image of a second camera.
#pragma once

#include <cstdint>
#include <vector>

#include <opencv2/core/mat.hpp>
#include <opencv2/core/types.hpp>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/image_view.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/features/orb.hpp"

namespace dynslam::slam {

/// Settings of StereoMatcher.
struct StereoOptions {
  /// Least depth that is looked for, in baselines, > 0: it bounds the search along the row.
  /// Engineering.
  double min_depth_baselines = 1.0;
  /// Largest Hamming distance of a match, bits, >= 0. Engineering.
  int max_distance = 75;
  /// Half side of the patch that is compared, pixels of the feature's pyramid level, 1..20.
  /// Engineering: 5.
  int patch_radius = 5;
  /// How far the patch is moved along the row for the best fit, pixels of the level, 1..20.
  /// Engineering: 5.
  int search_radius = 5;
  /// A match is dropped when its patches differ by more than this many times the median difference
  /// of all matches, > 0. Engineering: 2.1 is about two and a half sigma of a normal distribution's
  /// absolute value.
  double max_difference_ratio = 2.1;

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Finds left features again on the same row of the right image.
///
/// ORB features of the right image give the candidates: within two rows (pixels of the level), on a
/// neighbouring level, nearest in Hamming distance. The patch around the left feature is then moved
/// over the right image on the feature's own pyramid level, and a parabola through the least sums
/// of absolute differences (of values less their mean) gives the column to a fraction of a pixel.
///
/// Buffers are kept between calls: one matcher per thread, not thread-safe. Deterministic.
/// Source: Mur-Artal, Tardos, "ORB-SLAM2", T-RO 2017, section III-A for the idea.
class StereoMatcher {
 public:
  /// Throws InvalidArgument if the camera or an option is invalid.
  StereoMatcher(const DepthCamera& camera, const features::OrbOptions& orb,
                const StereoOptions& options = {});

  /// Replaces `right_columns` by the column of each left feature in the right image, pixels of
  /// level 0; NaN where none was found. The depth is bf / (u - right column), > 0.
  ///
  /// `descriptors`: N x 32, of the left key points. Throws InvalidArgument if an image is not of
  /// the camera's size or the descriptors are not N; `right_columns` is then untouched. Cost of one
  /// extraction and O(N * (features on a row + patch * search)).
  void match(GrayView left, GrayView right, Span<const cv::KeyPoint> keypoints,
             DescriptorsView descriptors, std::vector<float>& right_columns);

 private:
  struct Fit {
    float column = 0.0F;      // level 0
    float difference = 0.0F;  // mean of the absolute differences
  };
  void sort_into_rows();
  int nearest(const cv::KeyPoint& left, const std::uint8_t* descriptor) const;
  bool refine(const cv::KeyPoint& left, const cv::KeyPoint& right, Fit& fit) const;
  void build_pyramid(const cv::Mat& image, std::vector<cv::Mat>& pyramid) const;

  DepthCamera camera_;
  StereoOptions options_;
  features::OrbExtractor extractor_;
  std::vector<cv::KeyPoint> right_keypoints_;
  cv::Mat right_descriptors_;
  std::vector<std::vector<int>> rows_;  // right features that may be matched from each row
  std::vector<cv::Mat> left_pyramid_, right_pyramid_;
};

}  // namespace dynslam::slam
