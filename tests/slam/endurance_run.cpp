// Runs the system for long in one room and shows what grows: memory, the map, the time of a frame.
//
//   endurance_run [FRAMES] [SYSTEM] [SCENE]     default 600 p-static room_still; masks are true
//   ones
//
// Every twentieth of the run prints a line. The program fails if the map is not sound at the end,
// or if the heap is more than 5 % larger than in the middle of a run of 10,000 frames or more.
#include <algorithm>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include <malloc.h>

#include "dynslam/dataset/scene.hpp"
#include "dynslam/slam/compositions.hpp"
#include "dynslam/slam/system.hpp"

#include "slam/map_check.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kLines = 20;
constexpr std::size_t kLongRun = 10000;   // frames after which the map of a room has settled
constexpr double kGreatestGrowth = 1.05;  // of the heap over the second half of a long run

struct Census {
  std::size_t frame = 0, keyframes = 0, points = 0, observations = 0, edges = 0, features = 0,
              loops = 0, lost = 0;
  double heap_mb = 0.0, free_mb = 0.0, frame_ms = 0.0, background_ms = 0.0;
};

Census count(const System& system) {
  Census census;
  const Map& map = system.map();
  census.keyframes = map.keyframe_count();
  census.points = map.point_count();
  for (const KeyframeId id : map.keyframe_ids()) {
    census.edges += map.keyframe(id).covisible.size();
    census.features += map.keyframe(id).features->size();
  }
  for (const PointId id : map.point_ids()) census.observations += map.point(id).observations.size();
  const struct mallinfo2 heap = ::mallinfo2();
  census.heap_mb = static_cast<double>(heap.uordblks + heap.hblkhd) / 1048576.0;
  census.free_mb = static_cast<double>(heap.fordblks) / 1048576.0;
  return census;
}

void print(const Census& c) {
  std::printf("%6zu %5zu %7zu %8zu %7zu %8zu %5zu %5zu %8.1f %7.1f %7.2f %7.2f\n", c.frame,
              c.keyframes, c.points, c.observations, c.edges, c.features, c.loops, c.lost,
              c.heap_mb, c.free_mb, c.frame_ms, c.background_ms);
  std::fflush(stdout);
}

bool has_settled(const std::vector<Census>& lines) {
  const Census& end = lines.back();
  return end.frame < kLongRun ||
         end.heap_mb <= kGreatestGrowth * lines.at((lines.size() - 1) / 2).heap_mb;
}

int run(std::size_t frames, const std::string& name, const std::string& scene_name) {
  dataset::SceneOptions scene_options;
  scene_options.frames = frames;
  const auto scene = dataset::make_scene(scene_name, scene_options);
  const Composition parts = composition(name);
  System system(dataset::scene_camera(), parts.options);
  std::printf(
      " frame    kf  points  observ.   edges features loops  lost     heap    free      ms"
      "  backgr.\n");
  const std::size_t part = std::max<std::size_t>(1, frames / kLines);
  double frame_ms = 0.0, background_ms = 0.0;
  std::size_t lost = 0;
  std::vector<Census> lines;
  for (std::size_t i = 0; i < frames; ++i) {
    const dataset::Frame frame = scene->read(i);
    const FrameResult result = system.track({frame.timestamp, frame.color, frame.depth,
                                             parts.masks ? cv::Mat(frame.mask != 0) : cv::Mat()});
    frame_ms += result.ms.total;
    background_ms += result.background.map + result.background.loop;
    if (!result.T_world_cam) ++lost;
    if ((i + 1) % part != 0) continue;
    Census census = count(system);
    census.frame = i + 1;
    census.loops = result.loops;
    census.lost = lost;
    census.frame_ms = frame_ms / static_cast<double>(part);
    census.background_ms = background_ms / static_cast<double>(part);
    frame_ms = background_ms = 0.0;
    print(census);
    lines.push_back(census);
  }
  const std::string problem = testing::problem_of(system.map());
  if (!problem.empty()) std::printf("the map is not sound: %s\n", problem.c_str());
  if (!has_settled(lines)) std::printf("memory grows\n");
  return problem.empty() && has_settled(lines) ? EXIT_SUCCESS : EXIT_FAILURE;
}

}  // namespace
}  // namespace dynslam::slam

int main(int argc, char** argv) {
  const std::size_t frames = argc > 1 ? std::strtoull(argv[1], nullptr, 10) : 600;
  return dynslam::slam::run(frames, argc > 2 ? argv[2] : "p-static",
                            argc > 3 ? argv[3] : "room_still");
}
