// RANSAC over motions; shared by the searches for poses and for similarities.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/loop/verification.hpp"

#include "ransac.hpp"

namespace dynslam::loop {

/// y = scale R x + t.
struct Motion {
  RigidTransform T;
  double scale = 1.0;

  Eigen::Vector3d operator*(const Eigen::Vector3d& x) const { return scale * (T.R * x) + T.t; }
  Motion inverse() const {
    Motion result;
    result.scale = 1.0 / scale;
    result.T.R = T.R.transpose();
    result.T.t = -result.scale * (result.T.R * T.t);
    return result;
  }
  bool usable() const { return T.all_finite() && std::isfinite(scale) && scale > 0.0; }
};

/// Motion that takes the columns of `from` to those of `to` with least squared error.
template <typename From, typename To>
Motion motion_between(const From& from, const To& to, bool with_scale) {
  const Eigen::Matrix4d m = Eigen::umeyama(from, to, with_scale);
  Motion motion;
  const Eigen::Matrix3d A = m.topLeftCorner<3, 3>();
  if (with_scale) motion.scale = std::cbrt(A.determinant());
  motion.T = {A / motion.scale, m.topRightCorner<3, 1>()};
  return motion;
}

/// Share of an image that a disc of this radius covers.
inline double disc_share(double radius, const PinholeCamera& camera) {
  constexpr double kPi = 3.14159265358979323846;
  const double share = kPi * radius * radius / (double(camera.width) * double(camera.height));
  return share < 1.0 ? share : 1.0;
}

/// The loop of RANSAC with local optimization. Derived has
///   double error(const Motion&, Index) const       pixels, kFar where there is none
///   void solve(array of K indices, offer) const    calls offer(motion) for each solution
///   Motion refine(Motion, inliers) const
template <typename Derived, std::size_t K>
class MotionSearch {
 public:
  using Index = Eigen::Index;
  static constexpr double kFar = std::numeric_limits<double>::infinity();

  MotionSearch(Index columns, const RansacOptions& options)
      : usable_(static_cast<std::size_t>(columns), 0), options_(options) {}

  void admit(Index i, bool usable) {
    usable_[static_cast<std::size_t>(i)] = usable ? 1 : 0;
    if (usable) pool_.push_back(i);
  }

  void run() {
    Random random(options_.seed);
    int needed = options_.max_iterations;
    for (int i = 0; i < needed && pool_.size() >= K; ++i) {
      const auto drawn = random.sample<K>(static_cast<std::uint32_t>(pool_.size()));
      std::array<Index, K> chosen;
      for (std::size_t k = 0; k < K; ++k) chosen[k] = pool_[drawn[k]];
      bool better = false;
      self().solve(chosen, [&](const Motion& motion) { better = offer(motion) || better; });
      if (better)
        needed =
            iterations_needed(best_inliers_.size(), pool_.size(), static_cast<int>(K), options_);
    }
  }

  const Motion& best() const { return best_; }
  const std::vector<std::uint8_t>& usable() const { return usable_; }
  std::vector<std::uint8_t> inlier_flags() const {
    std::vector<std::uint8_t> flags(usable_.size(), 0);
    for (const Index i : best_inliers_) flags[static_cast<std::size_t>(i)] = 1;
    return flags;
  }

 private:
  const Derived& self() const { return static_cast<const Derived&>(*this); }

  std::vector<Index> inliers_of(const Motion& motion) const {
    std::vector<Index> inliers;
    for (const Index i : pool_) {
      if (self().error(motion, i) <= options_.max_error) inliers.push_back(i);
    }
    return inliers;
  }

  bool offer(const Motion& motion) {
    if (!motion.usable()) return false;
    std::vector<Index> inliers = inliers_of(motion);
    if (inliers.size() <= best_inliers_.size()) return false;
    best_ = motion;
    best_inliers_ = std::move(inliers);
    for (int round = 0; round < 3 && best_inliers_.size() > K; ++round) {
      const Motion refined = self().refine(best_, best_inliers_);
      if (!refined.usable()) break;
      inliers = inliers_of(refined);
      if (inliers.size() < best_inliers_.size()) break;
      const bool same = inliers.size() == best_inliers_.size();
      best_ = refined;
      best_inliers_ = std::move(inliers);
      if (same) break;
    }
    return true;
  }

  std::vector<std::uint8_t> usable_;
  std::vector<Index> pool_;
  RansacOptions options_;
  Motion best_;
  std::vector<Index> best_inliers_;
};

/// Runs a search and says what came of it. `places` counts different places among flagged matches;
/// `inverted`: the search's motion goes from the candidate to the query.
template <typename Search, typename Places>
Verification conclude(Search& search, const Places& places, const NullModel& null,
                      const RansacOptions& options, bool inverted, MotionModel* model) {
  Verification result;
  result.matches = places(search.usable());
  if (model != nullptr) {
    *model = {};
    model->inliers.assign(search.usable().size(), 0);
  }
  if (result.matches < options.min_inliers) {
    result.verdict = Verdict::kFewMatches;
    return result;
  }
  search.run();
  const std::vector<std::uint8_t> inliers = search.inlier_flags();
  judge(result, result.matches, places(inliers), null, options);
  const Motion motion = inverted ? search.best().inverse() : search.best();
  result.T_candidate_query = motion.T;
  result.scale = motion.scale;
  if (model != nullptr) {
    model->T_candidate_query = motion.T;
    model->scale = motion.scale;
    model->inliers = inliers;
  }
  return result;
}

}  // namespace dynslam::loop
