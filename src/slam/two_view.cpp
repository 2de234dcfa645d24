#include "dynslam/slam/two_view.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include <Eigen/LU>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/core/eigen.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/factors/bundle_adjustment.hpp"
#include "dynslam/slam/triangulation.hpp"

namespace dynslam::slam {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kChi2Line = 3.841;   // 95 % of chi^2, 1 degree of freedom
constexpr double kChi2Pixel = 5.991;  // 2 degrees of freedom
constexpr double kSamePoseDeg = 1.5;  // motions nearer than this are one
constexpr double kConfidence = 0.9999;

struct PixelMatch {
  Vector2d first, second;
  double first_scale = 1.0, second_scale = 1.0;
  std::size_t column = 0;
};

struct Model {
  Matrix3d matrix = Matrix3d::Zero();
  double score = 0.0;
  bool found = false;
};

/// A motion and the points that speak for it.
struct Motion {
  RigidTransform T_second_first;
  std::vector<TriangulatedPoint> points;  // by match
  std::size_t good = 0;                   // with enough parallax, in front, small errors
  std::size_t contrary = 0;               // with enough parallax, but behind a camera
  std::size_t wide = 0;                   // good ones with min_parallax_deg
};

// Truncated score of a squared error: nothing beyond `bound`.
double credit(double squared, double bound) {
  return squared < bound ? kChi2Pixel - squared : 0.0;
}

double squared_line_distance(const Vector3d& line, const Vector2d& pixel) {
  const double d = line.dot(pixel.homogeneous());
  return d * d / line.head<2>().squaredNorm();
}

class TwoViewProblem {
 public:
  TwoViewProblem(const PinholeCamera& camera, const TwoViewOptions& options,
                 std::vector<PixelMatch> matches)
      : camera_(camera), options_(options), matches_(std::move(matches)) {
    K_ << camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0;
    for (const PixelMatch& match : matches_) {
      first_.emplace_back(match.first.x(), match.first.y());
      second_.emplace_back(match.second.x(), match.second.y());
    }
  }

  void solve(TwoViewReconstruction& result);

 private:
  Model homography() const;
  Model essential() const;
  bool is_explained(const Model& model, bool plane, const PixelMatch& match) const;
  std::vector<RigidTransform> motions_of(const Model& model, bool plane) const;
  Motion judge(const RigidTransform& T_second_first, const std::vector<std::uint8_t>& counted) const;
  TwoViewStatus choose(const std::vector<RigidTransform>& candidates,
                       const std::vector<std::uint8_t>& counted, Motion& best) const;
  bool adjust(Motion& motion) const;
  cv::UsacParams ransac(double threshold) const;

