// The ten lines of README.md.
#include <cstdio>

#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/evaluation/trajectory_io.hpp"

int main() {
  const auto truth = dynslam::evaluation::read_trajectory("groundtruth.txt");
  const auto estimate = dynslam::evaluation::read_trajectory("trajectory.txt");
  const auto ate = dynslam::evaluation::ate(truth, estimate);
  std::printf("ATE RMSE %.4f m over %zu poses\n", ate.error.rmse, ate.error.count);
}
