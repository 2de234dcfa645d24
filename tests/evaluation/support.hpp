// What the tests of this room share.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <random>
#include <sstream>
#include <string>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/trajectory.hpp"
#include "dynslam/evaluation/trajectory_io.hpp"

namespace dynslam::evaluation::testing {

inline constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

inline Eigen::Vector3d random_vector(std::mt19937& random, double sigma) {
  std::normal_distribution<double> normal(0.0, sigma);
  const double x = normal(random), y = normal(random), z = normal(random);
  return {x, y, z};
}

inline RigidTransform random_transform(std::mt19937& random, double rotation = 1.5,
                                       double translation = 10.0) {
  return {so3_exp(random_vector(random, rotation)), random_vector(random, translation)};
}

/// A walk of `count` poses, 0.1 s apart, with steps of about `step` metres.
inline Trajectory random_walk(std::mt19937& random, int count, double step = 0.3) {
  Trajectory walk;
  RigidTransform T_world_cam = random_transform(random);
  for (int i = 0; i < count; ++i) {
    walk.push_back({100.0 + 0.1 * i, T_world_cam});
    const RigidTransform motion{so3_exp(random_vector(random, 0.05)),
                                random_vector(random, 0.1 * step) + Eigen::Vector3d(0, 0, step)};
    T_world_cam = (T_world_cam * motion).normalized();
  }
  return walk;
}

/// The same with noise on every pose.
inline Trajectory with_noise(const Trajectory& trajectory, std::mt19937& random, double sigma) {
  Trajectory noisy = trajectory;
  for (StampedPose& pose : noisy) {
    pose.T_world_cam.t += random_vector(random, sigma);
    pose.T_world_cam.R *= so3_exp(random_vector(random, 0.1 * sigma));
  }
  return noisy;
}

inline void write(const std::string& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

inline std::string read(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

/// Text of what `call` throws as `Exception`, empty when it does not.
template <typename Exception, typename Call>
std::string message_of(Call&& call) {
  try {
    call();
  } catch (const Exception& error) {
    return error.what();
  }
  return {};
}

/// The figures that make_golden.py computed with numpy.
inline std::map<std::string, double> read_golden() {
  std::ifstream in(std::string(DYNSLAM_TEST_DATA_DIR) + "/golden.txt");
  std::map<std::string, double> golden;
  std::string name;
  double value = 0.0;
  while (in >> name >> value) golden[name] = value;
  return golden;
}

/// Folder of the shared trajectories; it may not exist.
inline std::string trajectories_folder() {
  const char* data = std::getenv("DYNSLAM_DATA");
  return std::string(data ? data : DYNSLAM_DEFAULT_DATA_DIR) + "/trajectories/";
}

}  // namespace dynslam::evaluation::testing
