// dynslam ablate: every system and what is left of it without each of its parts, in one table.
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include <unistd.h>

#include "ablation.hpp"
#include "ablation_output.hpp"
#include "commands.hpp"
#include "mask_source.hpp"

namespace dynslam::cli {
namespace {

struct AblateFlags {
  std::vector<std::string> tum, kitti, euroc, scenes;
  SequenceFlags input;  ///< what all sequences share: frames, seed, camera
  AblationPlan plan;
  std::filesystem::path out;
  bool json = false;
};

std::vector<SequenceFlags> sequences_of(const AblateFlags& flags) {
  std::vector<SequenceFlags> sequences;
  const auto add = [&](const std::vector<std::string>& names, std::string SequenceFlags::*member) {
    for (const std::string& name : names) {
      sequences.push_back(flags.input);
      sequences.back().*member = name;
    }
  };
  add(flags.tum, &SequenceFlags::tum);
  add(flags.kitti, &SequenceFlags::kitti);
  add(flags.euroc, &SequenceFlags::euroc);
  add(flags.scenes, &SequenceFlags::scene);
  return sequences;
}

int run(AblateFlags flags) {
  flags.plan.sequences = sequences_of(flags);
  const bool terminal = isatty(STDERR_FILENO) != 0;
  const auto start = std::chrono::steady_clock::now();
  std::size_t skipped = 0, begun = 0;
  const std::vector<Cell> cells = run_ablation(
      flags.plan, flags.out, [&](const Cell& cell, std::size_t done, std::size_t total) {
        if (!terminal) return;
        if (begun++ == 0) skipped = done;
        const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - start;
        const double left = done > skipped ? spent.count() / static_cast<double>(done - skipped) *
                                                 static_cast<double>(total - done)
                                           : 0.0;
        std::fprintf(stderr, "[%zu/%zu] %s on %s, %.0f s left\n", done + 1, total,
                     cell.label().c_str(), cell.sequence.c_str(), left);
      });
  write_ablation(flags.out, flags.plan, cells);
  if (flags.json) {
    std::cout << ablation_json(flags.plan, cells).dump(2) << '\n';
  } else {
    std::cout << ablation_table(cells) << (flags.out / "ablation.html").string() << '\n';
  }
  return 0;
}

}  // namespace

CLI::App* add_ablate_command(CLI::App& app, std::function<int()>& work) {
  auto flags = std::make_shared<AblateFlags>();
  CLI::App* command =
      app.add_subcommand("ablate", "run every system, whole and without each part, as one table");
  command->footer(
      "Finished runs are kept in OUT/cells; the same command goes on where it was stopped.\n"
      "Example:\n  dynslam ablate --tum kitchen_walking --tum kitchen_people --async \\\n"
      "      --segmenter yolo-seg:yolov5n-seg.onnx --runs 5 --out ablation");
  CLI::Option_group* const sources = command->add_option_group("input", "one or more of");
  sources->add_option("--tum", flags->tum, "folder in TUM RGB-D layout")->type_name("DIR");
  sources->add_option("--kitti", flags->kitti, "folder in KITTI odometry layout")->type_name("DIR");
  sources->add_option("--euroc", flags->euroc, "folder in EuRoC layout")->type_name("DIR");
  sources->add_option("--scene", flags->scenes, "rendered scene: room_walking, room_still")
      ->type_name("NAME");
  sources->require_option(1, 0);
  flags->input.add_companions_to(*command);
  flags->plan.systems = slam::composition_names();
  command->add_option("--systems", flags->plan.systems, "which systems")
      ->delimiter(',')
      ->check(CLI::IsMember(slam::composition_names()));
  add_segmenter_flags(*command, flags->plan.run);
  add_tracking_flags(*command, flags->plan.run);
  command->add_option("--runs", flags->plan.runs, "of every cell; scenes get the next seed")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  command->add_option("--out", flags->out, "folder for the results")->required()->type_name("DIR");
  command->add_flag("--json", flags->json, "print ablation.json");
  command->callback([flags, &work] { work = [flags] { return run(*flags); }; });
  return command;
}

}  // namespace dynslam::cli