  PinholeCamera camera_;
  TwoViewOptions options_;
  std::vector<PixelMatch> matches_;
  std::vector<cv::Point2d> first_, second_;
  Matrix3d K_;
};

cv::UsacParams TwoViewProblem::ransac(double threshold) const {
  cv::UsacParams params;
  params.confidence = kConfidence;
  params.maxIterations = options_.max_iterations;
  params.threshold = threshold;
  params.loIterations = 10;
  return params;
}

Model TwoViewProblem::homography() const {
  Model model;
  const cv::Mat H = cv::findHomography(first_, second_, cv::noArray(), ransac(std::sqrt(kChi2Pixel)));
  if (H.empty()) return model;
  cv::cv2eigen(H, model.matrix);
  model.found = model.matrix.allFinite() && std::abs(model.matrix.determinant()) > 1e-12;
  if (!model.found) return model;
  const Matrix3d inverse = model.matrix.inverse();
  for (const PixelMatch& m : matches_) {
    const Vector2d there = (model.matrix * m.first.homogeneous()).hnormalized();
    const Vector2d back = (inverse * m.second.homogeneous()).hnormalized();
    model.score +=
        credit((m.second - there).squaredNorm() / (m.second_scale * m.second_scale), kChi2Pixel) +
        credit((m.first - back).squaredNorm() / (m.first_scale * m.first_scale), kChi2Pixel);
  }
  return model;
}

Model TwoViewProblem::essential() const {
  Model model;
  cv::Mat K;
  cv::eigen2cv(K_, K);
  const cv::Mat E = cv::findEssentialMat(first_, second_, K, K, cv::noArray(), cv::noArray(),
                                         cv::noArray(), ransac(std::sqrt(kChi2Line)));
  if (E.rows != 3 || E.cols != 3) return model;
  cv::cv2eigen(E, model.matrix);
  model.found = model.matrix.allFinite();
  if (!model.found) return model;
  const Matrix3d F = K_.inverse().transpose() * model.matrix * K_.inverse();
  for (const PixelMatch& m : matches_) {
    const double there = squared_line_distance(F * m.first.homogeneous(), m.second);
    const double back = squared_line_distance(F.transpose() * m.second.homogeneous(), m.first);
    model.score += credit(there / (m.second_scale * m.second_scale), kChi2Line) +
                   credit(back / (m.first_scale * m.first_scale), kChi2Line);
  }
  return model;
}

bool TwoViewProblem::is_explained(const Model& model, bool plane, const PixelMatch& m) const {
  if (plane) {
    const Vector2d there = (model.matrix * m.first.homogeneous()).hnormalized();
    return (m.second - there).squaredNorm() < kChi2Pixel * m.second_scale * m.second_scale;
  }
  const Matrix3d F = K_.inverse().transpose() * model.matrix * K_.inverse();
  return squared_line_distance(F * m.first.homogeneous(), m.second) <
         kChi2Line * m.second_scale * m.second_scale;
}

std::vector<RigidTransform> TwoViewProblem::motions_of(const Model& model, bool plane) const {
  std::vector<RigidTransform> motions;
  cv::Mat matrix, K;
  cv::eigen2cv(model.matrix, matrix);
  cv::eigen2cv(K_, K);
  const auto add = [&](const cv::Mat& R, const cv::Mat& t, double sign) {
    RigidTransform T;
    cv::cv2eigen(R, T.R);
    cv::cv2eigen(t, T.t);
    const double length = T.t.norm();
    if (!T.all_finite() || !(length > 1e-9)) return;  // a homography without translation
    T.t *= sign / length;
    motions.push_back(T);
  };
  if (plane) {
    std::vector<cv::Mat> rotations, translations, normals;
    cv::decomposeHomographyMat(matrix, K, rotations, translations, normals);
    for (std::size_t i = 0; i < rotations.size(); ++i) add(rotations[i], translations[i], 1.0);
  } else {
    cv::Mat R1, R2, t;
    cv::decomposeEssentialMat(matrix, R1, R2, t);
    for (const cv::Mat& R : {R1, R2}) {
      add(R, t, 1.0);
      add(R, t, -1.0);
    }
  }
  return motions;
}

Motion TwoViewProblem::judge(const RigidTransform& T_second_first,
                             const std::vector<std::uint8_t>& counted) const {
  Motion motion;
  motion.T_second_first = T_second_first;
  motion.points.resize(matches_.size());
  TriangulationOptions tests;
  tests.min_parallax_deg = options_.min_point_parallax_deg;
  for (std::size_t i = 0; i < matches_.size(); ++i) {
    if (counted[i] == 0) continue;
    const PixelMatch& m = matches_[i];
    motion.points[i] = triangulate(camera_, {RigidTransform(), m.first, m.first_scale},
                                   {T_second_first, m.second, m.second_scale}, tests);
    if (motion.points[i].ok()) {
      ++motion.good;
      if (motion.points[i].parallax_deg >= options_.min_parallax_deg) ++motion.wide;
    } else if (motion.points[i].status == TriangulationStatus::kBehindCamera) {
      ++motion.contrary;
    }
  }
  return motion;
}

bool is_same(const RigidTransform& a, const RigidTransform& b) {
  const double between = std::atan2(a.t.cross(b.t).norm(), a.t.dot(b.t));
  return std::max(rotation_angle(a.R, b.R), between) < kSamePoseDeg * 3.14159265358979 / 180.0;
}

TwoViewStatus TwoViewProblem::choose(const std::vector<RigidTransform>& candidates,
                                     const std::vector<std::uint8_t>& counted, Motion& best) const {
  std::vector<Motion> motions;
  for (const RigidTransform& candidate : candidates) motions.push_back(judge(candidate, counted));
  if (motions.empty()) return TwoViewStatus::kTooLittleParallax;
  std::stable_sort(motions.begin(), motions.end(),
                   [](const Motion& a, const Motion& b) { return a.good > b.good; });
  best = motions.front();
  const auto min_points = static_cast<std::size_t>(options_.min_points);
  if (best.good < min_points) return TwoViewStatus::kTooLittleParallax;
  for (std::size_t i = 1; i < motions.size(); ++i) {
    if (is_same(motions[i].T_second_first, best.T_second_first)) continue;
    const double share = static_cast<double>(motions[i].good) / static_cast<double>(best.good);
    if (share >= options_.max_rival_share) return TwoViewStatus::kAmbiguous;
  }
  return TwoViewStatus::kOk;
}

// Both views in a bundle, the first held. The scale is free, and set by the caller.
bool TwoViewProblem::adjust(Motion& motion) const {
  RigidTransform poses[] = {RigidTransform(), motion.T_second_first};
  const std::uint8_t held[] = {1, 0};
  std::vector<Vector3d> points;
  std::vector<factors::BundleObservation> observations;
  for (std::size_t i = 0; i < matches_.size(); ++i) {
    if (!motion.points[i].ok()) continue;
    factors::BundleObservation o;
    o.point = static_cast<std::uint32_t>(points.size());
    o.u = static_cast<float>(matches_[i].first.x());
    o.v = static_cast<float>(matches_[i].first.y());
    o.inverse_sigma = static_cast<float>(1.0 / matches_[i].first_scale);
    observations.push_back(o);
    o.keyframe = 1;
    o.u = static_cast<float>(matches_[i].second.x());
    o.v = static_cast<float>(matches_[i].second.y());
    o.inverse_sigma = static_cast<float>(1.0 / matches_[i].second_scale);
    observations.push_back(o);
    points.push_back(motion.points[i].position);
  }
  factors::BundleProblem problem;
  static_cast<PinholeCamera&>(problem.camera) = camera_;
  problem.T_cam_world = poses;
  problem.keyframe_fixed = held;
  problem.points_world = points;
  problem.observations = observations;
  factors::BundleOptions options;
  options.max_iterations = 20;
  if (!factors::usable(factors::optimize_bundle(problem, options).status)) return false;
  motion.T_second_first = poses[1];
  return motion.T_second_first.all_finite() && motion.T_second_first.t.norm() > 1e-9;
}

void set_median_depth(TwoViewReconstruction& result) {
  std::vector<double> depths;
  for (std::size_t i = 0; i < result.good.size(); ++i) {
    if (result.good[i] != 0) depths.push_back(result.points[i].z());
  }
  const auto middle = depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2);
  std::nth_element(depths.begin(), middle, depths.end());
  const double scale = 1.0 / *middle;
  result.T_second_first.t *= scale;
  for (Vector3d& point : result.points) point *= scale;
}

