#include "point_looks.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "dynslam/core/opencv.hpp"
#include "dynslam/features/orb.hpp"
#include "dynslam/features/patch_alignment.hpp"

#include "surface_normal.hpp"

namespace dynslam::slam {
namespace {

// Between the lines of sight: beyond it what is not flat looks another way. (fr3_cabinet, 1.5 Hz,
// has 0.022 m with it, 0.039 without.)
constexpr double kMinCosine = 0.97;
constexpr double kGrazing = 0.15;       // cosine between line of sight and normal, nothing is seen
constexpr float kSurfaceRadius = 5.0F;  // pixels of the level about a feature that are its surface
constexpr float kMostBeside = 3.0F;     // pixels of the level, of a corner beside the right place
constexpr float kSameDepth = 0.05F;     // share that depths of one surface may differ

Eigen::Vector2f on_level(cv::Point2f pixel, float scale) {
  return {features::to_level(pixel.x, scale), features::to_level(pixel.y, scale)};
}

// Whether what is seen at a pixel is believed to stand still; without an opinion all is.
bool is_trusted(const cv::Mat& cell_trust, cv::Point pixel) {
  if (cell_trust.empty()) return true;
  const int x = std::min(pixel.x / kSurfaceCell, cell_trust.cols - 1);
  const int y = std::min(pixel.y / kSurfaceCell, cell_trust.rows - 1);
  return cell_trust.at<float>(y, x) > 0.0F;
}

// How a step on the level of the frame looks on the look's, pixels of each; the surface faces the
// frame if nothing else is known. X is the point in the frame's camera.
std::optional<Eigen::Matrix2f> warp_to(const PointLook& look, const PinholeCamera& camera,
                                       const TrackedFrame& frame, const Eigen::Vector3d& X,
                                       float scale) {
  const Eigen::Vector3d P = look.R_cam_world * look.camera_point_world;
  if (!PinholeCamera::in_domain(P)) return std::nullopt;
  Eigen::Matrix<double, 2, 3> projection;                    // d pixel / d P
  projection << camera.fx, 0.0, -camera.fx * P.x() / P.z(),  //
      0.0, camera.fy, -camera.fy * P.y() / P.z();
  projection /= P.z();
  Eigen::Matrix<double, 3, 2> steps = Eigen::Matrix<double, 3, 2>::Identity();  // of X, a pixel
  const Eigen::Vector3d normal = frame.T_cam_world.R * look.normal_world;
  if (!normal.isZero()) {
    const double reach = normal.dot(X);
    if (std::abs(reach) < kGrazing * X.norm()) return std::nullopt;
    steps -= X * (normal.head<2>() / reach).transpose();  // along the ray, back onto the surface
  }
  steps.col(0) *= X.z() / camera.fx;
  steps.col(1) *= X.z() / camera.fy;
  const Eigen::Matrix3d R_look_cam = look.R_cam_world * frame.T_cam_world.R.transpose();
  const double between_levels = static_cast<double>(scale) / static_cast<double>(look.scale);
  return (between_levels * projection * R_look_cam * steps).cast<float>();
}

}  // namespace

std::shared_ptr<const PointLook> point_look(const PinholeCamera& camera, const TrackedFrame& frame,
                                            std::size_t feature, const Eigen::Vector3d& position,
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
  if (!frame.depth.empty()) {
    const auto normal = surface_normal(frame.depth, keypoint.pt, kSurfaceRadius * scale, camera);
    if (normal) look->normal_world = frame.T_cam_world.R.transpose() * *normal;
  }
  return look;
}

std::optional<LookFinder::Expected> LookFinder::expect(const MapPoint& point,
                                                       const TrackedFrame& frame,
                                                       std::size_t octave) const {
  if (point.look == nullptr) return std::nullopt;
  const Eigen::Vector3d X = frame.T_cam_world * point.position;
  if (!PinholeCamera::in_domain(X)) return std::nullopt;
  const Eigen::Vector3d ray = frame.T_cam_world.R.transpose() * X;
  const Eigen::Vector3d& usual = point.look->camera_point_world;
  if (ray.dot(usual) < kMinCosine * ray.norm() * usual.norm()) return std::nullopt;
  const float scale = scale_factors_[octave];
  const auto A = warp_to(*point.look, camera_, frame, X, scale);
  if (!A) return std::nullopt;
  const Eigen::Vector2f pixel = camera_.project(X).cast<float>();
  return Expected{*A, on_level({pixel.x(), pixel.y()}, scale)};
}

std::optional<LookFinder::Found> LookFinder::find_near(const PointLook& look,
                                                       const Expected& expected,
                                                       const Eigen::Vector2f& start,
                                                       const TrackedFrame& frame,
                                                       std::size_t octave) const {
  const features::PatchAlignment found =
      features::align_patch(look.patch, expected.A_look_level, frame.levels[octave], start);
  if (!found.ok()) return std::nullopt;
  const float scale = scale_factors_[octave];
  const cv::Point2f at(features::from_level(found.at.x(), scale),
                       features::from_level(found.at.y(), scale));
  return Found{at, found.sigma};
}

std::optional<LookFinder::Found> LookFinder::find(const MapPoint& point, const TrackedFrame& frame,
                                                  const cv::KeyPoint& keypoint) const {
  const auto octave = static_cast<std::size_t>(keypoint.octave);
  const auto expected = expect(point, frame, octave);
  if (!expected) return std::nullopt;
  const Eigen::Vector2f corner = on_level(keypoint.pt, scale_factors_[octave]);
  const auto at = find_near(*point.look, *expected, corner, frame, octave);
  // The corner of one image may be another one beside it in the next.
  if (at || (expected->at - corner).norm() > kMostBeside) return at;
  return find_near(*point.look, *expected, expected->at, frame, octave);
}

int LookFinder::align(const Map& map, const std::vector<PointMatch>& matches,
                      const std::vector<PointId>& ids, TrackedFrame& frame) const {
  if (frame.levels.empty()) return 0;
  std::vector<std::pair<std::uint32_t, Found>> found;
  for (const PointMatch& match : matches) {
    const MapPoint* point = map.find_point(ids[match.source]);
    if (point == nullptr) continue;
    const auto at = find(*point, frame, frame.features->keypoints[match.feature]);
    if (at) found.emplace_back(match.feature, *at);
  }
  if (found.empty()) return 0;
  auto features = std::make_shared<FrameFeatures>(*frame.features);
  features->alignment_sigmas.resize(features->size(), 0.0F);
  for (const auto& [feature, place] : found) {
    cv::Point2f& pixel = features->keypoints[feature].pt;
    features->right_columns[feature] += place.at.x - pixel.x;  // the disparity is the same
    pixel = place.at;
    features->alignment_sigmas[feature] = place.sigma;
  }
  frame.features = std::move(features);
  return static_cast<int>(found.size());
}

void LookFinder::add_feature(const MapPoint& point, const cv::KeyPoint& keypoint, float depth,
                             float sigma, FrameFeatures& features) const {
  features.keypoints.push_back(keypoint);
  features.descriptors.push_back(cv::Mat(point.descriptor).reshape(1, 1));
  features.depths.push_back(depth);
  features.right_columns.push_back(
      static_cast<float>(camera_.right_column(keypoint.pt.x, static_cast<double>(depth))));
  features.colors.push_back(point.color);
  features.alignment_sigmas.push_back(sigma);
  ++features.sought;
}

std::vector<PointMatch> LookFinder::seek(const Map& map, const std::vector<SoughtPoint>& points,
                                         std::size_t most, TrackedFrame& frame) const {
  std::vector<PointMatch> matches;
  if (frame.levels.empty() || frame.depth.empty()) return matches;
  auto features = std::make_shared<FrameFeatures>(*frame.features);
  features->descriptors = frame.features->descriptors.clone();
  features->alignment_sigmas.resize(features->size(), 0.0F);
  for (const SoughtPoint& sought : points) {
    if (matches.size() == most) break;
    const MapPoint* point = map.find_point(sought.id);
    if (point == nullptr) continue;
    const auto octave = static_cast<std::size_t>(sought.octave);
    const auto expected = expect(*point, frame, octave);
    if (!expected) continue;
    const auto found = find_near(*point->look, *expected, expected->at, frame, octave);
    if (!found) continue;
    const cv::Point pixel(cvRound(found->at.x), cvRound(found->at.y));
    const auto depth = frame.depth.at<float>(pixel);
    const auto expected_depth = static_cast<float>((frame.T_cam_world * point->position).z());
    if (!(std::abs(depth - expected_depth) <= kSameDepth * expected_depth)) continue;
    if (!is_trusted(frame.cell_trust, pixel)) continue;
    const cv::KeyPoint keypoint(found->at, features::kOrbPatchSize * scale_factors_[octave], -1.0F,
                                0.0F, sought.octave);
    matches.push_back(
        {sought.source, static_cast<std::uint32_t>(features->size()), point->position, 1.0F});
    add_feature(*point, keypoint, depth, found->sigma, *features);
  }
  if (matches.empty()) return matches;
  features->grid.build(field(features->keypoints, &cv::KeyPoint::pt), camera_.width,
                       camera_.height);
  frame.add_sought(std::move(features));
  return matches;
}

}  // namespace dynslam::slam
