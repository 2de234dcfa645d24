// Runs the system over a rendered scene in which things go wrong, and checks what must hold
// whatever happens: no crash, no hang, no NaN, a sound map, no silent jump, a trajectory for all
// the time it was not lost, and tracking again when all is well again.
//
//   fault_runs [RUNS] [FIRST_SEED] [usual|harsh]     default 12 1 usual; the full count is 200
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <unistd.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/scene.hpp"
#include "dynslam/slam/system.hpp"

#include "slam/faults.hpp"
#include "slam/map_check.hpp"

namespace dynslam::slam {
namespace {

using testing::FaultRate;
using testing::FaultyFrame;
using testing::FaultySource;

constexpr std::size_t kFrames = 100, kQuiet = 25;
constexpr int kLongestRun = 120;        // seconds after which a run hangs
constexpr double kGreatestSpeed = 1.5;  // metres a second: the camera has 0.4, the people 0.9
constexpr double kJumpSlack = 0.2;      // metres that a pose may correct itself by
constexpr double kGreatestTurn = 1.5, kTurnSlack = 0.2;  // the same in radians

std::vector<dataset::Frame> render() {
  dataset::SceneOptions options;
  options.frames = kFrames;
  options.start_time = 5.0;
  options.threads = 2;
  const auto scene = dataset::make_scene("room_walking", options);
  std::vector<dataset::Frame> frames;
  for (std::size_t i = 0; i < scene->size(); ++i) frames.push_back(scene->read(i));
  return frames;
}

// Every composition takes its turn, in one thread and with workers.
SystemOptions options_of(std::uint64_t seed) {
  SystemOptions options;
  options.threading = seed % 2 == 0 ? Threading::kBackground : Threading::kSequential;
  options.reject_matches = seed % 3 == 1;
  options.geometry = seed % 3 == 2;
  if (options.geometry) options.weights = factors::WeightMode::kEliminated;
  return options;
}

struct Step {
  FrameResult result;
  std::size_t shown = 0;  // frame of the sequence whose content it was
};

[[noreturn]] void fail(const std::string& what) { throw std::runtime_error(what); }

void expect(bool holds, std::size_t step, const std::string& what) {
  if (!holds) fail("frame " + std::to_string(step) + ": " + what);
}

bool has_pose(TrackingState state) {
  return state == TrackingState::kTracked || state == TrackingState::kRelocalized;
}

// Between two poses the camera goes no farther than what it saw allows, unless the state says so.
void check_motion(const std::vector<Step>& steps, const std::vector<dataset::Frame>& frames) {
  for (std::size_t i = 1; i < steps.size(); ++i) {
    const Step &before = steps[i - 1], &now = steps[i];
    if (now.result.state != TrackingState::kTracked) continue;
    expect(before.result.state != TrackingState::kLost, i, "tracked although it was lost before");
    if (!before.result.T_world_cam || now.result.loops != before.result.loops) continue;
    const double dt = std::abs(frames[now.shown].timestamp - frames[before.shown].timestamp);
    const RigidTransform motion = before.result.T_world_cam->inverse() * *now.result.T_world_cam;
    expect(motion.t.norm() <= kGreatestSpeed * dt + kJumpSlack, i,
           "jumps by " + std::to_string(motion.t.norm()) + " m");
    const double turn = so3_log(motion.R).norm();
    expect(turn <= kGreatestTurn * dt + kTurnSlack, i, "turns by " + std::to_string(turn));
  }
}

void check_trajectory(const System& system, const std::vector<Step>& steps) {
  const Trajectory trajectory = system.trajectory();
  std::size_t posed = 0;
  for (const Step& step : steps) {
    if (!has_pose(step.result.state)) continue;
    expect(posed < trajectory.size() && trajectory[posed].timestamp == step.result.timestamp,
           step.result.index, "was tracked and is not in the trajectory");
    expect(trajectory[posed].T_world_cam.all_finite(), step.result.index, "is not finite in it");
    ++posed;
  }
  if (posed != trajectory.size()) fail("the trajectory has more poses than were tracked");
}

// At the end all has been well for a second.
void check_recovery(const std::vector<Step>& steps) {
  const std::size_t last = steps.size() - 1;
  for (std::size_t i = last - 5; i <= last; ++i) {
    expect(has_pose(steps[i].result.state), i,
           std::string("has not recovered: ") + slam::to_string(steps[i].result.state));
  }
}

std::optional<Step> feed(System& system, const FaultyFrame& frame) {
  try {
    Step step{system.track(frame.input), frame.shown};
    if (frame.refused) fail("a frame that breaks the contract was taken");
    return step;
  } catch (const InvalidArgument& error) {
    if (!frame.refused) fail(std::string("a sound frame was refused: ") + error.what());
    return std::nullopt;
  }
}

void run(const std::vector<dataset::Frame>& frames, FaultySource& source, std::uint64_t seed) {
  System system(dataset::scene_camera(), options_of(seed));
  std::vector<Step> steps;
  for (const FaultyFrame& frame : source.frames()) {
    std::optional<Step> step = feed(system, frame);
    if (!step) continue;
    const FrameResult& result = step->result;
    expect(result.index == steps.size(), steps.size(), "is numbered wrongly");
    expect(has_pose(result.state) == result.T_world_cam.has_value(), result.index,
           "state and pose disagree");
    expect(!result.T_world_cam || result.T_world_cam->all_finite(), result.index, "NaN in a pose");
    steps.push_back(std::move(*step));
  }
  check_motion(steps, frames);
  check_trajectory(system, steps);
  if (!source.runs_to_the_end()) return;  // the system ends in the middle of its work
  check_recovery(steps);
  system.finish();
  if (const std::string problem = testing::problem_of(system.map()); !problem.empty()) {
    fail("map: " + problem);
  }
}

int run_all(int runs, std::uint64_t first_seed, FaultRate rate) {
  const std::vector<dataset::Frame> frames = render();
  int failed = 0;
  for (std::uint64_t seed = first_seed; seed < first_seed + static_cast<std::uint64_t>(runs);
       ++seed) {
    FaultySource source(frames, seed, kQuiet, rate);
    std::printf("run %llu: %s", static_cast<unsigned long long>(seed), source.describe().c_str());
    std::fflush(stdout);
    ::alarm(kLongestRun);  // a hang ends the program with a signal
    try {
      run(frames, source, seed);
      std::printf(": ok\n");
    } catch (const std::exception& error) {
      std::printf(": FAILED: %s\n", error.what());
      ++failed;
    }
    ::alarm(0);
  }
  std::printf("%d of %d runs failed\n", failed, runs);
  return failed == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}

}  // namespace
}  // namespace dynslam::slam

int main(int argc, char** argv) {
  const int runs = argc > 1 ? std::atoi(argv[1]) : 12;
  const std::uint64_t seed = argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1;
  const bool harsh = argc > 3 && std::string(argv[3]) == "harsh";
  using dynslam::slam::testing::FaultRate;
  return dynslam::slam::run_all(runs, seed, harsh ? FaultRate::kHarsh : FaultRate::kUsual);
}