void TwoViewProblem::solve(TwoViewReconstruction& result) {
  const auto min_points = static_cast<std::size_t>(options_.min_points);
  if (matches_.size() < min_points) return;
  const Model models[] = {essential(), homography()};
  result.status = TwoViewStatus::kNoModel;
  const double sum = models[0].score + models[1].score;
  if (!(sum > 0.0)) return;
  result.homography_share = models[1].score / sum;
  const bool plane = !models[0].found || result.homography_share > options_.homography_share;
  result.model = plane ? TwoViewModel::kHomography : TwoViewModel::kEssential;
  const Model& model = models[plane ? 1 : 0];
  std::vector<std::uint8_t> counted;
  for (const PixelMatch& match : matches_) counted.push_back(is_explained(model, plane, match));
  if (static_cast<std::size_t>(std::count(counted.begin(), counted.end(), 1)) < min_points) return;

  Motion motion;
  result.status = choose(motions_of(model, plane), counted, motion);
  if (!result.ok()) return;
  result.status = TwoViewStatus::kNoModel;
  if (!adjust(motion)) return;
  // The refined motion may explain matches that the sampled one did not.
  motion = judge(motion.T_second_first, std::vector<std::uint8_t>(matches_.size(), 1));
  const auto in_front = static_cast<double>(motion.good);
  if (in_front < options_.min_front_share * static_cast<double>(motion.good + motion.contrary)) return;
  result.status = TwoViewStatus::kTooLittleParallax;
  if (motion.wide < min_points) return;
  result.status = TwoViewStatus::kOk;
  result.T_second_first = motion.T_second_first;
  result.count = motion.good;
  for (std::size_t i = 0; i < matches_.size(); ++i) {
    if (!motion.points[i].ok()) continue;
    result.good[matches_[i].column] = 1;
    result.points[matches_[i].column] = motion.points[i].position;
  }
  set_median_depth(result);
}

}  // namespace

