// What alignment_kernels.cpp reads, on raw pointers and in single precision.
#pragma once

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"

#include "slam/depth_alignment.hpp"

namespace dynslam::slam::kernels {

/// A grid of cells, row by row. Points and normals are three floats each.
struct Surface {
  const float* points;   // camera coordinates, metres; z = 0 where there is none
  const float* normals;  // unit; zero where there is none
  const float* trust;    // weight of each cell; null: 1
  const float* gray;     // brightness of each cell; null: none
  int width, height;     // cells
};

/// Of a grid that is not empty. Its images are continuous: nobody cuts them out of others.
inline Surface surface_of(const SurfaceGrid& grid) {
  return {grid.points.front().data(),
          grid.normals.front().data(),
          grid.trust.empty() ? nullptr : grid.trust.ptr<float>(),
          grid.gray.empty() ? nullptr : grid.gray.ptr<float>(),
          grid.width,
          grid.height};
}

/// Takes points of `to` into the camera of `from`.
struct Motion {
  float R[9];  // row by row
  float t[3];
};

inline Motion motion_of(const RigidTransform& T_from_to) {
  Motion motion;
  Eigen::Map<Eigen::Matrix<float, 3, 3, Eigen::RowMajor>>(motion.R) = T_from_to.R.cast<float>();
  Eigen::Map<Eigen::Vector3f>(motion.t) = T_from_to.t.cast<float>();
  return motion;
}

struct Pinhole {
  float fx, fy, cx, cy;
  float last_column, last_row;  // of the image: a pixel beyond is not in it
};

inline Pinhole pinhole_of(const PinholeCamera& camera) {
  return {static_cast<float>(camera.fx),        static_cast<float>(camera.fy),
          static_cast<float>(camera.cx),        static_cast<float>(camera.cy),
          static_cast<float>(camera.width - 1), static_cast<float>(camera.height - 1)};
}

}  // namespace dynslam::slam::kernels
