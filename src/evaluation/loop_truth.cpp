#include "dynslam/evaluation/loop_truth.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "dynslam/core/errors.hpp"

namespace dynslam::evaluation {
namespace {

// Points of an image in its camera, one for each grid pixel with depth.
std::vector<Eigen::Vector3d> points_of(const PlaceView& view, const PinholeCamera& camera,
                                       int grid) {
  std::vector<Eigen::Vector3d> points;
  if (view.depth.empty()) return points;
  for (int y = grid / 2; y < view.depth.height; y += grid) {
    for (int x = grid / 2; x < view.depth.width; x += grid) {
      const double z = view.depth(x, y);
      if (std::isfinite(z) && z > 0.0) points.push_back(camera.unproject({x, y}, z));
    }
  }
  return points;
}

// Share of the points, given in the camera of `from`, that `to` sees.
double seen_share(const std::vector<Eigen::Vector3d>& points, const PlaceView& from,
                  const PlaceView& to, const PinholeCamera& camera, double occlusion) {
  if (points.empty() || to.depth.empty()) return 0.0;
  const RigidTransform T = to.T_world_cam.inverse() * from.T_world_cam;
  std::size_t seen = 0;
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3d X = T * point;
    const auto pixel = camera.project_into_image(X);
    if (!pixel) continue;
    const double measured = to.depth(static_cast<int>(std::lround(pixel->x())),
                                     static_cast<int>(std::lround(pixel->y())));
    constexpr double kTolerance = 0.05;  // metres
    if (measured > 0.0 && measured < (1.0 - occlusion) * X.z() - kTolerance) continue;
    ++seen;
  }
  return static_cast<double>(seen) / static_cast<double>(points.size());
}

}  // namespace

void LoopTruthOptions::validate() const {
  require(same > 0.0 && same <= 1.0, "LoopTruthOptions", "same", same, "a share in (0, 1]");
  require(different > 0.0 && different <= same, "LoopTruthOptions", "different", different,
          "a share in (0, same]");
  require(grid >= 1, "LoopTruthOptions", "grid", grid, "at least 1 pixel");
  require(occlusion > 0.0 && std::isfinite(occlusion), "LoopTruthOptions", "occlusion", occlusion,
          "a positive number");
}

LoopTruth::LoopTruth(Span<const PlaceView> views, const PinholeCamera& camera,
                     const LoopTruthOptions& options)
    : n_(views.size()), options_(options), overlap_(n_ * n_, 1.0F) {
  options.validate();
  camera.validate();
  std::vector<std::vector<Eigen::Vector3d>> points;
  for (const PlaceView& view : views) {
    require(view.depth.empty() ||
                (view.depth.width == camera.width && view.depth.height == camera.height),
            "LoopTruth", "depth",
            std::to_string(view.depth.width) + " x " + std::to_string(view.depth.height),
            std::to_string(camera.width) + " x " + std::to_string(camera.height) +
                " pixels as the camera");
    points.push_back(points_of(view, camera, options.grid));
  }
  for (std::size_t q = 0; q < n_; ++q) {
    for (std::size_t r = 0; r < q; ++r) {
      const double share =
          std::min(seen_share(points[q], views[q], views[r], camera, options.occlusion),
                   seen_share(points[r], views[r], views[q], camera, options.occlusion));
      overlap_[q * n_ + r] = overlap_[r * n_ + q] = static_cast<float>(share);
    }
    std::size_t first = q;
    while (first > 0 && overlap(q, first - 1) >= options.different) --first;
    first_connected_.push_back(first);
  }
}

double LoopTruth::overlap(std::size_t q, std::size_t r) const {
  require(q < n_ && r < n_, "LoopTruth::overlap", "image", std::max(q, r),
          "an index below " + std::to_string(n_));
  return overlap_[q * n_ + r];
}

std::size_t LoopTruth::first_connected(std::size_t q) const {
  require(q < n_, "LoopTruth::first_connected", "image", q, "an index below " + std::to_string(n_));
  return first_connected_[q];
}

LoopScores LoopTruth::score(Span<const LoopDetection> detections) const {
  std::vector<std::uint8_t> truth(n_ * n_, 0);
  std::vector<std::uint8_t> is_loop(n_, 0);
  for (std::size_t q = 0; q < n_; ++q) {
    for (std::size_t r = 0; r < first_connected_[q]; ++r) {
      if (overlap(q, r) >= options_.same) is_loop[q] = 1;
    }
    for (std::size_t r = 0; is_loop[q] != 0 && r < first_connected_[q]; ++r)
      truth[q * n_ + r] = overlap(q, r) >= options_.different ? 255 : 0;
  }
  std::vector<LoopDetection> judged;
  for (const LoopDetection& detection : detections) {
    const auto q = static_cast<std::size_t>(detection.query);
    const auto r = static_cast<std::size_t>(detection.match);
    const bool inside = detection.query >= 0 && q < n_ && detection.match >= 0 && r < n_;
    if (inside && truth[q * n_ + r] == 0 && overlap(q, r) >= options_.different) continue;
    judged.push_back(detection);
  }
  const int side = static_cast<int>(n_);
  return score_loops({truth.data(), side, side}, judged);
}

}  // namespace dynslam::evaluation
