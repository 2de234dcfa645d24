// Pose of a frame from matches between points of the world and its features.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/factors/pose_optimizer.hpp"
#include "dynslam/slam/frame.hpp"

#include "residual_noise.hpp"

namespace dynslam::slam {

/// Feature `feature` shows the point of the world at `position`, believed static to `weight`.
struct PointMatch {
  std::uint32_t source = 0;  ///< the caller's index of the point
  std::uint32_t feature = 0;
  Eigen::Vector3d position;
  float weight = 1.0F;
};

/// Gathers matches, optimizes, tells inliers. Buffers are kept between calls.
class PoseEstimation {
 public:
  PoseEstimation(const DepthCamera& camera, const std::vector<float>& scale_factors,
                 factors::WeightMode weights);

  /// Result by match is in inliers(). O(matches).
  factors::PoseResult solve(const std::vector<PointMatch>& matches, const FrameFeatures& features,
                            const RigidTransform& initial,
                            const factors::PosePrior* prior = nullptr);

  /// Learns the noise of features from the inliers of the last solve(), for those to come: errors
  /// are then weighed by it (against each other, robust loss, prior, covariance). Who is an inlier
  /// by its key point depends on how sure that is beside others, and not on the noise of all.
  void learn_noise(const RigidTransform& T_cam_world);

  Span<const std::uint8_t> inliers() const { return optimizer_.inliers(); }
  /// Weights at the optimum, by match.
  Span<const float> weights() const { return optimizer_.weights(); }

 private:
  DepthCamera camera_;
  std::vector<float> scale_factors_;
  factors::PoseOptimizerOptions options_;
  factors::PoseOptimizer optimizer_;
  ResidualNoise residuals_;
  FeatureNoise noise_;
  std::vector<Eigen::Vector3d> points_;
  std::vector<Eigen::Vector2f> pixels_;
  std::vector<float> right_columns_, inverse_sigma_, right_inverse_sigma_, weights_;
  std::vector<float> alignment_sigmas_;
};

}  // namespace dynslam::slam
