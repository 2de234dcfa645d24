// What is asked of 6 x 6 matrices, compiled once: each of Eigen's decompositions takes a compiler
// several seconds in every file that names it.
#pragma once

#include "dynslam/core/rigid_transform.hpp"

namespace dynslam::slam {

/// Inverse by an LU decomposition; infinite or NaN where there is none.
Matrix6d inverse_of(const Matrix6d& matrix);

/// x of H x = b for a symmetric H, by LDL'.
Vector6d solve_symmetric(const Matrix6d& H, const Vector6d& b);

/// Eigenvalues of a symmetric matrix, the least first.
Vector6d eigenvalues_of(const Matrix6d& symmetric);

struct Eigen6 {
  Vector6d values;   // the least first
  Matrix6d vectors;  // in columns
};
Eigen6 eigen_of(const Matrix6d& symmetric);

}  // namespace dynslam::slam