const char* to_string(TwoViewModel model) {
  return model == TwoViewModel::kEssential ? "Essential" : "Homography";
}

const char* to_string(TwoViewStatus status) {
  switch (status) {
    case TwoViewStatus::kOk:
      return "Ok";
    case TwoViewStatus::kTooFewMatches:
      return "TooFewMatches";
    case TwoViewStatus::kNoModel:
      return "NoModel";
    case TwoViewStatus::kAmbiguous:
      return "Ambiguous";
    case TwoViewStatus::kTooLittleParallax:
      return "TooLittleParallax";
  }
  return "";
}

void TwoViewOptions::validate() const {
  constexpr const char* kName = "TwoViewOptions";
  const auto share = [&](const char* member, double value) {
    require(value > 0.0 && value <= 1.0, kName, member, value, "a share in (0, 1]");
  };
  require(min_points >= 8, kName, "min_points", min_points, "at least 8");
  require(min_parallax_deg > 0.0 && min_parallax_deg < 90.0, kName, "min_parallax_deg",
          min_parallax_deg, "an angle in (0, 90) degrees");
  require(min_point_parallax_deg > 0.0 && min_point_parallax_deg <= min_parallax_deg, kName,
          "min_point_parallax_deg", min_point_parallax_deg,
          "a positive angle of at most min_parallax_deg");
  require(homography_share > 0.0 && homography_share < 1.0, kName, "homography_share",
          homography_share, "a share in (0, 1)");
  share("max_rival_share", max_rival_share);
  share("min_front_share", min_front_share);
  require(max_iterations >= 1, kName, "max_iterations", max_iterations, "at least 1");
}

TwoViewReconstruction reconstruct_two_views(const PinholeCamera& camera, const Points2d& first,
                                            const Points2d& second, Span<const float> first_scales,
                                            Span<const float> second_scales,
                                            const TwoViewOptions& options) {
  constexpr const char* kName = "reconstruct_two_views";
  camera.validate();
  options.validate();
  const auto n = static_cast<std::size_t>(first.cols());
  const auto fits = [&](const char* name, std::size_t size, bool may_be_empty) {
    require(size == n || (may_be_empty && size == 0), kName, name, size,
            std::to_string(n) + " as in first");
  };
  fits("second", static_cast<std::size_t>(second.cols()), false);
  fits("first_scales", first_scales.size(), true);
  fits("second_scales", second_scales.size(), true);
  TwoViewReconstruction result;
  result.points.assign(n, Vector3d::Zero());
  result.good.assign(n, 0);
  std::vector<PixelMatch> matches;
  for (std::size_t i = 0; i < n; ++i) {
    const auto column = static_cast<Eigen::Index>(i);
    PixelMatch match;
    match.first = first.col(column);
    match.second = second.col(column);
    if (!first_scales.empty()) match.first_scale = first_scales[i];
    if (!second_scales.empty()) match.second_scale = second_scales[i];
    match.column = i;
    if (match.first.allFinite() && match.second.allFinite()) matches.push_back(match);
  }
  TwoViewProblem(camera, options, std::move(matches)).solve(result);
  return result;
}

}  // namespace dynslam::slam
