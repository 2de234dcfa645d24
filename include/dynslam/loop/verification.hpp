// Geometric verification of a loop: matches through the direct index, and the motion that explains
// them, found by RANSAC.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/image_view.hpp"
#include "dynslam/core/match.hpp"
#include "dynslam/core/points.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/loop/bow_vector.hpp"

namespace dynslam::loop {

/// How a verification ended.
enum class Verdict : std::uint8_t {
  kVerified = 0,
  kFewMatches,  ///< fewer matches than a decision needs
  kNoGeometry,  ///< no motion explains enough of them
  kOtherScene,  ///< a motion does, but not the rest of the images: an object was recognized
  kRefused      ///< none of these; for callables of the host
};

/// What a verification found out about a candidate.
struct Verification {
  Verdict verdict = Verdict::kRefused;
  std::size_t matches = 0;
  std::size_t inliers = 0;
  /// -log10 of the expected number of models as good as this one among random matches, over the
  /// least that is asked for: 1 is just enough. 0 where the host's callable gives none.
  double confidence = 0.0;
  /// Coordinates in the query's camera to coordinates in the candidate's camera,
  /// x_cand = scale R x_query + t. Identity where only an epipolar geometry was found.
  RigidTransform T_candidate_query;
  double scale = 1.0;
};

/// Settings of match_by_nodes.
struct NodeMatchOptions {
  /// Largest distance of a match as a share of the descriptor's bits. In [0, 1]. Engineering: 0.25,
  /// 64 of 256 bits; unrelated ORB descriptors differ in 0.5 +- 0.06.
  double max_distance = 0.25;
  /// A match is kept if distance < ratio x distance to the second nearest below the node. In
  /// (0, 1], 1 switches the test off. Source: 0.8, Lowe 2004.
  double ratio = 0.8;
  /// Keep only pairs that are each other's nearest.
  bool mutual = true;

  /// Throws InvalidArgument naming the first member that breaks its rule.
  void validate() const;
};

/// Nearest descriptor below the same node for every feature of the query.
///
/// Replaces `matches` (query: row of `query`, train: row of `train`), ascending in `query`. Of
/// equally near descriptors the first row counts. Throws InvalidArgument if the options are
/// invalid, the widths differ, or an index names a row that does not exist; `matches` is then
/// untouched. O(sum over the nodes of a x b x bytes); allocates O(rows). Thread-safe,
/// deterministic.
void match_by_nodes(const FeatureVector& query_index, DescriptorsView query,
                    const FeatureVector& train_index, DescriptorsView train,
                    const NodeMatchOptions& options, std::vector<Match>& matches);

/// Settings of the three RANSAC searches.
struct RansacOptions {
  /// Largest error of an inlier, pixels of the image. > 0. Engineering: 3, ORB key points of the
  /// coarser levels included.
  double max_error = 3.0;
  /// Fewest inliers. At least the size of a minimal sample plus one. Engineering: 12.
  std::size_t min_inliers = 12;
  /// Least significance: -log10 of the number of false alarms, the number of models with as many
  /// inliers that random matches would be expected to give. >= 0; 0 switches the test off. Source:
  /// Moisan & Stival, IJCV 2004, whose threshold is 0 for one image pair; engineering: 6, so that
  /// tens of thousands of verifications together give no false one.
  double min_significance = 6.0;
  /// Most samples drawn. >= 1.
  int max_iterations = 1000;
  /// Samples are drawn until one without outliers has been drawn with this probability. In (0, 1).
  double confidence = 0.999;
  /// Seed of the samples; the same seed gives the same result.
  std::uint64_t seed = 1;

