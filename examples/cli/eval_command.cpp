#include <cmath>
#include <cstdio>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/evaluation/plot.hpp"
#include "dynslam/evaluation/trajectory_io.hpp"
#include "dynslam/evaluation/trajectory_plots.hpp"

#include "commands.hpp"

namespace dynslam::cli {
namespace {

using Json = nlohmann::ordered_json;
namespace eval = dynslam::evaluation;

constexpr const char* kFooter = R"(Prints the errors of ESTIMATE against TRUTH.
  ate    distance of the positions after alignment (default se3), metres
  rpe    error of the motion over a step (default 1 frame), metres and degrees
  kitti  KITTI's metric over 100 to 800 m, % and degrees per 100 m

Files are TUM (time tx ty tz qx qy qz qw, camera to world) or KITTI (3x4 matrix by rows; frame i has
time i unless --times is given). Poses are associated by time, one to one, at most --max-dt apart.

Steps of rpe: in frames and metres pairs stand end to end, as in the published figures (in metres the
path of the estimate is summed up; each pose that reaches --delta begins the next pair); in seconds a
pair begins at every pose. --all-pairs and --consecutive choose the other way.

A repeated timestamp in TRUTH (motion capture files rounded to 0.1 ms have them) keeps its first pose;
in ESTIMATE it is an error.

JSON keys: rmse mean median std min max pairs align, and by metric rotation_deg (rpe),
translation_percent rotation_deg_per_100m by_length (kitti: rmse ... max are in %), coverage, scale.

Examples:
  dynslam eval ate groundtruth.txt trajectory.txt --plot map.svg
  dynslam eval rpe gt.txt est.txt --format kitti --align none --delta 10 --unit m)";

// What the command line asks for.
struct EvalFlags {
  std::string metric, truth, estimate, format, align, unit = "f", times, plot;
  double delta = 1.0;
  double max_dt = 0.02;
  double offset = 0.0;
  bool all_pairs = false, consecutive = false, sort = false, json = false;
};

// The work, checked when the command line is parsed.
struct EvalJob {
  EvalFlags flags;
  eval::ReadTrajectoryOptions reading;
  eval::AssociationOptions association;
  eval::Alignment alignment = eval::Alignment::kNone;
  eval::RpeOptions rpe;
};

// What the three measures have in common in the output.
struct Outcome {
  eval::Statistics statistics;
  eval::Coverage coverage;
  std::optional<double> scale;
  Json more = Json::object();
  std::vector<std::string> lines;  // of the table for people
  eval::Plot plot;
};

std::string table_line(const char* name, const eval::Statistics& s, const char* unit) {
  char text[200];
  std::snprintf(text, sizeof text, "%-14s %11.6f %11.6f %11.6f %11.6f %11.6f %11.6f  %s", name,
                s.rmse, s.mean, s.median, s.std, s.min, s.max, unit);
  return text;
}

std::string format(const char* pattern, double a, double b = 0.0) {
  char text[200];
  std::snprintf(text, sizeof text, pattern, a, b);
  return text;
}

Json to_json(const eval::Statistics& s) {
  return {{"rmse", s.rmse}, {"mean", s.mean}, {"median", s.median},
          {"std", s.std},   {"min", s.min},   {"max", s.max}};
}

EvalJob make_job(const EvalFlags& flags) {
  EvalJob job;
  job.flags = flags;
  if (flags.format == "tum") job.reading.format = eval::TrajectoryFormat::kTum;
  if (flags.format == "kitti") job.reading.format = eval::TrajectoryFormat::kKitti;
  job.reading.times_path = flags.times;
  job.reading.sort = flags.sort;
  job.association.max_difference = flags.max_dt;
  job.association.offset = flags.offset;
  const std::string align = !flags.align.empty()    ? flags.align
                            : flags.metric == "ate" ? "se3"
                                                    : "none";
  if (align == "se3") job.alignment = eval::Alignment::kSE3;
  if (align == "sim3") job.alignment = eval::Alignment::kSim3;
  job.rpe.delta = flags.delta;
  if (flags.unit == "s") job.rpe.unit = eval::RpeUnit::kSeconds;
  if (flags.unit == "m") job.rpe.unit = eval::RpeUnit::kMetres;
  if (flags.all_pairs) job.rpe.pairs = eval::RpePairs::kAll;
  if (flags.consecutive) job.rpe.pairs = eval::RpePairs::kConsecutive;
  job.rpe.alignment = job.alignment;
  job.rpe.association = job.association;
  try {
    job.reading.validate();
    job.rpe.validate();
  } catch (const InvalidArgument& error) {
    throw CLI::ValidationError("eval", error.what());
  }
  return job;
}

void add_scale(Outcome& outcome, const EvalJob& job, const eval::AlignmentResult& alignment) {
  if (job.alignment == eval::Alignment::kSim3) outcome.scale = alignment.truth_from_estimate.scale;
}

Outcome run_ate(const EvalJob& job, const Trajectory& truth, const Trajectory& estimate) {
  const eval::AteResult result = eval::ate(truth, estimate, {job.alignment, job.association});
  Outcome outcome;
  outcome.statistics = result.error;
  outcome.coverage = result.coverage;
  add_scale(outcome, job, result.alignment);
  outcome.more["alignment_status"] = std::string(to_string(result.alignment.status));
  outcome.lines = {table_line("ATE", result.error, "m")};
  outcome.plot = eval::error_lines_plot(truth, result, "estimate");
  outcome.plot.title = format("ATE RMSE %.6g m", result.error.rmse);
  return outcome;
}

Outcome run_rpe(const EvalJob& job, const Trajectory& truth, const Trajectory& estimate) {
  const eval::RpeResult result = eval::rpe(truth, estimate, job.rpe);
  Outcome outcome;
  outcome.statistics = result.translation;
  outcome.coverage = result.coverage;
  add_scale(outcome, job, result.alignment);
  outcome.more["rotation_deg"] = to_json(result.rotation_deg);
  outcome.more["delta"] = job.flags.delta;
  outcome.more["unit"] = job.flags.unit;
  outcome.lines = {table_line("RPE", result.translation, "m"),
                   table_line("RPE rotation", result.rotation_deg, "deg")};
  outcome.plot = eval::rpe_over_time_plot(truth, result);
  outcome.plot.title = format("RPE RMSE %.6g m", result.translation.rmse);
  return outcome;
}

Outcome run_kitti(const EvalJob& job, const Trajectory& truth, const Trajectory& estimate) {
  eval::KittiOptions options;
  options.alignment = job.alignment;
  options.association = job.association;
  const eval::KittiResult result = eval::kitti_metric(truth, estimate, options);
  std::vector<double> percents;
  for (const eval::KittiSegment& s : result.segments) percents.push_back(s.translation_percent);
  Outcome outcome;
  outcome.statistics = eval::statistics(percents);
  outcome.coverage = result.coverage;
  outcome.more["translation_percent"] = result.all.translation_percent;
  outcome.more["rotation_deg_per_100m"] = result.all.rotation_deg_per_100m;
  outcome.more["by_length"] = Json::array();
  outcome.lines = {table_line("translation", outcome.statistics, "%"),
                   format("KITTI: %.4f %%, %.4f deg/100 m", result.all.translation_percent,
                          result.all.rotation_deg_per_100m)};
  for (const eval::KittiMean& mean : result.by_length) {
    outcome.more["by_length"].push_back({{"length", mean.length},
                                         {"translation_percent", mean.translation_percent},
                                         {"rotation_deg_per_100m", mean.rotation_deg_per_100m},
                                         {"count", mean.count}});
  }
  outcome.plot = eval::kitti_by_length_plot(result);
  outcome.plot.title = format("KITTI %.4g %%, %.4g deg/100 m", result.all.translation_percent,
                              result.all.rotation_deg_per_100m);
  return outcome;
}

void require_pairs(const EvalJob& job, const Outcome& outcome) {
  if (outcome.coverage.pairs == 0) {
    throw IoError(job.flags.estimate + ": no pose lies within " + format("%g", job.flags.max_dt) +
                  " s of a pose of " + job.flags.truth +
                  ", expected both on the same clock (see --offset and --max-dt)");
  }
  if (outcome.statistics.count == 0) {
    const std::string unit = job.flags.unit == "f" ? "frames" : job.flags.unit;
    const std::string step = job.flags.metric == "kitti"
                                 ? "100 m, the shortest stretch of KITTI's metric"
                                 : format("%g ", job.flags.delta) + unit;
    throw IoError(job.flags.estimate + ": no pair of poses among " +
                  std::to_string(outcome.coverage.pairs) + " associated ones, expected some " +
                  step + " apart");
  }
}

void print_json(const EvalJob& job, const Outcome& outcome) {
  Json json = to_json(outcome.statistics);
  json["pairs"] = outcome.statistics.count;
  json["align"] = std::string(to_string(job.alignment));
  json["metric"] = job.flags.metric;
  json.update(outcome.more);
  if (outcome.scale) json["scale"] = *outcome.scale;
  json["associated"] = outcome.coverage.pairs;
  json["coverage"] = outcome.coverage.time_share;
  std::cout << json.dump(2) << '\n';
}

void print_table(const EvalJob& job, const Outcome& outcome) {
  std::printf(
      "%zu of %zu poses associated, %.1f %% of the truth's time covered, alignment %s, %zu pairs",
      outcome.coverage.pairs, outcome.coverage.estimate_poses, 100.0 * outcome.coverage.time_share,
      std::string(to_string(job.alignment)).c_str(), outcome.statistics.count);
  if (outcome.scale) std::printf(", scale %.6f", *outcome.scale);
  std::printf("\n%-14s %11s %11s %11s %11s %11s %11s\n", "", "rmse", "mean", "median", "std", "min",
              "max");
  for (const std::string& line : outcome.lines) std::printf("%s\n", line.c_str());
}

int run_eval(const EvalJob& job) {
  eval::ReadTrajectoryOptions reading_truth = job.reading;
  reading_truth.drop_repeated = true;
  const Trajectory truth = eval::read_trajectory(job.flags.truth, reading_truth);
  const Trajectory estimate = eval::read_trajectory(job.flags.estimate, job.reading);
  const Outcome outcome = job.flags.metric == "ate"   ? run_ate(job, truth, estimate)
                          : job.flags.metric == "rpe" ? run_rpe(job, truth, estimate)
                                                      : run_kitti(job, truth, estimate);
  require_pairs(job, outcome);
  // Before the figures, so that a failure leaves nothing half said on stdout.
  if (!job.flags.plot.empty()) eval::write_plot(job.flags.plot, outcome.plot);
  if (job.flags.json) {
    print_json(job, outcome);
  } else {
    print_table(job, outcome);
  }
  return 0;
}

}  // namespace

