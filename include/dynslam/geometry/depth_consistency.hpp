// Dense mover test that needs no feature match: free space that a reference saw and that is filled
// now.
#pragma once

#include <cstdint>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/image_view.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/geometry/depth_cells.hpp"
#include "dynslam/geometry/detail/sight.hpp"
#include "dynslam/geometry/verdict.hpp"
#include "dynslam/geometry/views.hpp"

namespace dynslam::geometry {

/// A reference's depth and where it was taken.
struct DepthReference {
  RigidTransform T_cur_ref;           ///< reference camera to current camera
  const DepthCells* cells = nullptr;  ///< null or empty: skipped
  double age = 1.0;  ///< seconds since, >= 0: a mover has not left its place yet in young ones,
                     ///< whose static votes count less (`settle_time`)
};

struct DepthConsistencyOptions {
  int stride = 4;                ///< pixels between tested pixels, 1..64; engineering
  DepthNoise depth_noise;        ///< of both measurements
  PoseNoise pose_noise;          ///< of T_cur_ref
  double threshold = 4.0;        ///< standard deviations, > 0; engineering
  double depth_floor = 0.03;     ///< metres, >= 0, added to the threshold; engineering
  double relative_floor = 0.01;  ///< share of depth, >= 0, added likewise; engineering
  double min_range = 0.8;        ///< metres, >= 0: a reference measures nothing nearer and cannot
                                 ///< be said to have looked through it; Kinect: 0.8
  double max_spread = 0.15;      ///< share of depth, > 0: a reference's cell whose depths differ by
                                 ///< more is an edge and gives no static vote; engineering
  double dynamic_evidence = 2.0;  ///< log-odds that one violated reference adds, > 0; engineering
  double static_evidence = 0.7;   ///< log-odds that one consistent reference takes away, > 0
  double settle_time = 1.0;       ///< seconds, > 0: references younger than this give static votes
                                  ///< in proportion to their age; engineering (walking people)
  double decision = 0.6;          ///< |log-odds| below which a cell is unknown, >= 0

  void validate() const;
};

/// What the references say about a grid of pixels (stride * x + stride / 2, same for y).
struct DepthEvidence {
  int stride = 0;
  double focal = 0.0;           ///< pixels, the camera's fx
  int width = 0;                ///< cells
  int height = 0;               ///< cells
  std::vector<float> depth;     ///< metres, 0 = none or unreliable (flying pixel)
  std::vector<float> log_odds;  ///< log p(dynamic)/p(static); 0 = no idea
  std::vector<Verdict> verdict;
  int static_cells = 0;
  int dynamic_cells = 0;
  int unknown_cells = 0;  ///< with depth but without verdict

  ImageView<const float> depth_view() const { return {depth.data(), width, height}; }
  ImageView<const float> log_odds_view() const { return {log_odds.data(), width, height}; }
  /// Share of judged cells that are static: how well a pose explains the scene; 0 if none judged.
  double static_share() const {
    const int judged = static_cells + dynamic_cells;
    return judged > 0 ? static_cast<double>(static_cells) / judged : 0.0;
  }
};

/// Judges a point seen now (current camera coordinates, metres).
///
/// With P = the point in a reference, [near, far] the depths the reference saw around P's pixel and
/// m the margin (noise of both depths, pose noise, floors):
///
///     P_z < near - m            the reference looked through P: a surface arrived -> dynamic
///     near - m <= P_z <= far + m    the reference saw it (unless far - near is an edge) -> static
///     P_z > far + m             hidden in the reference -> no vote (what is revealed is static)
///     no depth, outside         -> no vote
///
/// Votes add up as log-odds. O(references), no allocation, thread-safe.
FeatureVerdict judge_point(const Eigen::Vector3d& X_cur, Span<const DepthReference> references,
                           const DepthConsistencyOptions& options);

/// `judge_point` for a grid over the current depth image (metres; <= 0, NaN = none).
///
/// Pixels whose four neighbours at half a stride do not support their depth (flying pixels) are
/// left out. Throws InvalidArgument if the image has not the camera's size or options are invalid;
/// a pose that is not finite makes its reference skipped. O(cells x references): about 0.5 ms for
/// 160 x 120 cells and 5 references; no allocation after warm-up of `out`.
/// Source: free-space violation as in occupancy mapping (and ReFusion, Palazzolo et al., IROS
/// 2019); the log-odds and edge rules are ours.
void judge_depth(ImageView<const float> depth, const PinholeCamera& camera,
                 Span<const DepthReference> references, const DepthConsistencyOptions& options,
                 DepthEvidence& out);

/// `judge_point` for features with depth; features without are kUnknown, kNoDepth.
void judge_features(const PinholeCamera& camera, const FeaturesView& current,
                    Span<const DepthReference> references, const DepthConsistencyOptions& options,
                    Span<FeatureVerdict> out);

}  // namespace dynslam::geometry

#include "dynslam/geometry/detail/depth_consistency_impl.hpp"
