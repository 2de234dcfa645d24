// Finds the pose of an RGB-D camera while two fifths of what it sees move, and gives every
// observation a static weight on the way.
#include <cmath>
#include <cstdio>
#include <random>
#include <vector>

#include "dynslam/factors/pose_optimizer.hpp"
#include "dynslam/factors/static_weight.hpp"

namespace {

// What a host has in its hands: keypoints as a detector lays them out.
struct KeyPoint {
  struct Point {
    float x, y;
  } pt;
  float response;
  int octave;
};

struct Frame {
  std::vector<Eigen::Vector3d> points;
  std::vector<KeyPoint> keypoints;
  std::vector<float> right_columns;
  std::vector<float> weights;
  std::vector<bool> moves;
};

Frame look(const dynslam::DepthCamera& camera, const dynslam::RigidTransform& T_cam_world) {
  std::mt19937 rng(7);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::normal_distribution<double> noise(0.0, 1.0);
  Frame frame;
  for (int i = 0; i < 500; ++i) {
    const double u = uniform(rng) * 639.0, v = uniform(rng) * 479.0;
    const Eigen::Vector2d pixel(u, v);
    const Eigen::Vector3d X = camera.unproject(pixel, 1.0 + 4.0 * uniform(rng));
    const bool moves = uniform(rng) < 0.4;
    const Eigen::Vector3d walked =
        moves ? Eigen::Vector3d(0.15, 0.0, 0.05) : Eigen::Vector3d::Zero();
    const Eigen::Vector3d seen = camera.project3(X + walked);
    frame.points.push_back(T_cam_world.inverse() * X);
    frame.keypoints.push_back(
        {{static_cast<float>(seen[0] + noise(rng)), static_cast<float>(seen[1] + noise(rng))},
         1.0F,
         0});
    frame.right_columns.push_back(static_cast<float>(seen[2] + noise(rng)));
    // The segmentation sees half of the movers, the geometric check has no opinion yet.
    const bool masked = moves && uniform(rng) < 0.5;
    const dynslam::factors::DetectorVote votes[] = {{masked ? 0.0 : 1.0, 0.5}, {1.0, 0.5}};
    frame.weights.push_back(static_cast<float>(dynslam::factors::initial_weight(votes)));
    frame.moves.push_back(moves);
  }
  return frame;
}

double centimetres_off(const dynslam::RigidTransform& a, const dynslam::RigidTransform& b) {
  return 100.0 * (a.inverse().t - b.inverse().t).norm();
}

}  // namespace

int main() {
  using namespace dynslam::factors;
  dynslam::DepthCamera camera;
  camera.fx = camera.fy = 525.0, camera.cx = 319.5, camera.cy = 239.5;
  camera.width = 640, camera.height = 480;
  dynslam::Vector6d twist;
  twist << 0.3, -0.1, 0.2, 0.02, 0.3, -0.05;
  const dynslam::RigidTransform truth = dynslam::se3_exp(twist);
  const Frame frame = look(camera, truth);
  twist << 0.03, 0.02, -0.03, 0.01, -0.01, 0.02;
  const dynslam::RigidTransform predicted = dynslam::se3_exp(twist) * truth;

  // [ten-line example]
  PoseOptimizerOptions options;
  options.weights = WeightMode::kEliminated;
  PoseOptimizer optimizer(options);  // keep it: it owns the memory
  const PoseObservations<float> seen{
      dynslam::as_points<double>(frame.points),
      dynslam::as_points<float>(dynslam::field(frame.keypoints, &KeyPoint::pt)),
      frame.right_columns,
      {},
      frame.weights};
  const PoseResult result = optimizer.optimize(camera, seen, predicted);
  if (!result) return 1;                     // result.status says why
  const auto weights = optimizer.weights();  // start the next frame with these
  // [ten-line example]

  options.weights = WeightMode::kFixed;
  optimizer.set_options(options);
  double moving = 0.0, still = 0.0;
  int movers = 0;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    (frame.moves[i] ? moving : still) += weights[i];
    movers += frame.moves[i] ? 1 : 0;
  }
  std::printf("prediction:         %.2f cm off\n", centimetres_off(predicted, truth));
  std::printf("eliminated weights: %.2f cm off, %s after %d iterations, %d of %d inliers\n",
              centimetres_off(result.T_cam_world, truth), to_string(result.status),
              result.iterations, result.inliers, result.observations);
  std::printf("mean weight: %.2f of %d moving points, %.2f of the others\n", moving / movers,
              movers, still / (500 - movers));
  const PoseResult huber = optimizer.optimize(camera, seen, predicted);
  std::printf("Huber:              %.2f cm off\n", centimetres_off(huber.T_cam_world, truth));
  return centimetres_off(result.T_cam_world, truth) < 1.0 ? 0 : 1;
}
