// What `dynslam run` leaves in its folder.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "dynslam/dataset/sequence.hpp"
#include "dynslam/evaluation/report.hpp"

#include "run_session.hpp"

namespace dynslam::cli {

/// Makes the folder and proves that files can be written there. Throws IoError.
void prepare_output(const std::filesystem::path& folder);

/// summary.json's content, by the contract of the program.
nlohmann::ordered_json summarize(const dataset::Sequence& sequence, const RunFlags& flags,
                                 const RunOutcome& outcome);

/// A number of a JSON file; what is not finite becomes null.
nlohmann::ordered_json number(double value);

/// ATE RMSE of a summary, metres; NaN where there is none.
double ate_rmse(const nlohmann::ordered_json& summary);

/// Third quartile minus first; NaN of nothing.
double interquartile_range(const std::vector<double>& values);

/// What the report shows of a run.
evaluation::RunRecord to_record(const std::string& name, const RunOutcome& outcome);

/// trajectory.txt, keyframes.txt, map.ply, map.dynslam, frames.csv. Each file is whole or not
/// there.
void write_run(const std::filesystem::path& folder, const RunOutcome& outcome);

/// Writes text to a file that is whole or not there. Throws IoError.
void write_text(const std::filesystem::path& path, const std::string& text);

/// report.html, with errors where the sequence has truth, compared with `others`; returns what went
/// wrong with the plots, or nothing.
std::string write_html(const std::filesystem::path& folder, const dataset::Sequence& sequence,
                       const RunFlags& flags, const RunOutcome& outcome,
                       const std::vector<evaluation::RunRecord>& others);

}  // namespace dynslam::cli