  /// Throws InvalidArgument naming the first member that breaks its rule.
  void validate() const;
};

/// Epipolar geometry of two images, x_candidate' F x_query = 0 in homogeneous pixels.
struct EpipolarModel {
  Eigen::Matrix3d F = Eigen::Matrix3d::Zero();
  std::vector<std::uint8_t> inliers;  ///< one flag a match
};

/// Image to image, nothing known of cameras and depth: fundamental matrix by seven-point RANSAC
/// with local optimization.
///
/// Column i of the two sides is match i in pixels; `image_width` and `image_height` are those of
/// both images (for two different ones the larger). An error is the distance to the epipolar line,
/// the larger one of both images. The confidence compares with matches that fall anywhere in the
/// image. `model`, unless null, is replaced.
///
/// Matches at the same place of either image (within a pixel) count once: the least of the
/// different places of the two sides is what significance and min_inliers are about.
///
/// Matches with NaN or infinite coordinates are never inliers. Throws InvalidArgument for invalid
/// options, different numbers of columns, or an image without pixels.
/// O(iterations x matches), allocates O(matches). Thread-safe, deterministic.
/// Source: Hartley & Zisserman, 2nd ed., 11.1 and 11.6; Chum, Matas & Kittler, DAGM 2003.
Verification verify_epipolar(const Points2d& query, const Points2d& candidate, int image_width,
                             int image_height, const RansacOptions& options = {},
                             EpipolarModel* model = nullptr);

/// Matches whose points are known on both sides; columns belong together.
struct PointMatches {
  Points3d query_points;      ///< in the query's camera, metres
  Points2d query_pixels;      ///< where the query's image shows them
  Points3d candidate_points;  ///< in the candidate's camera
  Points2d candidate_pixels;
};

/// A motion and the matches that it explains.
struct MotionModel {
  RigidTransform T_candidate_query;
  double scale = 1.0;
  std::vector<std::uint8_t> inliers;  ///< one flag a match
};

/// Points of the candidate, pixels of the query: camera pose of the query by P3P RANSAC, refined on
/// its inliers by Gauss-Newton.
///
/// Columns: points in the candidate's camera, and where the query's image shows them. An error is
/// that of the point in the query's image, pixels. The confidence compares with matches that fall
/// anywhere in the query's image. `model`, unless null, is replaced.
///
/// Matches with NaN or infinity are never inliers. Throws InvalidArgument for invalid options, an
/// invalid camera or different numbers of columns. O(iterations x matches), allocates O(matches).
/// Thread-safe, deterministic.
/// Source: Grunert 1841 as in Haralick et al., IJCV 1994.
Verification verify_pose(const Points3d& candidate_points, const Points2d& query_pixels,
                         const PinholeCamera& query_camera, const RansacOptions& options = {},
                         MotionModel* model = nullptr);

/// Points on both sides: rigid motion, or with `with_scale` similarity (monocular maps drift in
/// scale), by three-point RANSAC.
///
/// An error is the larger one of the two reprojections, candidate's points in the query's image and
/// the other way round, pixels. Otherwise as verify_pose.
/// Source: Horn, JOSA A 1987; Umeyama, PAMI 1991.
Verification verify_similarity(const PointMatches& matches, const PinholeCamera& query_camera,
                               const PinholeCamera& candidate_camera, bool with_scale,
                               const RansacOptions& options = {}, MotionModel* model = nullptr);

/// Settings of check_depth.
struct DepthCheckOptions {
  /// Least share of the compared pixels that agree. In [0, 1]. Engineering: three quarters; in a
  /// still scene nine tenths agree, and up to six tenths where a near mover was recognized
  /// elsewhere.
  double min_agreement = 0.75;
  /// Fewest compared pixels as a share of those looked at; with fewer nothing is decided and the
  /// verdict stays. In [0, 1].
  double min_overlap = 0.05;
  /// Distance of the pixels that are looked at, in each direction. >= 1.
  int grid = 8;
  /// Depths agree within absolute + relative z. Metres, and a share of the depth; >= 0, finite, not
  /// both 0. Engineering: 3 cm and 4 % take three sigma of a Kinect at 3 m (sigma = 1.4 cm, Nguyen
  /// et al. 2012) and the error of a pose from a dozen matches.
  double absolute = 0.03;
  double relative = 0.04;

  /// Throws InvalidArgument naming the first member that breaks its rule.
  void validate() const;
};

/// Share of one image's pixels, among those that both depth images see, whose depth the other one
/// confirms; of both directions the lesser. NaN if too few pixels could be compared.
///
/// A person or a carried panel that is met again at another place gives matches, and a
/// motion that explains them; the scene behind then disagrees. A depth of 0 or NaN is none: set it
/// where a mask says that something moves, or a true loop past many movers is refused.
/// Throws InvalidArgument for invalid options, invalid cameras, or a depth image of another size
/// than its camera. O(pixels / grid^2), no allocation, thread-safe.
double depth_agreement(ImageView<const float> query_depth, ImageView<const float> candidate_depth,
                       const PinholeCamera& query_camera, const PinholeCamera& candidate_camera,
                       const RigidTransform& T_candidate_query,
                       const DepthCheckOptions& options = {});

/// Turns a verdict of kVerified into kOtherScene if depth_agreement is below min_agreement.
void check_depth(ImageView<const float> query_depth, ImageView<const float> candidate_depth,
                 const PinholeCamera& query_camera, const PinholeCamera& candidate_camera,
                 Verification& verification, const DepthCheckOptions& options = {});

}  // namespace dynslam::loop
