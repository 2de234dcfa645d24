// The program `dynslam`. Each subcommand registers itself and leaves its work here.
#include <exception>
#include <functional>
#include <iostream>

#include <CLI/CLI.hpp>
#include <opencv2/core/utils/logger.hpp>

#include "dynslam/core/version.hpp"

#include "commands.hpp"

int main(int argc, char** argv) {
  CLI::App app{"dynslam: visual SLAM for places where things move"};
  app.set_version_flag("--version", std::string("dynslam ") + dynslam::kVersion);
  app.require_subcommand(1);
  std::function<int()> run;
  dynslam::cli::add_run_command(app, run);
  dynslam::cli::add_ablate_command(app, run);
  dynslam::cli::add_bench_command(app, run);
  dynslam::cli::add_eval_command(app, run);
  dynslam::cli::add_segment_command(app, run);
  dynslam::cli::add_match_command(app, run);
  dynslam::cli::add_movers_command(app, run);
  dynslam::cli::add_loops_command(app, run);
  dynslam::cli::add_scene_command(app, run);
  dynslam::cli::add_vocab_command(app, run);
#ifdef DYNSLAM_CLI_WITH_ATTENTION
  dynslam::cli::add_fuse_command(app, run);
#endif
  // What fails is said once, by us.
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  try {
    return run();
  } catch (const std::exception& error) {
    std::cerr << "dynslam: " << error.what() << '\n';
    return 1;
  }
}
