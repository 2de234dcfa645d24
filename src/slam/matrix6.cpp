#include "matrix6.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>

namespace dynslam::slam {

Matrix6d inverse_of(const Matrix6d& matrix) { return matrix.inverse(); }

Vector6d solve_symmetric(const Matrix6d& H, const Vector6d& b) { return H.ldlt().solve(b); }

Vector6d eigenvalues_of(const Matrix6d& symmetric) {
  return Eigen::SelfAdjointEigenSolver<Matrix6d>(symmetric, Eigen::EigenvaluesOnly).eigenvalues();
}

Eigen6 eigen_of(const Matrix6d& symmetric) {
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(symmetric);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

}  // namespace dynslam::slam
