// dynslam scene: writes the rendered scene as a folder in TUM layout.
#include <filesystem>
#include <iostream>
#include <memory>
#include <string>

#include <nlohmann/json.hpp>

#include "dynslam/dataset/scene.hpp"
#include "dynslam/dataset/tum_writer.hpp"

#include "commands.hpp"
#include "progress.hpp"

namespace dynslam::cli {
namespace {

struct SceneFlags {
  std::string name = "room_walking";
  std::filesystem::path out;
  dataset::SceneOptions scene;
  bool overwrite = false;
  bool json = false;
};

int write_scene(const SceneFlags& flags) {
  const std::unique_ptr<dataset::Sequence> scene = dataset::make_scene(flags.name, flags.scene);
  dataset::TumWriterOptions options;
  options.fps = scene->fps();
  options.overwrite = flags.overwrite;
  dataset::TumWriter writer(flags.out, scene->camera(), options);
  {
    Progress progress("rendering", scene->size());
    for (std::size_t i = 0; i < scene->size(); ++i) {
      writer.add(scene->read(i));
      progress.update(i + 1);
    }
  }
  writer.finish();
  if (flags.json) {
    const nlohmann::ordered_json report = {{"scene", flags.name},
                                           {"frames", scene->size()},
                                           {"seed", flags.scene.seed},
                                           {"out", flags.out.string()}};
    std::cout << report.dump(2) << '\n';
  } else {
    std::cout << scene->size() << " frames of " << flags.name << " in " << flags.out.string()
              << '\n';
  }
  return 0;
}

}  // namespace

CLI::App* add_scene_command(CLI::App& app, std::function<int()>& run) {
  auto flags = std::make_shared<SceneFlags>();
  CLI::App* command = app.add_subcommand("scene", "write a rendered scene in TUM layout");
  command->footer("Example:\n  dynslam scene room_walking --out scene --frames 300 --seed 2");
  command->add_option("NAME", flags->name, "room_walking or room_still")->capture_default_str();
  command->add_option("--out", flags->out, "folder to write")->required()->type_name("DIR");
  command->add_option("--seed", flags->scene.seed, "of room, paths and noise")
      ->capture_default_str();
  command->add_option("--frames", flags->scene.frames, "length")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  command->add_option("--threads", flags->scene.threads, "threads that render")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
  command->add_flag("--overwrite", flags->overwrite, "replace a sequence that is there");
  command->add_flag("--json", flags->json, "print one JSON object");
  command->callback([flags, &run] { run = [flags] { return write_scene(*flags); }; });
  return command;
}

}  // namespace dynslam::cli
