// Tracks a camera through a rendered room in which people walk: once as if nothing moved, once with
// the movers masked out.
#include <cstdio>

#include <opencv2/core/mat.hpp>

#include "dynslam/dataset/scene.hpp"
#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/slam/system.hpp"

namespace {

double track(const dynslam::dataset::Sequence& scene, bool masks) {
  int tracked = 0;
  const auto publish = [&](const dynslam::RigidTransform&) { ++tracked; };
  // [ten-line example]
  dynslam::slam::System system(scene.camera());
  for (std::size_t i = 0; i < scene.size(); ++i) {
    const dynslam::dataset::Frame frame = scene.read(i);
    cv::Mat mask;  // what your segmenter says; empty: all static
    if (masks) mask = frame.mask != 0;
    const auto result = system.track({frame.timestamp, frame.color, frame.depth, mask});
    if (result.T_world_cam) publish(*result.T_world_cam);
  }
  const dynslam::Trajectory trajectory = system.trajectory();
  // [ten-line example]
  const double rmse = dynslam::evaluation::ate(scene.truth(), trajectory).error.rmse;
  std::printf("%-8s  %3d of %3zu frames tracked, ATE RMSE %.4f m\n", masks ? "masks" : "no masks",
              tracked, scene.size(), rmse);
  return rmse;
}

}  // namespace

int main() {
  dynslam::dataset::SceneOptions options;
  options.frames = 90;
  const auto scene = dynslam::dataset::make_scene("room_walking", options);
  track(*scene, false);
  const double with_masks = track(*scene, true);
  return with_masks < 0.05 ? 0 : 1;
}
