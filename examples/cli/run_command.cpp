// dynslam run: a sequence in; a trajectory, a judgement of it and a report out.
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include "dynslam/core/errors.hpp"
#include "dynslam/evaluation/metrics.hpp"

#include "commands.hpp"
#include "interruption.hpp"
#include "mask_source.hpp"
#include "run_output.hpp"
#include "run_session.hpp"
#include "sequences.hpp"

namespace dynslam::cli {
namespace {

using Json = nlohmann::ordered_json;

struct RunCommandFlags {
  SequenceFlags input;
  RunFlags run;
  std::filesystem::path out;
  std::vector<std::string> compare;  ///< further systems, run on the same frames
  bool ablation = false;             ///< the system without each of its parts as well
  int runs = 1;
  bool json = false;
};

// "p-static" or "p-static without mask".
std::string label_of(const Json& summary) {
  std::string label = summary["system"];
  for (const Json& part : summary["without"]) {
    label += (label == summary["system"] ? " without " : ", ") + part.get<std::string>();
  }
  return label;
}

void print_row(const Json& summary) {
  const std::size_t frames = summary["frames"];
  std::printf("%-26s  %5zu / %-5zu  %12.4f  %14.1f\n", label_of(summary).c_str(),
              summary["tracked"].get<std::size_t>(), frames, ate_rmse(summary),
              summary["time_ms"]["frame"]["median"].get<double>());
}

void print_table(const Json& summary) {
  std::printf("%-26s  %13s  %12s  %14s\n", "system", "tracked", "ATE RMSE, m", "ms a frame");
  print_row(summary);
  for (const Json& other : summary["compare"]) print_row(other);
}

void print_summary(const Json& summary) {
  std::printf("%s on %s: %zu of %zu frames tracked", summary["system"].get<std::string>().c_str(),
              summary["sequence"].get<std::string>().c_str(), summary["tracked"].get<std::size_t>(),
              summary["frames"].get<std::size_t>());
  if (!std::isnan(ate_rmse(summary))) std::printf(", ATE RMSE %.4f m", ate_rmse(summary));
  std::printf(", %.1f ms a frame (median)\n", summary["time_ms"]["frame"]["median"].get<double>());
  if (summary.contains("localized_after_frames")) {
    const Json& frames = summary["localized_after_frames"];
    std::printf("%s\n",
                frames.is_null()
                    ? "not found in the loaded map"
                    : ("found in the loaded map after " + frames.dump() + " frames").c_str());
  }
  if (summary.contains("ate_median")) {
    std::printf("median of %zu runs: %.4f m, interquartile range %.4f m\n", summary["runs"].size(),
                summary["ate_median"].get<double>(), summary["ate_iqr"].get<double>());
  }
}

// Several runs: another seed each (of the scene; a recording has none). The last one is written.
void add_runs(Json& summary, const std::vector<Json>& runs) {
  std::vector<double> ates;
  for (const Json& run : runs) {
    summary["runs"].push_back({{"seed", run["seed"]},
                               {"tracked", run["tracked"]},
                               {"frames", run["frames"]},
                               {"ate", run.value("ate", Json(nullptr))},
                               {"time_ms", run["time_ms"]["frame"]}});
    if (!std::isnan(ate_rmse(run))) ates.push_back(ate_rmse(run));
  }
  if (ates.empty()) return;
  summary["ate_median"] = evaluation::quantile(ates, 0.5);
  summary["ate_iqr"] = interquartile_range(ates);
}

// A part that a system does not have cannot be missed: said, not refused.
void note_absent_parts(const RunFlags& flags) {
  const slam::Composition system = slam::composition(flags.system);
  for (const std::string& part : flags.without) {
    if (system.has(slam::part_from_name(part))) continue;
    std::cerr << "dynslam: " << flags.system << " has no " << part << " to switch off\n";
  }
}

// Further systems, and what is left of this one without each of its parts.
std::vector<RunFlags> compared_with(const RunCommandFlags& flags) {
  RunFlags plain = flags.run;
  plain.video.clear();
  plain.show = false;
  std::vector<RunFlags> others;
  for (const std::string& system : flags.compare) {
    others.push_back(plain);
    others.back().system = system;
  }
  if (!flags.ablation) return others;
  for (const slam::Part part : composition_of(plain).parts()) {
    others.push_back(plain);
    others.back().without.emplace_back(to_string(part));
  }
  return others;
}

int run(RunCommandFlags flags) {
  flags.input.stereo = flags.run.sensor == slam::to_string(slam::Sensor::kStereo);
  std::unique_ptr<dataset::Sequence> sequence = open_sequence(flags.input);
  prepare_output(flags.out);
  catch_interruption();
  note_absent_parts(flags.run);
  tell_left_out(*sequence);
  RunOutcome outcome;
  std::vector<Json> summaries;
  for (int i = 0; i < flags.runs && !interrupted(); ++i) {
    if (i > 0 && !flags.input.scene.empty()) {
      ++flags.input.seed;
      sequence = open_sequence(flags.input);
    }
    outcome = run_system(*sequence, flags.run);
    summaries.push_back(summarize(*sequence, flags.run, outcome));
    summaries.back()["seed"] = flags.input.seed;
  }
  Json summary = summaries.back();
  summary["interrupted"] = interrupted();
  if (flags.runs > 1) add_runs(summary, summaries);
  write_run(flags.out, outcome);
  std::vector<evaluation::RunRecord> others;
  for (const RunFlags& other : compared_with(flags)) {
    if (interrupted()) break;
    const RunOutcome compared = run_system(*sequence, other);
    summary["compare"].push_back(summarize(*sequence, other, compared));
    others.push_back(to_record(label_of(summary["compare"].back()), compared));
  }
  const std::string problem = write_html(flags.out, *sequence, flags.run, outcome, others);
  if (!problem.empty()) std::cerr << "dynslam: report without plots: " << problem << '\n';
  write_text(flags.out / "summary.json", summary.dump(2) + "\n");
  for (const std::string& unreadable : outcome.problems) {
    std::cerr << "dynslam: frame skipped: " << unreadable << '\n';
  }
  tell(outcome.unsegmented);
  if (interrupted()) {
    std::cerr << "dynslam: interrupted; " << flags.out.string() << " has what there was\n";
    return 1;
  }
  if (flags.json) {
    std::cout << summary.dump(2) << '\n';
  } else {
    print_summary(summary);
    if (summary.contains("compare")) print_table(summary);
    std::cout << (flags.out / "report.html").string() << '\n';
  }
  return 0;
}

}  // namespace

CLI::App* add_run_command(CLI::App& app, std::function<int()>& work) {
  auto flags = std::make_shared<RunCommandFlags>();
  CLI::App* command = app.add_subcommand("run", "track a sequence and judge the result");
  command->footer(
      "Example:\n  dynslam run --tum rgbd_dataset_freiburg3_walking_xyz --system p-yolo \\\n"
      "      --segmenter yolo-seg:yolov5n-seg.onnx --out out");
  flags->input.add_to(*command);
  RunFlags& run_flags = flags->run;
  command->add_option("--system", run_flags.system, "what handles movers")
      ->check(CLI::IsMember(slam::composition_names()))
      ->capture_default_str();
  command
      ->add_option("--sensor", run_flags.sensor, "what to use; default: all that the frames hold")
      ->check(CLI::IsMember({"rgbd", "stereo", "mono"}));
  add_segmenter_flags(*command, run_flags);
  command->add_option("--without", run_flags.without, "parts of the system to switch off")
      ->delimiter(',')
      ->check(CLI::IsMember(slam::part_names()));
  add_tracking_flags(*command, run_flags);
  command->add_option("--video", run_flags.video, "film of what the system sees, .mp4 or .avi")
      ->type_name("FILE");
  command->add_flag("--show", run_flags.show, "the same in a window");
  CLI::Option* const load =
      command->add_option("--load", run_flags.load, "map.dynslam of an earlier run to start from")
          ->type_name("MAP");
  command->add_flag("--localize-only", run_flags.localize_only, "leave the loaded map as it is")
      ->needs(load);
  command->add_option("--compare", flags->compare, "further systems on the same frames, as a table")
      ->delimiter(',')
      ->check(CLI::IsMember(slam::composition_names()));
  command->add_flag("--ablation", flags->ablation,
                    "run it without each of its parts as well, as a table");
  command->add_option("--runs", flags->runs, "repeat; scenes get the next seed each time")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  command->add_option("--out", flags->out, "folder for the results")->required()->type_name("DIR");
  command->add_flag("--json", flags->json, "print summary.json");
  command->callback([flags, &work] { work = [flags] { return run(*flags); }; });
  return command;
}

}  // namespace dynslam::cli
