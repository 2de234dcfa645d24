#include "sequences.hpp"

#include <charconv>
#include <cmath>
#include <iostream>
#include <limits>
#include <optional>
#include <vector>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/readers.hpp"
#include "dynslam/dataset/scene.hpp"

#include "checks.hpp"

namespace dynslam::cli {
namespace {

constexpr double kSceneBaseline = 0.12;  // metres, as in common stereo cameras

std::vector<double> parse_numbers(const std::string& flag, const std::string& text,
                                  char separator) {
  std::vector<double> numbers;
  const char* at = text.data();
  const char* const end = at + text.size();
  while (true) {
    double number = 0.0;
    const auto [rest, error] = std::from_chars(at, end, number);
    require(error == std::errc() && (rest == end || *rest == separator), flag, "value", text,
            std::string("numbers separated by '") + separator + "'");
    numbers.push_back(number);
    if (rest == end) return numbers;
    at = rest + 1;
  }
}

std::optional<DepthCamera> parse_camera(const std::string& text) {
  if (text.empty()) return std::nullopt;
  const std::vector<double> numbers = parse_numbers("--camera", text, ',');
  const auto positive = [](double number) { return std::isfinite(number) && number > 0.0; };
  require(numbers.size() == 4 && positive(numbers[0]) && positive(numbers[1]) &&
              std::isfinite(numbers[2]) && std::isfinite(numbers[3]),
          "--camera", "value", text, "FX,FY,CX,CY in pixels, FX and FY positive");
  DepthCamera camera;
  camera.fx = numbers[0];
  camera.fy = numbers[1];
  camera.cx = numbers[2];
  camera.cy = numbers[3];
  camera.bf = 40.0 / 525.0 * camera.fx;
  return camera;
}

struct Range {
  std::size_t first = 0;
  std::size_t last = std::numeric_limits<std::size_t>::max();
};

Range parse_range(const std::string& text) {
  Range range;
  if (text.empty()) return range;
  const std::size_t colon = text.find(':');
  const auto number = [&](std::size_t from, std::size_t to, std::size_t otherwise) {
    if (from == to) return otherwise;
    std::size_t value = 0;
    const auto [rest, error] = std::from_chars(text.data() + from, text.data() + to, value);
    require(error == std::errc() && rest == text.data() + to, "--frames", "value", text,
            "FIRST:LAST, frame numbers from 0, LAST not included");
    return value;
  };
  require(colon != std::string::npos, "--frames", "value", text, "FIRST:LAST");
  range.first = number(0, colon, 0);
  range.last = number(colon + 1, text.size(), range.last);
  require(range.first < range.last, "--frames", "value", text, "FIRST below LAST");
  return range;
}

std::unique_ptr<dataset::Sequence> open_scene(const SequenceFlags& flags, const Range& range) {
  dataset::SceneOptions options;
  options.seed = flags.seed;
  if (flags.stereo) options.stereo_baseline = kSceneBaseline;
  if (range.last != std::numeric_limits<std::size_t>::max()) options.frames = range.last;
  return dataset::make_scene(flags.scene, options);
}

std::unique_ptr<dataset::Sequence> open_whole(const SequenceFlags& flags, const Range& range) {
  if (!flags.scene.empty() || !flags.euroc.empty()) {
    require(flags.camera.empty(), "--camera", "value", flags.camera,
            "none: scenes and EuRoC folders say what their camera is");
  }
  if (!flags.scene.empty()) return open_scene(flags, range);
  if (!flags.kitti.empty()) {
    dataset::KittiOptions options;
    options.camera = parse_camera(flags.camera);
    options.skip_disordered = true;
    return dataset::open_kitti(flags.kitti, options);
  }
  if (!flags.euroc.empty()) {
    dataset::EurocOptions options;
    options.skip_disordered = true;
    return dataset::open_euroc(flags.euroc, options);
  }
  dataset::TumOptions options;
  options.camera = parse_camera(flags.camera);
  if (flags.depth_scale != 0.0) options.depth_scale = flags.depth_scale;
  options.skip_disordered = true;
  return dataset::open_tum(flags.tum, options);
}

}  // namespace

void SequenceFlags::add_to(CLI::App& command) {
  CLI::Option_group* const source = command.add_option_group("input", "one of");
  source->add_option("--tum", tum, "folder in TUM RGB-D layout")->type_name("DIR");
  source->add_option("--kitti", kitti, "folder in KITTI odometry layout")->type_name("DIR");
  source->add_option("--euroc", euroc, "folder in EuRoC layout")->type_name("DIR");
  source->add_option("--scene", scene, "rendered scene: room_walking, room_still")
      ->type_name("NAME");
  source->require_option(1);
  add_companions_to(command);
}

void SequenceFlags::add_companions_to(CLI::App& command) {
  command.add_option("--camera", camera, "FX,FY,CX,CY in pixels; default: the folder's own")
      ->check(readable_by(parse_camera));
  command.add_option("--depth-scale", depth_scale, "units of the depth image a metre (TUM: 5000)")
      ->check(CLI::Range(1e-3, 1e9));
  command.add_option("--frames", frames, "FIRST:LAST, from 0, LAST not included; default: all")
      ->check(readable_by(parse_range));
  command.add_option("--seed", seed, "seed of a rendered scene")->capture_default_str();
}

std::unique_ptr<dataset::Sequence> open_sequence(const SequenceFlags& flags) {
  const Range range = parse_range(flags.frames);
  std::unique_ptr<dataset::Sequence> whole = open_whole(flags, range);
  if (flags.frames.empty()) return whole;
  require(range.first < whole->size(), "--frames", "value", flags.frames,
          "FIRST below " + std::to_string(whole->size()) + ", which is how many frames there are");
  return dataset::slice(std::move(whole), range.first, range.last);
}

void tell_left_out(const dataset::Sequence& sequence) {
  const dataset::OpenReport report = sequence.report();
  if (report.disordered_frames == 0) return;
  std::cerr << "dynslam: " << report.disordered_frames
            << " frames left out because time ran backwards, first " << report.first_disordered
            << '\n';
}

}  // namespace dynslam::cli
