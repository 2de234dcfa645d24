// dynslam's own solver of bundle adjustment: points eliminated, reduced camera system by Cholesky.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <hwy/aligned_allocator.h>

#include "dynslam/factors/bundle_adjustment.hpp"

#include "factors/weighing.hpp"

namespace dynslam::factors {

// Symmetric positive definite system of 6 x 6 blocks: the cameras after the points are gone.
class ReducedSystem {
 public:
  // Fixes the structure from the pairs (row <= column) that have a block; decides dense or sparse.
  void analyze(std::size_t cameras,
               const std::vector<std::pair<std::uint32_t, std::uint32_t>>& pairs);
  // Solves blocks x = rhs (upper blocks, layout of schur_kernels.hpp); false: not positive
  // definite.
  bool solve(const double* blocks, const double* rhs, Eigen::VectorXd* x);
  bool dense() const { return dense_; }

 private:
  using Sparse = Eigen::SparseMatrix<double>;
  bool solve_dense(const double* blocks, Eigen::VectorXd* x);
  bool solve_sparse(const double* blocks, Eigen::VectorXd* x);

  std::size_t cameras_ = 0;
  bool dense_ = true;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs_;
  std::vector<std::size_t> slot_;  // sparse: where each block's first value lies
  Eigen::MatrixXd matrix_;
  Sparse sparse_;
  Eigen::SimplicialLLT<Sparse, Eigen::Lower> factor_;
};

// Everything between the first call and the last step; its memory is kept between calls.
class SchurSolver {
 public:
  BundleSummary run(const BundleProblem& problem, const BundleOptions& options);

 private:
  // An observation that takes part; sorted by point.
  struct Item {
    double u, v, right, info, info_right, phi0;
    std::uint32_t keyframe, point, entry, original;
  };
  static constexpr std::uint32_t kNone = 0xffffffffU;
  struct Projection {
    double x = 0.0, y = 0.0, inv_z = 0.0, ru = 0.0, rv = 0.0, rr = 0.0, s = 0.0;
    Eigen::Vector3d X;
    bool front = false;
  };
  // What the back-substitution of a joint weight needs.
  struct Linear {
    Eigen::Vector3d a, X;
    double cross, slope, A;
  };

  void collect(const BundleProblem& problem);
  void index_blocks();
  Projection project(const Item& item, const RigidTransform& T, const Eigen::Vector3d& X) const;
  double linearize(const WeighingRule& rule);
  bool solve(double damping);
  double try_step(const WeighingRule& rule);
  void accept();
  void close_weights(double lambda);
  int front_count() const;
  double cost(const WeighingRule& rule) const;
  double softened(double target, double most) const;
  bool find_step(double* damping);
  SolveStatus iterate(const BundleOptions& options, WeighingRule* rule, BundleSummary* summary);
  void write_back(const BundleProblem& problem, const BundleOptions& options,
                  BundleSummary* summary);
  std::uint32_t camera_of(const Item& item) const { return camera_index_[item.keyframe]; }
  std::uint32_t free_point_of(const Item& item) const { return point_index_[item.point]; }

  DepthCamera camera_;
  std::vector<Item> items_;
  std::vector<double> phi_, phi_trial_;
  std::vector<Linear> linear_;
  std::vector<RigidTransform> poses_, poses_trial_;
  std::vector<Eigen::Vector3d> points_, points_trial_;
  std::vector<std::uint32_t> camera_index_, point_index_;  // kNone: held
  std::vector<std::uint32_t> free_cameras_, free_points_;
  // Normal equations.
  std::vector<std::uint32_t> entry_begin_, entry_camera_, entry_point_, pair_block_, diagonal_;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs_;
  std::vector<Matrix6d> H_;
  std::vector<Vector6d> b_;
  std::vector<Eigen::Matrix3d> V_;
  std::vector<Eigen::Vector3d> bp_, dp_;
  std::vector<double> inverse_, gradient_;
  hwy::AlignedFreeUniquePtr<double[]> aligned_;
  std::size_t aligned_size_ = 0;
  double *cross_ = nullptr, *scratch_ = nullptr, *blocks_ = nullptr, *rhs_ = nullptr;
  std::size_t block_count_ = 0;
  ReducedSystem reduced_;
  Eigen::VectorXd dc_;
};

}  // namespace dynslam::factors
