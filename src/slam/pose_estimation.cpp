#include "pose_estimation.hpp"

namespace dynslam::slam {
namespace {

factors::PoseOptimizerOptions optimizer_options(factors::WeightMode weights) {
  factors::PoseOptimizerOptions options;
  options.weights = weights;
  options.rounds = weights == factors::WeightMode::kFixed ? 4 : 2;
  return options;
}

}  // namespace

PoseEstimation::PoseEstimation(const DepthCamera& camera, const std::vector<float>& scale_factors,
                               factors::WeightMode weights)
    : camera_(camera), optimizer_(optimizer_options(weights)) {
  for (const float scale : scale_factors) inverse_sigma_of_octave_.push_back(1.0F / scale);
}

factors::PoseResult PoseEstimation::solve(const std::vector<PointMatch>& matches,
                                          const FrameFeatures& features,
                                          const RigidTransform& initial,
                                          const factors::PosePrior* prior) {
  points_.clear();
  pixels_.clear();
  right_columns_.clear();
  inverse_sigma_.clear();
  weights_.clear();
  for (const PointMatch& match : matches) {
    const cv::KeyPoint& keypoint = features.keypoints[match.feature];
    points_.push_back(match.position);
    pixels_.emplace_back(keypoint.pt.x, keypoint.pt.y);
    right_columns_.push_back(features.right_columns[match.feature]);
    inverse_sigma_.push_back(inverse_sigma_of_octave_[static_cast<std::size_t>(keypoint.octave)]);
    weights_.push_back(match.weight);
  }
  const factors::PoseObservations<float> observations = {as_points<double>(points_),
                                                         as_points<float>(pixels_),
                                                         right_columns_,
                                                         inverse_sigma_,
                                                         weights_,
                                                         {}};
  return optimizer_.optimize(camera_, observations, initial, prior);
}

}  // namespace dynslam::slam
