// Which features and which pixels move? A box is carried through a room while the camera turns.
//
// Everything is made up here and exact, so that the answers can be checked against the truth.
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <map>
#include <vector>

#include "dynslam/geometry/depth_consistency.hpp"
#include "dynslam/geometry/region_grow.hpp"
#include "dynslam/geometry/robust_pose.hpp"
#include "dynslam/geometry/weighted_constraint.hpp"

namespace {

using dynslam::RigidTransform;

const dynslam::PinholeCamera kCamera{525.0, 525.0, 319.5, 239.5, 640, 480};

struct Frame {
  RigidTransform T_cam_world;
  Eigen::Vector3d box;  // centre of the carried box's front, 0.6 x 0.5 m, world frame
  std::vector<float> depth;
  std::vector<std::uint8_t> truth;
};

Eigen::Vector3d ray(const RigidTransform& T_world_cam, int x, int y) {
  return T_world_cam.R * kCamera.bearing({static_cast<double>(x), static_cast<double>(y)});
}

// A back wall at z = 3 m, a floor at y = 1 m and the box's front facing the camera.
Frame render(const RigidTransform& T_cam_world, const Eigen::Vector3d& box) {
  Frame frame{T_cam_world, box, std::vector<float>(640 * 480),
              std::vector<std::uint8_t>(640 * 480)};
  const RigidTransform T_world_cam = T_cam_world.inverse();
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      const Eigen::Vector3d d = ray(T_world_cam, x, y), o = T_world_cam.t;
      double z = (3.0 - o.z()) / d.z();
      if (d.y() > 0.0) z = std::min(z, (1.0 - o.y()) / d.y());
      const double at_box = (box.z() - o.z()) / d.z();
      const Eigen::Vector3d hit = o + at_box * d - box;
      const std::size_t i = static_cast<std::size_t>(y * 640 + x);
      if (at_box < z && std::abs(hit.x()) < 0.3 && std::abs(hit.y()) < 0.25) {
        z = at_box;
        frame.truth[i] = 255;
      }
      frame.depth[i] = static_cast<float>(z);
    }
  }
  return frame;
}

// Points every 8 pixels of the reference, and where each is seen now.
struct Features {
  std::vector<Eigen::Vector2f> then, now;
  std::vector<float> z_then, z_now;
  std::vector<dynslam::Match> matches;
  std::vector<Eigen::Vector3d> world;  // as the map has them
  std::vector<bool> moves;
};

Features track(const Frame& reference, const Frame& current) {
  Features f;
  for (int y = 4; y < 480; y += 8) {
    for (int x = 4; x < 640; x += 8) {
      const std::size_t i = static_cast<std::size_t>(y * 640 + x);
      const Eigen::Vector3d then =
          kCamera.unproject({static_cast<double>(x), static_cast<double>(y)}, reference.depth[i]);
      const Eigen::Vector3d world = reference.T_cam_world.inverse() * then;
      const bool moves = reference.truth[i] != 0;
      const Eigen::Vector3d moved =
          moves ? Eigen::Vector3d(world + current.box - reference.box) : world;
      const Eigen::Vector3d now = current.T_cam_world * moved;
      const auto p = kCamera.project_into_image(now);
      if (!p) continue;
      const int index = static_cast<int>(f.now.size());
      f.then.emplace_back(static_cast<float>(x), static_cast<float>(y));
      f.now.push_back(p->cast<float>());
      f.z_then.push_back(static_cast<float>(then.z()));
      f.z_now.push_back(static_cast<float>(now.z()));
      f.matches.push_back({index, index, 0.0F});
      f.world.push_back(world);
      f.moves.push_back(moves);
    }
  }
  return f;
}

}  // namespace

int main() {
  namespace geometry = dynslam::geometry;
  const Frame before = render({}, {-0.5, 0.2, 1.8});
  const Frame now = render({dynslam::so3_exp({0.0, 0.08, 0.0}), {0.15, 0.0, 0.0}}, {0.3, 0.2, 1.7});
  const Features f = track(before, now);

  // 1. The camera's motion, although a good part of the points moves with the box.
  geometry::PoseProblem problem;
  problem.world = f.world;
  problem.pixels = f.now;
  problem.depths = f.z_now;
  geometry::RobustPoseResult pose;
  geometry::RobustPoseWorkspace pose_workspace;
  geometry::estimate_pose(kCamera, problem, nullptr, {}, {}, pose_workspace, pose);
  std::printf("motions found: %zu\n", pose.hypotheses.size());
  for (const geometry::PoseHypothesis& h : pose.hypotheses) {
    std::printf("  %4d points, extent %.2f, score %.2f%s\n", h.inliers, h.extent, h.score,
                h.T_cam_world.t == pose.T_cam_world.t ? "  <- background" : "");
  }
  std::printf("error of the pose: %.4f mm\n",
              1000.0 * (pose.T_cam_world.t - now.T_cam_world.t).norm());
  const RigidTransform T_cur_ref = pose.T_cam_world * before.T_cam_world.inverse();

  // 2. The weighted geometric constraint on the matched features.
  geometry::FeaturesView current, reference;
  current.pixels = f.now;
  current.depths = f.z_now;
  reference.pixels = f.then;
  reference.depths = f.z_then;
  geometry::ReferenceView view{T_cur_ref, reference, f.matches, nullptr};
  std::vector<geometry::FeatureVerdict> verdicts(f.now.size());
  geometry::WeightedConstraintWorkspace workspace;
  geometry::judge_features(kCamera, current, {&view, 1}, {}, workspace, verdicts);
  std::map<geometry::Reason, int> reasons;
  int found = 0, wrong = 0;
  for (std::size_t i = 0; i < verdicts.size(); ++i) {
    ++reasons[verdicts[i].reason];
    if (verdicts[i].verdict != geometry::Verdict::kDynamic) continue;
    f.moves[i] ? ++found : ++wrong;
  }
  const auto moving = std::count(f.moves.begin(), f.moves.end(), true);
  std::printf("features: %d of %d movers found, %d static ones accused\n", found,
              static_cast<int>(moving), wrong);
  for (const auto& [reason, count] : reasons) {
    std::printf("  %-20s %d\n", geometry::to_string(reason), count);
  }

  // 3. The dense test, which needs no matches, and the mask.
  geometry::DepthCells cells;  // a keyframe keeps these
  geometry::build_depth_cells({before.depth.data(), 640, 480}, kCamera, {}, cells);
  const geometry::DepthReference depth_reference{T_cur_ref, &cells, 1.0};
  geometry::DepthEvidence evidence;
  geometry::judge_depth({now.depth.data(), 640, 480}, kCamera, {&depth_reference, 1}, {}, evidence);
  std::vector<std::uint8_t> mask(640 * 480);
  geometry::RegionGrowWorkspace grow;
  const double share =
      geometry::grow_regions({now.depth.data(), 640, 480}, evidence, current.pixels, verdicts, {},
                             grow, {mask.data(), 640, 480});
  std::size_t both = 0, either = 0;
  for (std::size_t i = 0; i < mask.size(); ++i) {
    both += (mask[i] & now.truth[i]) != 0 ? 1 : 0;
    either += (mask[i] | now.truth[i]) != 0 ? 1 : 0;
  }
  std::printf("mask: %.1f %% of the image, intersection over union with the truth %.3f\n",
              100.0 * share, static_cast<double>(both) / static_cast<double>(either));
}
