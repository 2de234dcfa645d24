// The loops of depth_alignment.cpp over the cells of two grids, on raw pointers; dispatched at run
// time to the best instruction set.
#pragma once

#include <cstddef>

namespace dynslam::slam::kernels {

/// A grid of cells, row by row. Points and normals are three floats each.
struct Surface {
  const float* points = nullptr;   // camera coordinates, metres; z = 0 where there is none
  const float* normals = nullptr;  // unit; zero where there is none
  const float* trust = nullptr;    // weight of each cell; null: 1
  const float* gray = nullptr;     // brightness of each cell; null: none
  int width = 0;                   // cells
  int height = 0;
};

/// Takes points of `to` into the camera of `from`.
struct Motion {
  float R[9];  // row by row
  float t[3];
};

struct Pinhole {
  float fx, fy, cx, cy;
  float last_column, last_row;  // of the image: a pixel beyond is not in it
};

struct Matching {
  float gate;        // metres between partners
  float gray_sigma;  // grey levels; 0: brightness is not compared
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
AlignmentSums sum_partners(const Surface& from, const Surface& to, const Motion& motion,
                           const Pinhole& camera, const Matching& matching);

}  // namespace dynslam::slam::kernels
