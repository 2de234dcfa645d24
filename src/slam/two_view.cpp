#include "dynslam/slam/two_view.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include <Eigen/LU>
#include <Eigen/SVD>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/core/eigen.hpp>

#include "dynslam/core/errors.hpp"

#include "median.hpp"
#include "motion_valleys.hpp"
#include "two_view_motion.hpp"

namespace dynslam::slam {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr std::size_t kValleys = 4;  // motions beside those of the two models
constexpr double kConfidence = 0.9999;

struct Model {
  Matrix3d matrix = Matrix3d::Zero();
  double score = 0.0;
  bool found = false;
};

// Truncated score of a squared error: nothing beyond `bound`.
double credit(double squared, double bound) { return squared < bound ? kChi2Pixel - squared : 0.0; }

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
  std::vector<RigidTransform> motions_of(const Model& model, bool plane) const;
  TwoViewStatus choose(const std::vector<RigidTransform>& candidates, TwoViewMotion& best) const;
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
  const cv::Mat H =
      cv::findHomography(first_, second_, cv::noArray(), ransac(std::sqrt(kChi2Pixel)));
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
    const double there = squared_line_distance(F, m.first, m.second);
    const double back = squared_line_distance(F.transpose(), m.second, m.first);
    model.score += credit(there / (m.second_scale * m.second_scale), kChi2Line) +
                   credit(back / (m.first_scale * m.first_scale), kChi2Line);
  }
  return model;
}

std::vector<RigidTransform> TwoViewProblem::motions_of(const Model& model, bool plane) const {
  std::vector<RigidTransform> motions;
  if (!model.found) return motions;
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

// Of a homography: the rotation nearest to it, which is off by what parallax makes of a turn.
Matrix3d rotation_of(const Matrix3d& H, const Matrix3d& K) {
  const Eigen::JacobiSVD<Matrix3d> svd(K.inverse() * H * K,
                                       Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Matrix3d R = svd.matrixU() * svd.matrixV().transpose();
  return R.determinant() < 0.0 ? Matrix3d(-R) : R;
}

// The candidates that are supported compete after refinement: only there can the likelihoods of two
// valleys be compared. A step that is smaller than another says explains the matches, too, if it is
// as likely, however few of its points have parallax.
TwoViewStatus TwoViewProblem::choose(const std::vector<RigidTransform>& candidates,
                                     TwoViewMotion& best) const {
  std::vector<TwoViewMotion> motions;
  std::size_t most = 0;
  double likeliest = 0.0;
  for (const RigidTransform& candidate : candidates) {
    motions.push_back(judge_motion(camera_, matches_, candidate, options_));
    most = std::max(most, motions.back().good);
    likeliest = std::max(likeliest, motions.back().likelihood);
  }
  if (most < static_cast<std::size_t>(options_.min_points)) {
    return TwoViewStatus::kTooLittleParallax;
  }
  std::vector<TwoViewMotion> refined;
  for (const TwoViewMotion& motion : motions) {
    const bool likely = motion.likelihood >= likeliest - options_.min_likelihood_gap;
    if (motion.good < most / 2 && !likely) continue;
    refined.push_back(refine_motion(camera_, matches_, motion, options_));
    if (refined.back().likelihood < motion.likelihood) refined.back() = motion;
  }
  std::stable_sort(
      refined.begin(), refined.end(),
      [](const TwoViewMotion& a, const TwoViewMotion& b) { return a.likelihood > b.likelihood; });
  best = refined.front();
  for (std::size_t i = 1; i < refined.size(); ++i) {
    if (same_valley(refined[i].T_second_first, best.T_second_first)) continue;
    if (best.likelihood - refined[i].likelihood < options_.min_likelihood_gap) {
      return TwoViewStatus::kAmbiguous;
    }
  }
  return TwoViewStatus::kOk;
}

void set_median_depth(TwoViewReconstruction& result) {
  std::vector<double> depths;
  for (std::size_t i = 0; i < result.good.size(); ++i) {
    if (result.good[i] != 0) depths.push_back(result.points[i].z());
  }
  const double scale = 1.0 / median(depths);
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
  // All compete whichever model wins: near a plane two explain the matches about as well, over a
  // small step many, and a random sample may have found a wrong one only.
  std::vector<RigidTransform> candidates = motions_of(models[0], false);
  for (const RigidTransform& motion : motions_of(models[1], true)) candidates.push_back(motion);
  if (models[1].found) {
    const Matrix3d R = rotation_of(models[1].matrix, K_);
    for (const RigidTransform& T : motion_valleys(camera_, matches_, R, kValleys)) {
      candidates.push_back(T);
      candidates.emplace_back(T.R, -T.t);
    }
  }
  TwoViewMotion motion;
  result.status = choose(candidates, motion);
  if (!result.ok()) return;
  result.status = TwoViewStatus::kNoModel;
  const auto decided = static_cast<double>(motion.good + motion.contrary);
  if (static_cast<double>(motion.good) < options_.min_front_share * decided) return;
  result.status = TwoViewStatus::kTooLittleParallax;
  if (motion.wide < min_points) return;
  const auto explained = static_cast<double>(motion.explained);
  if (static_cast<double>(motion.good) < options_.min_point_share * explained) return;
  result.direction_deg = direction_uncertainty_deg(camera_, matches_, motion);
  if (result.direction_deg > options_.max_direction_deg) return;
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
  require(min_likelihood_gap >= 0.0, kName, "min_likelihood_gap", min_likelihood_gap,
          "a number of at least 0");
  require(max_direction_deg > 0.0, kName, "max_direction_deg", max_direction_deg,
          "a positive angle in degrees");
  share("min_front_share", min_front_share);
  share("min_point_share", min_point_share);
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
