#include "pose_estimation.hpp"

namespace dynslam::slam {
namespace {

constexpr double kMomentum = 0.8;  // share of the frames before in the noise

factors::PoseOptimizerOptions optimizer_options(factors::WeightMode weights) {
  factors::PoseOptimizerOptions options;
  options.weights = weights;
  options.rounds = weights == factors::WeightMode::kFixed ? 4 : 2;
  return options;
}

}  // namespace

PoseEstimation::PoseEstimation(const DepthCamera& camera, const std::vector<float>& scale_factors,
                               factors::WeightMode weights)
    : camera_(camera), options_(optimizer_options(weights)), optimizer_(options_) {
  for (const float scale : scale_factors) inverse_sigma_of_octave_.push_back(1.0F / scale);
}

factors::PoseResult PoseEstimation::solve(const std::vector<PointMatch>& matches,
                                          const FrameFeatures& features,
                                          const RigidTransform& initial,
                                          const factors::PosePrior* prior) {
  const auto certainty = static_cast<float>(1.0 / noise_);
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
    inverse_sigma_.push_back(certainty *
                             inverse_sigma_of_octave_[static_cast<std::size_t>(keypoint.octave)]);
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

void PoseEstimation::learn_noise(const RigidTransform& T_cam_world) {
  residuals_.clear();
  for (std::size_t i = 0; i < points_.size(); ++i) {
    if (inliers()[i] == 0) continue;
    residuals_.add(camera_, T_cam_world * points_[i], pixels_[i].cast<double>(),
                   noise_ * inverse_sigma_[i]);
  }
  noise_ = kMomentum * noise_ + (1.0 - kMomentum) * residuals_.noise_to_weigh_by();
  factors::PoseOptimizerOptions scaled = options_;
  scaled.chi2_mono /= noise_ * noise_;
  scaled.chi2_depth /= noise_ * noise_;
  optimizer_.set_options(scaled);
}

}  // namespace dynslam::slam
