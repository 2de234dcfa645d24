// Levenberg-Marquardt of one pose over the kernels of pose_kernels.hpp.
#pragma once

#include <cstddef>

#include <Eigen/Core>
#include <hwy/aligned_allocator.h>

#include "dynslam/factors/pose_optimizer.hpp"

#include "factors/pose_kernels.hpp"

namespace dynslam::factors {

// Arrays of one double per point, in one aligned block.
class PoseArrays {
 public:
  void reserve(std::size_t points);
  std::size_t capacity() const { return capacity_; }

  // Inputs.
  double *x, *y, *z, *u, *v, *right, *info, *info_right;
  double* phi0;    // static weight given, 0 where not usable
  double* active;  // 1 takes part in this round
  double* trust;   // phi0^2 where active
  // State: residuals and weights at the pose and at the trial pose.
  double *s, *s_trial, *phi, *phi_trial;
  // Scratch of an iteration.
  double *w, *c, *gw;

 private:
  std::size_t capacity_ = 0;
  hwy::AlignedFreeUniquePtr<double[]> block_;
};

// One problem: what stays the same over the rounds, and the state that moves.
class PoseSolver {
 public:
  PoseSolver(const PoseOptimizerOptions& options, PoseArrays& arrays, const DepthCamera& camera,
             std::size_t size, const PosePrior* prior);

  // Residuals at a pose, into arrays.s; to be called before the first round.
  void start(const RigidTransform& T);

  // Iterates from the current pose. `graduate`: begin with a softer weight prior when residuals
  // are large. Returns Converged or MaxIterations.
  SolveStatus run(bool graduate, bool plain);

  // Cost at the current pose with weights at their optimum there; before run().
  double initial_cost();
  // Cost at the current pose with weights as they are; after run().
  double finish();

  // Gauss-Newton information at the current pose; false when it leaves a direction undetermined.
  bool information(Matrix6d* H);

  const RigidTransform& pose() const { return pose_; }
  int iterations() const { return iterations_; }

 private:
  struct Normal {
    Matrix6d H;
    Vector6d g;
  };
  struct Phase {
    double lambda = 0.0;   // stiffness of the weight prior now
    double damping = 0.0;  // of Levenberg-Marquardt
    bool near = false;     // near the optimum: the mode's own Newton steps
  };
  double softened(double lambda) const;
  bool find_step(Phase* phase, double* cost, Vector6d* step);
  double weigh(const double* s, const double* phi, const Phase& phase);
  double weigh_plainly(const double* s, double curvature);
  Phase final_phase() const;
  double prior_cost(const RigidTransform& T) const;
  Normal linearize();
  bool solve(const Normal& normal, double damping, Vector6d* step) const;
  void close_weights(double lambda);
  kernels::View view(const RigidTransform& T) const;

  const PoseOptimizerOptions& options_;
  PoseArrays& a_;
  const DepthCamera& camera_;
  std::size_t size_;
  const PosePrior* prior_;
  kernels::Points points_;
  RigidTransform pose_;
  const double* gradient_weights_ = nullptr;
  int iterations_ = 0;
  bool plain_ = false;   // least squares, whatever options_.loss says
  bool opened_ = false;  // Joint: phi have become parameters
};

}  // namespace dynslam::factors
