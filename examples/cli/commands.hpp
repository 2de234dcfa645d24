// The subcommands. Each function registers one and, when it was chosen, sets `run` to its work,
// which returns the exit code.
#pragma once

#include <functional>

#include <CLI/CLI.hpp>

namespace dynslam::cli {

CLI::App* add_run_command(CLI::App& app, std::function<int()>& run);
CLI::App* add_ablate_command(CLI::App& app, std::function<int()>& run);
CLI::App* add_bench_command(CLI::App& app, std::function<int()>& run);
CLI::App* add_eval_command(CLI::App& app, std::function<int()>& run);
CLI::App* add_segment_command(CLI::App& app, std::function<int()>& run);
CLI::App* add_match_command(CLI::App& app, std::function<int()>& run);
CLI::App* add_movers_command(CLI::App& app, std::function<int()>& run);
CLI::App* add_loops_command(CLI::App& app, std::function<int()>& run);
CLI::App* add_scene_command(CLI::App& app, std::function<int()>& run);
CLI::App* add_vocab_command(CLI::App& app, std::function<int()>& run);

/// Only where the room `attention` is built.
void add_fuse_command(CLI::App& app, std::function<int()>& run);

}  // namespace dynslam::cli