CLI::App* add_eval_command(CLI::App& app, std::function<int()>& run) {
  auto flags = std::make_shared<EvalFlags>();
  CLI::App* eval = app.add_subcommand("eval", "errors of an estimated trajectory: ATE, RPE, KITTI");
  eval->footer(kFooter);
  eval->add_option("METRIC", flags->metric, "ate, rpe or kitti")
      ->required()
      ->check(CLI::IsMember({"ate", "rpe", "kitti"}));
  eval->add_option("TRUTH", flags->truth, "file of the true trajectory")->required();
  eval->add_option("ESTIMATE", flags->estimate, "file of the estimated trajectory")->required();
  eval->add_option("--format", flags->format, "of both files; default: told from the first row")
      ->check(CLI::IsMember({"tum", "kitti"}));
  eval->add_option("--times", flags->times, "timestamps of KITTI files, one a row, in seconds");
  eval->add_option("--align", flags->align, "se3, sim3 or none; default se3 for ate, else none")
      ->check(CLI::IsMember({"se3", "sim3", "none"}));
  CLI::Option* delta =
      eval->add_option("--delta", flags->delta, "step of rpe")->capture_default_str();
  CLI::Option* unit = eval->add_option("--unit", flags->unit, "of the step: f(rames), s, m")
                          ->check(CLI::IsMember({"f", "s", "m"}))
                          ->capture_default_str();
  CLI::Option* all = eval->add_flag("--all-pairs", flags->all_pairs,
                                    "rpe: a pair begins at every pose (default for seconds)");
  CLI::Option* consecutive =
      eval->add_flag("--consecutive", flags->consecutive,
                     "rpe: pairs stand end to end (default for frames and metres)")
          ->excludes(all);
  eval->add_option("--max-dt", flags->max_dt, "largest time between associated poses, seconds")
      ->capture_default_str();
  eval->add_option("--offset", flags->offset, "added to the estimate's times, seconds")
      ->capture_default_str();
  eval->add_flag("--sort", flags->sort, "accept rows out of order of time");
  eval->add_flag("--json", flags->json, "one JSON object on stdout, nothing else");
  eval->add_option("--plot", flags->plot,
                   "writes an SVG (needs gnuplot): map with errors, RPE over time or % by length");
  eval->callback([=, &run] {
    for (const CLI::Option* option : {delta, unit, all, consecutive}) {
      if (flags->metric != "rpe" && option->count() > 0) {
        throw CLI::ValidationError(option->get_name(), "only rpe has steps");
      }
    }
    const EvalJob job = make_job(*flags);
    run = [job] { return run_eval(job); };
  });
  return eval;
}

}  // namespace dynslam::cli
