// Binds foreign data without a copy, moves a camera and projects a point: the vocabulary that every
// other room of dynslam speaks.
#include <cstdio>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/points.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"

namespace {

// Somebody else's map point, laid out as somebody else likes it.
struct HostPoint {
  unsigned long id;
  double position[3];
};

double mean_depth(dynslam::Points3d points_world, const dynslam::RigidTransform& T_cam_world) {
  double sum = 0.0;
  for (Eigen::Index i = 0; i < points_world.cols(); ++i) {
    sum += (T_cam_world * points_world.col(i).eval()).z();
  }
  return sum / static_cast<double>(points_world.cols());
}

}  // namespace

int main() {
  // [ten-line example]
  const std::vector<HostPoint> host = {{7, {0.0, 0.0, 2.0}}, {9, {0.5, -0.2, 3.0}}};
  const auto points = dynslam::as_points<double>(dynslam::field(host, &HostPoint::position));

  dynslam::Vector6d twist;  // [translation; rotation], metres and radians
  twist << 0.1, 0.0, 0.0, 0.0, 0.05, 0.0;
  const dynslam::RigidTransform T_cam_world = dynslam::se3_exp(twist);

  dynslam::DepthCamera camera;
  camera.fx = camera.fy = 525.0, camera.cx = 319.5, camera.cy = 239.5;
  camera.width = 640, camera.height = 480;
  const auto pixel = camera.project_into_image(T_cam_world * points.col(1).eval());
  // [ten-line example]

  std::printf("points bound without a copy: %s\n",
              points.data() == host[0].position ? "yes" : "no");
  std::printf("mean depth of %d points: %.3f m\n", static_cast<int>(points.cols()),
              mean_depth(points, T_cam_world));
  if (pixel) std::printf("point 9 is seen at (%.2f, %.2f)\n", pixel->x(), pixel->y());
  return points.data() == host[0].position && pixel ? 0 : 1;
}
