// dynslam eval: errors of an estimated trajectory.
#pragma once

#include <functional>

#include <CLI/CLI.hpp>

namespace dynslam::cli {

/// Registers the subcommand `eval`. Parsing it sets `run` to its work, which returns the exit code
/// and throws dynslam::Error if the work fails.
CLI::App* add_eval_command(CLI::App& app, std::function<int()>& run);

}  // namespace dynslam::cli
