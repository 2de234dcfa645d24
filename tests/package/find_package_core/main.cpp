// Uses an installed core: a composition of rigid motions comes back to where it started.
#include <cstdio>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/version.hpp"

int main() {
  dynslam::Vector6d xi;
  xi << 0.1, -0.2, 0.3, 0.4, 0.5, -0.6;
  const dynslam::RigidTransform there = dynslam::se3_exp(xi);
  const dynslam::RigidTransform back = there * there.inverse();
  const double error = dynslam::se3_log(back).norm();
  std::printf("dynslam %s, error %g\n", dynslam::kVersion, error);
  return error < 1e-12 ? 0 : 1;
}
