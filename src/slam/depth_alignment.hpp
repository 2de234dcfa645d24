// Motion between two depth images, for frames in which features are too few.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/image_view.hpp"
#include "dynslam/core/rigid_transform.hpp"

namespace dynslam::slam {

/// Points and normals of a depth image, one for each cell of 4 x 4 pixels.
struct SurfaceGrid {
  int width = 0;                         ///< cells
  int height = 0;                        ///< cells
  std::vector<Eigen::Vector3f> points;   ///< camera coordinates, metres; z = 0 where there is none
  std::vector<Eigen::Vector3f> normals;  ///< unit, towards the camera; zero where there is none

  bool empty() const { return points.empty(); }
};

/// Builds the grid of a depth image (metres, 0 or NaN = none). O(pixels / 4).
void build_surface_grid(ImageView<const float> depth, const PinholeCamera& camera,
                        SurfaceGrid& grid);

/// What align_surfaces found.
struct SurfaceAlignment {
  RigidTransform T_from_to;  ///< takes coordinates of `to`'s camera to those of `from`'s
  Matrix6d information = Matrix6d::Zero();  ///< of the left perturbation of T_from_to
  double overlap = 0.0;                     ///< share of the points of `to` that found a partner
  double rms = 0.0;                         ///< metres, distance to the partners' planes
};

/// Projective point-to-plane ICP from `initial`. Nothing if the grids overlap too little, disagree,
/// or leave a direction of the motion undetermined (one plane, a corridor).
///
/// Source: Rusinkiewicz and Levoy, "Efficient variants of the ICP algorithm", 3DIM 2001 (projective
/// association, point-to-plane). O(cells x iterations), about 5 ms; allocates nothing.
std::optional<SurfaceAlignment> align_surfaces(const SurfaceGrid& from, const SurfaceGrid& to,
                                               const PinholeCamera& camera,
                                               const RigidTransform& initial);

}  // namespace dynslam::slam
