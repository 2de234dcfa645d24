// dynslam match: rejects matches between frames some way apart and scores every rule against truth.
#pragma once

#include <functional>

#include <CLI/CLI.hpp>

namespace dynslam::cli {

/// Registers the subcommand `match`. Parsing it sets `run` to its work, which returns the exit
/// code, and throws dynslam::Error if the work fails.
CLI::App* add_match_command(CLI::App& app, std::function<int()>& run);

}  // namespace dynslam::cli
