// dynslam segment: runs a segmenter over images, writes what it found, scores it against truth.
#pragma once

#include <functional>

#include <CLI/CLI.hpp>

namespace dynslam::cli {

/// Registers the subcommand `segment`. Parsing it sets `run` to its work, which returns the exit
/// code, and throws dynslam::Error if the work fails.
CLI::App* add_segment_command(CLI::App& app, std::function<int()>& run);

}  // namespace dynslam::cli
