// The flags of a run that `run` and `ablate` share.
#include "run_session.hpp"

namespace dynslam::cli {

void add_tracking_flags(CLI::App& command, RunFlags& flags) {
  command.add_option("--solver", flags.solver, "what becomes of static weights in the pose")
      ->check(CLI::IsMember({"fixed", "joint", "eliminated"}))
      ->capture_default_str();
  command
      .add_option("--vocabulary", flags.vocabulary,
                  "words for loops and recognition; without, learnt on the way")
      ->check(CLI::ExistingFile);
  command.add_option("--features", flags.features, "ORB features a frame")
      ->check(CLI::Range(100, 20000))
      ->capture_default_str();
  command.add_option("--threads", flags.threads, "threads of OpenCV; 0: its own choice")
      ->check(CLI::Range(0, 1024))
      ->capture_default_str();
  command.add_flag("--realtime", flags.realtime,
                   "feed frames at their own times and drop what comes while busy");
  command.add_flag("--async", flags.beside,
                   "segment beside tracking, at the pace of the camera, but drop no frame");
  command.add_flag("--sequential", flags.sequential, "one thread, repeatable bit for bit");
}

}  // namespace dynslam::cli
