// Links an installed evaluation; core comes along.
#include <cstdio>

#include "dynslam/core/trajectory.hpp"
#include "dynslam/core/version.hpp"

int main() {
  const dynslam::Trajectory trajectory(3);
  std::printf("dynslam %s, %zu poses\n", dynslam::kVersion, trajectory.size());
  return 0;
}
