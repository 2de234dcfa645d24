// What the routes through Ceres ask of its solver and learn from it alike.
#pragma once

#include <ceres/solver.h>

#include "dynslam/factors/pose_optimizer.hpp"

namespace dynslam::factors {

/// SuiteSparse where Ceres was built with it.
inline ceres::SparseLinearAlgebraLibraryType best_sparse_library() {
  return ceres::IsSparseLinearAlgebraLibraryTypeAvailable(ceres::SUITE_SPARSE)
             ? ceres::SUITE_SPARSE
             : ceres::EIGEN_SPARSE;
}

inline SolveStatus status_of(const ceres::Solver::Summary& summary) {
  switch (summary.termination_type) {
    case ceres::CONVERGENCE:
      return SolveStatus::kConverged;
    case ceres::USER_SUCCESS:
      return SolveStatus::kAborted;
    case ceres::NO_CONVERGENCE:
      return SolveStatus::kMaxIterations;
    default:
      return SolveStatus::kDegenerate;
  }
}

}  // namespace dynslam::factors
