#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "dynslam/core/errors.hpp"
#include "dynslam/loop/verification.hpp"

namespace dynslam::loop {
namespace {

void check_size(const char* parameter, ImageView<const float> depth, const PinholeCamera& camera) {
  require(!depth.empty() && depth.width == camera.width && depth.height == camera.height,
          "depth_agreement", parameter,
          std::to_string(depth.width) + " x " + std::to_string(depth.height),
          std::to_string(camera.width) + " x " + std::to_string(camera.height) +
              " pixels as the camera");
}

// Share of the first image's pixels that the second one confirms.
double agreement_from(ImageView<const float> query_depth, ImageView<const float> candidate_depth,
                      const PinholeCamera& query_camera, const PinholeCamera& candidate_camera,
                      const RigidTransform& T_candidate_query, const DepthCheckOptions& options) {
  std::size_t looked_at = 0, compared = 0, agreed = 0;
  for (int y = options.grid / 2; y < query_depth.height; y += options.grid) {
    for (int x = options.grid / 2; x < query_depth.width; x += options.grid) {
      ++looked_at;
      const double z = query_depth(x, y);
      if (!(z > 0.0) || !std::isfinite(z)) continue;
      const Eigen::Vector3d X =
          T_candidate_query * query_camera.unproject({double(x), double(y)}, z);
      const auto pixel = candidate_camera.project_into_image(X);
      if (!pixel) continue;
      const double there = candidate_depth(static_cast<int>(std::lround(pixel->x())),
                                           static_cast<int>(std::lround(pixel->y())));
      if (!(there > 0.0) || !std::isfinite(there)) continue;
      ++compared;
      if (std::abs(there - X.z()) <= options.absolute + options.relative * X.z()) ++agreed;
    }
  }
  if (compared == 0 ||
      static_cast<double>(compared) < options.min_overlap * static_cast<double>(looked_at))
    return std::numeric_limits<double>::quiet_NaN();
  return static_cast<double>(agreed) / static_cast<double>(compared);
}

}  // namespace

void DepthCheckOptions::validate() const {
  constexpr const char* kName = "DepthCheckOptions";
  const auto is_share = [](double x) { return x >= 0.0 && x <= 1.0; };
  require(is_share(min_agreement), kName, "min_agreement", min_agreement, "a share in [0, 1]");
  require(is_share(min_overlap), kName, "min_overlap", min_overlap, "a share in [0, 1]");
  require(grid >= 1, kName, "grid", grid, "at least 1 pixel");
  require(std::isfinite(absolute) && absolute >= 0.0, kName, "absolute", absolute,
          "a number of metres >= 0");
  require(std::isfinite(relative) && relative >= 0.0 && absolute + relative > 0.0, kName,
          "relative", relative, "a share >= 0, above 0 where absolute is 0");
}

double depth_agreement(ImageView<const float> query_depth, ImageView<const float> candidate_depth,
                       const PinholeCamera& query_camera, const PinholeCamera& candidate_camera,
                       const RigidTransform& T_candidate_query, const DepthCheckOptions& options) {
  options.validate();
  query_camera.validate();
  candidate_camera.validate();
  check_size("query_depth", query_depth, query_camera);
  check_size("candidate_depth", candidate_depth, candidate_camera);
  const double there = agreement_from(query_depth, candidate_depth, query_camera, candidate_camera,
                                      T_candidate_query, options);
  const double back = agreement_from(candidate_depth, query_depth, candidate_camera, query_camera,
                                     T_candidate_query.inverse(), options);
  return std::isnan(there) || std::isnan(back) ? std::numeric_limits<double>::quiet_NaN()
                                               : std::min(there, back);
}

void check_depth(ImageView<const float> query_depth, ImageView<const float> candidate_depth,
                 const PinholeCamera& query_camera, const PinholeCamera& candidate_camera,
                 Verification& verification, const DepthCheckOptions& options) {
  const double agreement =
      depth_agreement(query_depth, candidate_depth, query_camera, candidate_camera,
                      verification.T_candidate_query, options);
  if (verification.verdict == Verdict::kVerified && agreement < options.min_agreement)
    verification.verdict = Verdict::kOtherScene;
}

}  // namespace dynslam::loop
