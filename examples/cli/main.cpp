// The program `dynslam`. Each subcommand registers itself and leaves its work here.
#include <cstdio>
#include <exception>
#include <functional>
#include <iostream>

#include <CLI/CLI.hpp>
#include <opencv2/core/utils/logger.hpp>

#include "dynslam/core/version.hpp"

#include "checks.hpp"
#include "commands.hpp"

namespace {

// Whether all that was printed got through: a disk behind a redirection may be full.
bool is_output_whole() {
  std::cout.flush();
  return std::cout.good() && std::fflush(stdout) == 0 && std::ferror(stdout) == 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"dynslam: visual SLAM for places where things move"};
  app.set_version_flag("--version", std::string("dynslam ") + dynslam::kVersion);
  app.require_subcommand(1);
  app.footer("Exit codes: 0 done, 1 failed, 2 bad usage. `dynslam COMMAND --help` says more.");
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
  dynslam::cli::refuse_odd_values(app);
  // What fails is said once, by us.
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  try {
    const int code = run();
    if (is_output_whole()) return code;
    std::cerr << "dynslam: the output cannot be written\n";
    return 1;
  } catch (const std::exception& error) {
    std::cerr << "dynslam: " << error.what() << '\n';
    return 1;
  }
}
