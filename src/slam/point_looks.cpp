#include "point_looks.hpp"

#include <cstdint>
#include <utility>

#include "dynslam/features/orb.hpp"
#include "dynslam/features/patch_alignment.hpp"

namespace dynslam::slam {
namespace {

// Between the lines of sight: beyond it what is not flat looks another way. (fr3_cabinet, 1.5 Hz,
// has 0.022 m with it, 0.039 without.)
constexpr double kMinCosine = 0.97;

Eigen::Vector2f on_level(cv::Point2f pixel, float scale) {
  return {features::to_level(pixel.x, scale), features::to_level(pixel.y, scale)};
}

/// How a step on the level of the frame looks on the look's, if the surface faces the frame: pixels
/// of each. Nothing if the point is not in front of the look's camera.
std::optional<Eigen::Matrix2f> warp_to(const PointLook& look, const PinholeCamera& camera,
                                       const RigidTransform& T_cam_world, double depth,
                                       float scale) {
  const Eigen::Vector3d X = look.R_cam_world * look.camera_point_world;
  if (!PinholeCamera::in_domain(X)) return std::nullopt;
  Eigen::Matrix<double, 2, 3> projection;                    // d pixel / d X
  projection << camera.fx, 0.0, -camera.fx * X.x() / X.z(),  //
      0.0, camera.fy, -camera.fy * X.y() / X.z();
  projection /= X.z();
  const Eigen::Matrix3d R_look_cam = look.R_cam_world * T_cam_world.R.transpose();
  Eigen::Matrix<double, 3, 2> steps = R_look_cam.leftCols<2>();  // metres in the frame's camera
  steps.col(0) *= depth / camera.fx;
  steps.col(1) *= depth / camera.fy;
  const double between_levels = static_cast<double>(scale) / static_cast<double>(look.scale);
  return (between_levels * projection * steps).cast<float>();
}

}  // namespace

std::shared_ptr<const PointLook> point_look(const TrackedFrame& frame, std::size_t feature,
                                            const Eigen::Vector3d& position,
                                            const std::vector<float>& scale_factors) {
  if (frame.levels.empty()) return nullptr;
  const cv::KeyPoint& keypoint = frame.features->keypoints[feature];
  const auto octave = static_cast<std::size_t>(keypoint.octave);
  const float scale = scale_factors[octave];
  auto patch = features::cut_patch(frame.levels[octave], on_level(keypoint.pt, scale));
  if (!patch) return nullptr;
  auto look = std::make_shared<PointLook>();
  look->patch = *patch;
  look->scale = scale;
  look->R_cam_world = frame.T_cam_world.R;
  look->camera_point_world = position - frame.T_cam_world.inverse().t;
  return look;
}

std::optional<cv::Point2f> KeypointAligner::find(const MapPoint& point, const TrackedFrame& frame,
                                                 const cv::KeyPoint& keypoint) const {
  if (point.look == nullptr) return std::nullopt;
  const Eigen::Vector3d X = frame.T_cam_world * point.position;
  if (!PinholeCamera::in_domain(X)) return std::nullopt;
  const Eigen::Vector3d ray = frame.T_cam_world.R.transpose() * X;
  const Eigen::Vector3d& usual = point.look->camera_point_world;
  if (ray.dot(usual) < kMinCosine * ray.norm() * usual.norm()) return std::nullopt;
  const auto octave = static_cast<std::size_t>(keypoint.octave);
  const float scale = scale_factors_[octave];
  const auto A = warp_to(*point.look, camera_, frame.T_cam_world, X.z(), scale);
  if (!A) return std::nullopt;
  const features::PatchAlignment found = features::align_patch(
      point.look->patch, *A, frame.levels[octave], on_level(keypoint.pt, scale));
  if (!found.ok()) return std::nullopt;
  return cv::Point2f(features::from_level(found.at.x(), scale),
                     features::from_level(found.at.y(), scale));
}

int KeypointAligner::align(const Map& map, const std::vector<PointMatch>& matches,
                           const std::vector<PointId>& ids, TrackedFrame& frame) const {
  if (frame.levels.empty()) return 0;
  std::vector<std::pair<std::uint32_t, cv::Point2f>> found;
  for (const PointMatch& match : matches) {
    const MapPoint* point = map.find_point(ids[match.source]);
    if (point == nullptr) continue;
    const auto at = find(*point, frame, frame.features->keypoints[match.feature]);
    if (at) found.emplace_back(match.feature, *at);
  }
  if (found.empty()) return 0;
  auto features = std::make_shared<FrameFeatures>(*frame.features);
  for (const auto& [feature, at] : found) {
    cv::Point2f& pixel = features->keypoints[feature].pt;
    features->right_columns[feature] += at.x - pixel.x;  // the disparity is the same
    pixel = at;
  }
  frame.features = std::move(features);
  return static_cast<int>(found.size());
}

}  // namespace dynslam::slam
