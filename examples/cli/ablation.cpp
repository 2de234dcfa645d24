#include "ablation.hpp"

#include <cmath>
#include <fstream>
#include <optional>
#include <utility>

#include "dynslam/core/version.hpp"
#include "dynslam/evaluation/metrics.hpp"

#include "run_output.hpp"

namespace dynslam::cli {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

double median_over(const Cell& cell, double CellRun::*member) {
  std::vector<double> values;
  for (const CellRun& run : cell.runs) values.push_back(run.*member);
  return evaluation::quantile(values, 0.5);
}

CellRun from_json(const Json& json) {
  const auto value = [&](const char* key) {
    return json.at(key).is_null() ? std::nan("") : json.at(key).get<double>();
  };
  CellRun run;
  run.seed = json.at("seed").get<std::uint64_t>();
  run.frames = json.at("frames").get<std::size_t>();
  run.tracked = json.at("tracked").get<std::size_t>();
  run.ate = value("ate");
  run.ms_median = value("ms_median");
  run.ms_p95 = value("ms_p95");
  return run;
}

// All that a run's result depends on; a kept run with other settings does not count.
Json settings_of(const SequenceFlags& input, const RunFlags& flags) {
  return {{"version", kVersion},
          {"input", {input.tum, input.kitti, input.euroc, input.scene}},
          {"camera", input.camera},
          {"depth_scale", input.depth_scale},
          {"frames", input.frames},
          {"seed", input.seed},
          {"segmenter", {flags.segmenter, flags.backend, flags.segment_every}},
          {"masks", {Json(flags.classes), flags.min_score, flags.dilation_px}},
          {"features", flags.features},
          {"threads", flags.threads},
          {"solver", flags.solver},
          {"vocabulary", flags.vocabulary},
          {"mode", {flags.realtime, flags.beside, flags.sequential}}};
}

std::vector<CellRun> kept_runs(const fs::path& file, const Json& settings) {
  std::ifstream in(file);
  const Json stored = Json::parse(in, nullptr, false);
  if (stored.is_discarded() || stored.value("settings", Json()) != settings) return {};
  std::vector<CellRun> runs;
  try {
    for (const Json& run : stored.at("runs")) runs.push_back(from_json(run));
  } catch (const Json::exception&) {
    runs.clear();  // not a file of ours: run again
  }
  return runs;
}

void keep_runs(const fs::path& file, const Json& settings, const Cell& cell) {
  Json json = {{"settings", settings}, {"cell", cell.label()}, {"runs", Json::array()}};
  for (const CellRun& run : cell.runs) json["runs"].push_back(to_json(run));
  write_text(file, json.dump(2) + "\n");
}

CellRun run_once(const SequenceFlags& input, const RunFlags& flags) {
  const std::unique_ptr<dataset::Sequence> sequence = open_sequence(input);
  const Json summary = summarize(*sequence, flags, run_system(*sequence, flags));
  const Json& ms = summary.at("time_ms").at("frame");
  CellRun run;
  run.seed = input.seed;
  run.frames = summary.at("frames").get<std::size_t>();
  run.tracked = summary.at("tracked").get<std::size_t>();
  run.ate = ate_rmse(summary);
  run.ms_median = ms.at("median").get<double>();
  run.ms_p95 = ms.at("p95").get<double>();
  return run;
}

// A cell and what it is run with.
struct Job {
  SequenceFlags input;
  RunFlags flags;
  Cell cell;
  fs::path file;
};

std::vector<Job> jobs_of(const AblationPlan& plan, const fs::path& folder) {
  std::vector<Job> jobs;
  for (std::size_t s = 0; s < plan.sequences.size(); ++s) {
    const SequenceFlags& input = plan.sequences[s];
    const std::unique_ptr<dataset::Sequence> opened = open_sequence(input);
    tell_left_out(*opened);
    const std::string sequence = opened->name();
    for (const std::string& system : plan.systems) {
      std::vector<std::string> variants = {""};
      for (const slam::Part part : slam::composition(system).parts()) {
        variants.emplace_back(to_string(part));
      }
      for (const std::string& without : variants) {
        Job job{input, plan.run, {sequence, system, without, {}}, {}};
        job.flags.system = system;
        job.flags.without.clear();
        if (!without.empty()) job.flags.without = {without};
        job.file = folder / (std::to_string(s) + "-" + sequence + "-" + system +
                             (without.empty() ? "" : "-without-" + without) + ".json");
        jobs.push_back(std::move(job));
      }
    }
  }
  return jobs;
}

}  // namespace

Json to_json(const CellRun& run) {
  return {{"seed", run.seed},
          {"frames", run.frames},
          {"tracked", run.tracked},
          {"ate", number(run.ate)},
          {"ms_median", number(run.ms_median)},
          {"ms_p95", number(run.ms_p95)}};
}

CellSummary summarize(const Cell& cell) {
  std::size_t frames = 0, tracked = 0;
  std::vector<double> ates;
  for (const CellRun& run : cell.runs) {
    frames += run.frames;
    tracked += run.tracked;
    if (!std::isnan(run.ate)) ates.push_back(run.ate);
  }
  CellSummary summary;
  summary.tracked_share = static_cast<double>(tracked) / static_cast<double>(frames);
  summary.ate_median = evaluation::quantile(ates, 0.5);
  summary.ate_iqr = interquartile_range(ates);
  summary.ms_median = median_over(cell, &CellRun::ms_median);
  summary.ms_p95 = median_over(cell, &CellRun::ms_p95);
  return summary;
}

std::vector<Cell> run_ablation(
    const AblationPlan& plan, const fs::path& folder,
    const std::function<void(const Cell&, std::size_t, std::size_t)>& announce) {
  const fs::path kept = folder / "cells";
  prepare_output(kept);
  std::vector<Job> jobs = jobs_of(plan, kept);
  const auto runs = static_cast<std::size_t>(plan.runs);
  std::size_t done = 0;
  for (Job& job : jobs) {
    const Json settings = settings_of(job.input, job.flags);
    job.cell.runs = kept_runs(job.file, settings);
    if (job.cell.runs.size() > runs) job.cell.runs.resize(runs);
    done += job.cell.runs.size();
    while (job.cell.runs.size() < runs) {
      announce(job.cell, done++, jobs.size() * runs);
      SequenceFlags input = job.input;
      if (!input.scene.empty()) input.seed += job.cell.runs.size();
      job.cell.runs.push_back(run_once(input, job.flags));
      keep_runs(job.file, settings, job.cell);
    }
  }
  std::vector<Cell> cells;
  for (Job& job : jobs) cells.push_back(std::move(job.cell));
  return cells;
}

}  // namespace dynslam::cli
