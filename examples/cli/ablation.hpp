// Which parts of which system earn their keep: every composition, whole and with each of its parts
// left out, over some sequences, several times.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "run_session.hpp"
#include "sequences.hpp"

namespace dynslam::cli {

/// What is run.
struct AblationPlan {
  std::vector<SequenceFlags> sequences;
  std::vector<std::string> systems;
  RunFlags run;  ///< of every run; system and parts are set by the plan
  int runs = 5;  ///< of every cell; rendered scenes get the next seed each time
};

/// One run of a cell.
struct CellRun {
  std::uint64_t seed = 0;
  std::size_t frames = 0;
  std::size_t tracked = 0;
  double ate = 0.0;        ///< RMSE, metres; NaN without truth or without a pose
  double ms_median = 0.0;  ///< of a frame
  double ms_p95 = 0.0;
};

nlohmann::ordered_json to_json(const CellRun& run);

/// A system, whole or without a part, on a sequence.
struct Cell {
  std::string sequence;
  std::string system;
  std::string without;  ///< name of a slam::Part; empty: the whole system
  std::vector<CellRun> runs;

  /// "p-static" or "p-static without mask".
  std::string label() const { return without.empty() ? system : system + " without " + without; }
};

/// A cell's runs in a few numbers, medians over the runs.
struct CellSummary {
  double tracked_share = 0.0;  ///< of all frames of all runs
  double ate_median = 0.0;     ///< metres; NaN without truth
  double ate_iqr = 0.0;        ///< metres
  double ms_median = 0.0;
  double ms_p95 = 0.0;
};
CellSummary summarize(const Cell& cell);

/// Runs a plan: sequence by sequence, each system whole and then without each of its parts.
///
/// Finished runs are kept in `folder`/cells, one file a cell with the settings it was made with,
/// and are not run again; those of other settings are. `announce` is told before each run: the
/// cell, how many runs are done and how many there are. Throws as `open_sequence` and `run_system`.
std::vector<Cell> run_ablation(
    const AblationPlan& plan, const std::filesystem::path& folder,
    const std::function<void(const Cell&, std::size_t done, std::size_t total)>& announce);

}  // namespace dynslam::cli
