#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/evaluation/metrics.hpp"

#include "commands.hpp"
#include "loops_session.hpp"

namespace dynslam::cli {
namespace {

using json = nlohmann::json;

json report_of(const LoopsOutcome& outcome) {
  const evaluation::LoopScores& scores = outcome.scores;
  json refused = json::object();
  for (std::size_t i = 0; i < loop::kLoopReasons; ++i) {
    const auto reason = static_cast<loop::LoopReason>(i);
    if (reason != loop::LoopReason::kLoop && outcome.reasons[i] > 0)
      refused[std::string(loop::to_string(reason))] = outcome.reasons[i];
  }
  json report = {{"queries", scores.queries},
                 {"loops_true", scores.loops_true},
                 {"detected", scores.detected},
                 {"correct", scores.correct},
                 {"precision", scores.precision},
                 {"recall", scores.recall},
                 {"recall_at_100p", scores.recall_at_full_precision},
                 {"unjudged", outcome.unjudged},
                 {"ms",
                  {{"median", evaluation::quantile(outcome.ms, 0.5)},
                   {"p95", evaluation::quantile(outcome.ms, 0.95)},
                   {"extract", evaluation::quantile(outcome.extract_ms, 0.5)}}},
                 {"refused", refused},
                 {"vocabulary", {{"words", outcome.words}, {"source", outcome.vocabulary}}}};
  if (!outcome.pose_errors.empty()) {
    report["pose_error"] = {{"median_m", evaluation::quantile(outcome.pose_errors, 0.5)},
                            {"max_m", evaluation::quantile(outcome.pose_errors, 1.0)}};
  }
  return report;
}

void print_text(const LoopsOutcome& outcome, const json& report) {
  std::printf("vocabulary      %s, %zu words\n", outcome.vocabulary.c_str(), outcome.words);
  std::printf("queries         %zu, of which %zu are true loops\n", outcome.scores.queries,
              outcome.scores.loops_true);
  std::printf("detected        %zu, %zu right", outcome.scores.detected, outcome.scores.correct);
  if (outcome.unjudged > 0) std::printf("; %zu more that truth leaves open", outcome.unjudged);
  std::printf("\nprecision       %.3f\nrecall          %.3f\nrecall at 100 %% %.3f\n",
              outcome.scores.precision, outcome.scores.recall,
              outcome.scores.recall_at_full_precision);
  std::printf("ms an image     %.2f median, %.2f at 95 %%, besides %.2f for features\n",
              evaluation::quantile(outcome.ms, 0.5), evaluation::quantile(outcome.ms, 0.95),
              evaluation::quantile(outcome.extract_ms, 0.5));
  if (report.contains("pose_error")) {
    std::printf("pose error      %.3f m median, %.3f m at most\n",
                evaluation::quantile(outcome.pose_errors, 0.5),
                evaluation::quantile(outcome.pose_errors, 1.0));
  }
  for (const auto& [reason, count] : report["refused"].items())
    std::printf("refused         %5zu %s\n", count.get<std::size_t>(), reason.c_str());
}

}  // namespace

CLI::App* add_loops_command(CLI::App& app, std::function<int()>& run) {
  auto options = std::make_shared<LoopsOptions>();
  auto as_json = std::make_shared<bool>(false);
  CLI::App* command = app.add_subcommand("loops", "detect loops and score them against truth");
  command->footer(
      "Examples: dynslam loops IMAGES --truth IMAGES/samples_GT.bmp --json\n"
      "          dynslam loops --tum DIR --vocabulary ORBvoc.txt\n"
      "Row q of the truth is white at the earlier images of the same place. With --tum truth "
      "comes\n"
      "from poses and depth: at least half of the view shared, after the camera had looked\n"
      "elsewhere.");
  command->add_option("images", options->images,
                      "folder of images (in the order of the numbers in their names), or images");
  CLI::Option* truth =
      command->add_option("--truth", options->truth, "image of one row and column an image");
  CLI::Option* tum =
      command->add_option("--tum", options->tum, "recording in TUM RGB-D layout with poses");
  tum->excludes(truth);
  command->add_option("--vocabulary", options->vocabulary,
                      "any format; without it one is trained on the images themselves");
  command->add_option("--features", options->features, "ORB features an image")
      ->check(CLI::Range(50, 100000))
      ->capture_default_str();
  command
      ->add_option("--exclude-recent", options->exclude_recent,
                   "images just before the query that are no candidates (with IMAGES)")
      ->capture_default_str();
  command->add_flag("--no-geometry", options->no_geometry, "accept loops by their words alone");
  command->add_option("--detections", options->detections, "write a line for each query to a file");
  command->add_flag("--json", *as_json, "print one JSON object and nothing else");
  command->callback([options, as_json, &run] {
    if (options->tum.empty() && options->truth.empty())
      throw CLI::ValidationError("loops", "give IMAGES and --truth MATRIX.bmp, or --tum DIR");
    if (options->tum.empty() == options->images.empty())
      throw CLI::ValidationError("loops",
                                 "give either IMAGES and --truth MATRIX.bmp, or --tum DIR");
    run = [options, as_json] {
      const LoopsOutcome outcome = run_loops(*options);
      const json report = report_of(outcome);
      if (*as_json) {
        std::cout << report.dump() << '\n';
      } else {
        print_text(outcome, report);
      }
      return 0;
    };
  });
  return command;
}

}  // namespace dynslam::cli
