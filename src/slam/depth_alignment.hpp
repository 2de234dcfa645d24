// Motion between two depth images: for frames in which features are too few or cannot be trusted.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"

namespace dynslam::slam {

constexpr int kSurfaceCell = 4;  ///< pixels a side

/// Points and normals of a depth image, one for each cell of 4 x 4 pixels.
struct SurfaceGrid {
  int width = 0;                         ///< cells
  int height = 0;                        ///< cells
  std::vector<Eigen::Vector3f> points;   ///< camera coordinates, metres; z = 0 where there is none
  std::vector<Eigen::Vector3f> normals;  ///< unit, towards the camera; zero where there is none
  cv::Mat trust;                         ///< weight of each cell, CV_32F; empty: 1
  cv::Mat gray;                          ///< mean brightness of the cells, CV_32F; may be empty

  bool empty() const { return points.empty(); }
  void clear() {
    width = height = 0;
    points.clear();
    normals.clear();
    trust.release();
  }
};

/// Builds the grid of a depth image (CV_32FC1 metres, 0 or NaN = none) and of the brightness of its
/// cells (CV_8UC1, width / 4 x height / 4; may be empty); all cells have trust 1. O(pixels / 4).
void build_surface_grid(const cv::Mat& depth, const cv::Mat& gray_cells,
                        const PinholeCamera& camera, SurfaceGrid& grid);

/// How surfaces are aligned.
struct AlignmentOptions {
  double first_gate = 0.30;     ///< metres between partners in the first round
  double last_gate = 0.05;      ///< and in the last; 0.30, 0.12 and 0.05 are to be had
  double max_rms = 0.02;        ///< metres that partners may be off in the end
  double min_overlap = 0.35;    ///< share of the points of `to` that must find a partner
  int step = 1;                 ///< every how many cells of `to` take part, in rows and columns
  bool use_brightness = false;  ///< compare the brightness of partners too, where both have it
  /// Certainty of the initial guess, which holds directions that the surfaces leave open. Without
  /// it an open direction is a failure.
  std::optional<Matrix6d> guess_information;
};

/// What align_surfaces found.
struct SurfaceAlignment {
  RigidTransform T_from_to;  ///< takes coordinates of `to`'s camera to those of `from`'s
  Matrix6d information = Matrix6d::Zero();  ///< of the left perturbation of T_from_to
  double overlap = 0.0;                     ///< share of the points of `to` that found a partner
  double rms = 0.0;                         ///< metres, distance to the partners' planes
};

/// Projective point-to-plane ICP from `initial`, with brightness if wanted. Nothing if the grids
/// overlap too little, disagree, or leave a direction of the motion undetermined (one plane, a
/// corridor).
///
/// Source: Rusinkiewicz and Levoy, "Efficient variants of the ICP algorithm", 3DIM 2001 (projective
/// association, point-to-plane); Steinbruecker, Sturm, Cremers, "Real-time visual odometry from
/// dense RGB-D images", ICCV workshops 2011 (brightness). O(cells x iterations), about 1 ms at step
/// 1; allocates nothing.
std::optional<SurfaceAlignment> align_surfaces(const SurfaceGrid& from, const SurfaceGrid& to,
                                               const PinholeCamera& camera,
                                               const RigidTransform& initial,
                                               const AlignmentOptions& options = {});

}  // namespace dynslam::slam
