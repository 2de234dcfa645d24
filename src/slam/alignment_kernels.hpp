// The loops of depth_alignment.cpp over the cells of two grids; dispatched at run time to the best
// instruction set.
#pragma once

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"

#include "slam/depth_alignment.hpp"

namespace dynslam::slam::kernels {

struct Matching {
  float gate;        // metres between partners
  float gray_sigma;  // grey levels; 0: brightness is not compared, else both grids have it
  float min_cosine;  // between normals of partners
  float max_chi2;    // what one residual adds to chi2
  int step;          // every how many cells of `to` take part, in rows and columns
};

constexpr float kLeastNoise = 0.003F;  // metres that partners may be off by their cells alone
constexpr float kHuber = 2.0F;         // standard deviations

/// Sums over partners, whose distance is measured along the normals of `from`. A residual r with J
/// = dr / dxi, xi the left perturbation of the motion, is whitened by its noise and weighed by
/// Huber's loss at 2 and by its cell's trust.
struct AlignmentSums {
  double H[21] = {};     // J' W J, upper triangle row by row
  double g[6] = {};      // J' W r
  double squares = 0.0;  // of the distances to the partners' planes, metres^2
  double chi2 = 0.0;     // whitened squares, clipped, times trust
  double trust = 0.0;
  int partners = 0;
  int candidates = 0;  // points with a normal that fall into the image of `from`
};

/// O(cells of `to` / step^2); allocates nothing.
AlignmentSums sum_partners(const SurfaceGrid& from, const SurfaceGrid& to,
                           const PinholeCamera& camera, const RigidTransform& T_from_to,
                           const Matching& matching);

}  // namespace dynslam::slam::kernels
