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
    : camera_(camera),
      scale_factors_(scale_factors),
      options_(optimizer_options(weights)),
      optimizer_(options_) {}

factors::PoseResult PoseEstimation::solve(const std::vector<PointMatch>& matches,
                                          const FrameFeatures& features,
                                          const RigidTransform& initial,
                                          const factors::PosePrior* prior) {
  points_.clear();
  pixels_.clear();
  right_columns_.clear();
  inverse_sigma_.clear();
  right_inverse_sigma_.clear();
  weights_.clear();
  alignment_sigmas_.clear();
  for (const PointMatch& match : matches) {
    const cv::KeyPoint& keypoint = features.keypoints[match.feature];
    points_.push_back(match.position);
    pixels_.emplace_back(keypoint.pt.x, keypoint.pt.y);
    right_columns_.push_back(features.right_columns[match.feature]);
    alignment_sigmas_.push_back(features.alignment_sigma(match.feature));
    const double scale = scale_factors_[static_cast<std::size_t>(keypoint.octave)] *
                         noise_.relative(alignment_sigmas_.back());
    inverse_sigma_.push_back(static_cast<float>(1.0 / (noise_.pixels * scale)));
    right_inverse_sigma_.push_back(static_cast<float>(noise_.right_inverse_sigma(scale)));
    weights_.push_back(match.weight);
  }
  const factors::PoseObservations<float> observations = {as_points<double>(points_),
                                                         as_points<float>(pixels_),
                                                         right_columns_,
                                                         inverse_sigma_,
                                                         weights_,
                                                         right_inverse_sigma_};
  return optimizer_.optimize(camera_, observations, initial, prior);
}

void PoseEstimation::learn_noise(const RigidTransform& T_cam_world) {
  residuals_.clear();
  for (std::size_t i = 0; i < points_.size(); ++i) {
    if (inliers()[i] == 0) continue;
    residuals_.add(camera_, T_cam_world * points_[i], pixels_[i].cast<double>(), right_columns_[i],
                   noise_.pixels * noise_.relative(alignment_sigmas_[i]) * inverse_sigma_[i],
                   alignment_sigmas_[i]);
  }
  noise_ = noise_.blended(residuals_.to_weigh_by(), kMomentum);
  factors::PoseOptimizerOptions scaled = options_;
  scaled.chi2_mono /= noise_.pixels * noise_.pixels;
  scaled.chi2_depth /= noise_.pixels * noise_.pixels;
  optimizer_.set_options(scaled);
}

}  // namespace dynslam::slam
