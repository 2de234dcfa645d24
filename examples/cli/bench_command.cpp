// dynslam bench: the built benchmarks, run briefly, as one table with the rivals beside ours.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>
#include <set>
#include <sstream>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>
#include <unistd.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/version.hpp"

#include "bench_names.hpp"
#include "child_process.hpp"
#include "commands.hpp"
#include "progress.hpp"
#include "run_output.hpp"

namespace dynslam::cli {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

struct BenchFlags {
  std::string filter;
  fs::path programs;
  double seconds = 0.05;
  bool json = false;
};

// Times of one thing, ours and the others', in one unit.
struct Case {
  std::string room, name, unit;
  std::vector<std::pair<std::string, double>> ours, rivals;  // as they were met
  double floor = std::nan("");
};

struct BenchRun {
  std::vector<Case> cases;
  std::vector<std::string> problems;
  Json context;
};

// <room>_<name>_bench
std::string room_of(const fs::path& program) {
  const std::string name = program.filename().string();
  return name.substr(0, name.find('_'));
}

std::vector<fs::path> programs_in(const fs::path& folder) {
  std::vector<fs::path> found;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    const std::string name = entry.path().filename().string();
    const bool named = name.size() > 6 && name.compare(name.size() - 6, 6, "_bench") == 0;
    if (named && entry.is_regular_file(error)) found.push_back(entry.path());
  }
  std::sort(found.begin(), found.end());
  return found;
}

// Beside this program in its own build, or in the build that the preset `bench` makes.
std::vector<fs::path> find_programs(const BenchFlags& flags) {
  std::vector<fs::path> folders = {flags.programs};
  if (flags.programs.empty()) {
    std::error_code error;
    const fs::path build = fs::read_symlink("/proc/self/exe", error).parent_path() / ".." / "..";
    folders = {build / "benchmarks", build / ".." / "bench" / "benchmarks",
               fs::path("build") / "bench" / "benchmarks"};
  }
  for (const fs::path& folder : folders) {
    std::vector<fs::path> found = programs_in(folder);
    if (!found.empty()) return found;
  }
  throw_io_error(flags.programs.empty() ? "bench" : flags.programs.string(),
                 "no benchmark programs; build them with `cmake --preset bench && cmake --build "
                 "--preset bench`, or name their folder with --programs");
}

double in_unit(double value, const std::string& from, const std::string& to) {
  static const std::map<std::string, double> kNanoseconds = {
      {"ns", 1.0}, {"us", 1e3}, {"ms", 1e6}, {"s", 1e9}};
  return value * kNanoseconds.at(from) / kNanoseconds.at(to);
}

Case& case_of(std::vector<Case>& cases, const std::string& room, const std::string& what,
              const std::string& unit) {
  for (Case& known : cases) {
    if (known.room == room && known.name == what) return known;
  }
  cases.push_back({room, what, unit, {}, {}});
  return cases.back();
}

void add_result(BenchRun& run, const std::string& room, const Json& result) {
  if (result.value("run_type", "iteration") != "iteration") return;
  const auto name = result.at("name").get<std::string>();
  if (result.value("error_occurred", false)) {
    run.problems.push_back(room + "/" + name + ": " + result.value("error_message", "failed"));
    return;
  }
  const bool wall = name.find("/real_time") != std::string::npos ||
                    name.find("/manual_time") != std::string::npos;
  const auto unit = result.at("time_unit").get<std::string>();
  const auto time = result.at(wall ? "real_time" : "cpu_time").get<double>();
  const BenchName parts = bench_name(room, name);
  Case& entry = case_of(run.cases, room, parts.what, unit);
  const double value = in_unit(time, unit, entry.unit);
  if (parts.rival.empty()) {
    entry.ours.emplace_back(parts.target, value);
  } else if (parts.rival == "floor") {
    entry.floor = value;
  } else {
    entry.rivals.emplace_back(parts.rival, value);
  }
  // Timed by turns with ours, in the same benchmark.
  if (result.contains("cv_ms")) {
    entry.rivals.emplace_back("cv::ORB", in_unit(result["cv_ms"].get<double>(), "ms", entry.unit));
  }
}

// "features", "features/BruteForce" or "BruteForce": a room, a part of a case's name, or both.
struct Filter {
  std::string room, name;
};
Filter split(const std::string& text, const std::vector<fs::path>& programs) {
  const std::size_t slash = text.find('/');
  const std::string first = text.substr(0, slash);
  const bool is_room = std::any_of(programs.begin(), programs.end(),
                                   [&](const fs::path& p) { return room_of(p) == first; });
  if (!is_room) return {"", text};
  return {first, slash == std::string::npos ? "" : text.substr(slash + 1)};
}

std::string escaped(const std::string& name) {
  std::string pattern;
  for (const char c : name) {
    if (std::string("\\^$.|?*+()[]{}").find(c) != std::string::npos) pattern += '\\';
    pattern += c;
  }
  return pattern;
}

// A pattern of the program's benchmarks whose case or own name holds the text, with all that they
// are compared with; empty if there is none.
std::string pattern_of(const fs::path& program, const std::string& text) {
  std::istringstream list(output_of({program.string(), "--benchmark_list_tests"}));
  std::vector<std::pair<std::string, std::string>> names;  // own, of the case
  std::set<std::string> wanted;
  for (std::string name; std::getline(list, name);) {
    names.emplace_back(name, bench_name(room_of(program), name).what);
    const bool holds =
        name.find(text) != std::string::npos || names.back().second.find(text) != std::string::npos;
    if (holds) wanted.insert(names.back().second);
  }
  std::string pattern;
  for (const auto& [name, what] : names) {
    if (wanted.count(what) > 0) pattern += (pattern.empty() ? "^(" : "|") + escaped(name);
  }
  return pattern.empty() ? pattern : pattern + ")$";
}

void run_program(BenchRun& run, const fs::path& program, const std::string& filter,
                 double seconds) {
  const std::string pattern = filter.empty() ? "." : pattern_of(program, filter);
  if (pattern.empty()) return;
  const Json report = Json::parse(output_of({program.string(), "--benchmark_format=json",
                                             "--benchmark_min_time=" + std::to_string(seconds),
                                             "--benchmark_filter=" + pattern}));
  run.context = report.at("context");
  for (const Json& result : report.at("benchmarks")) add_result(run, room_of(program), result);
}

BenchRun run_programs(const BenchFlags& flags) {
  const std::vector<fs::path> programs = find_programs(flags);
  const Filter filter = split(flags.filter, programs);
  BenchRun run;
  Progress progress("bench", programs.size());
  for (std::size_t i = 0; i < programs.size(); ++i) {
    progress.update(i, programs[i].filename().string());
    if (!filter.room.empty() && room_of(programs[i]) != filter.room) continue;
    try {
      run_program(run, programs[i], filter.name, flags.seconds);
    } catch (const std::exception& error) {
      run.problems.push_back(programs[i].filename().string() + ": " + error.what());
    }
  }
  return run;
}

Json to_json(const BenchRun& run) {
  Json json = {{"version", kVersion},
               {"machine",
                {{"cores", run.context.value("num_cpus", 0)},
                 {"mhz", run.context.value("mhz_per_cpu", 0)},
                 {"load", run.context.value("load_avg", Json::array())}}},
               {"cases", Json::array()}};
  const auto object = [](const std::vector<std::pair<std::string, double>>& times) {
    Json all = Json::object();
    for (const auto& [name, value] : times) all[name] = number(value);
    return all;
  };
  for (const Case& entry : run.cases) {
    json["cases"].push_back({{"room", entry.room},
                             {"name", entry.name},
                             {"unit", entry.unit},
                             {"ours", object(entry.ours)},
                             {"rivals", object(entry.rivals)},
                             {"floor", number(entry.floor)}});
  }
  if (!run.problems.empty()) json["problems"] = run.problems;
  return json;
}

std::string listed(const std::vector<std::pair<std::string, double>>& times) {
  std::string text;
  char value[32];
  for (const auto& [name, time] : times) {
    std::snprintf(value, sizeof value, "%.4g", time);
    text += (text.empty() ? "" : ", ") + (name == "best" ? "" : name + " ") + value;
  }
  return text;
}

void print(const BenchRun& run) {
  std::printf("%-12s  %-36s  %-4s  %-24s  rivals\n", "room", "case", "unit", "ours");
  for (const Case& entry : run.cases) {
    std::printf("%-12s  %-36s  %-4s  %-24s  %s", entry.room.c_str(), entry.name.c_str(),
                entry.unit.c_str(), listed(entry.ours).c_str(), listed(entry.rivals).c_str());
    if (!std::isnan(entry.floor)) std::printf("  (floor %.4g)", entry.floor);
    std::printf("\n");
  }
}

int run(const BenchFlags& flags) {
  const BenchRun result = run_programs(flags);
  if (result.cases.empty()) {
    if (!result.problems.empty()) throw IoError(result.problems.front());
    throw_invalid_argument("bench", "FILTER", flags.filter, "a room, or a part of a case's name");
  }
  if (flags.json) {
    std::cout << to_json(result).dump(2) << '\n';
  } else {
    print(result);
    for (const std::string& problem : result.problems) {
      std::cerr << "dynslam: not timed: " << problem << '\n';
    }
  }
  return 0;
}

}  // namespace

CLI::App* add_bench_command(CLI::App& app, std::function<int()>& work) {
  auto flags = std::make_shared<BenchFlags>();
  CLI::App* command = app.add_subcommand("bench", "run the built benchmarks briefly, as one table");
  command->footer(
      "Times are of one thread unless the name says otherwise, too short for fine differences;\n"
      "benchmarks/ROOM/BENCHMARK.md has the careful ones.\n"
      "Example:\n  dynslam bench features\n  dynslam bench features/BruteForce --json");
  command->add_option("FILTER", flags->filter,
                      "a room, a part of a case's name, or ROOM/NAME; default: all");
  command->add_option("--programs", flags->programs, "folder of the benchmark programs")
      ->type_name("DIR");
  command->add_option("--seconds", flags->seconds, "least time for each benchmark")
      ->check(CLI::Range(0.001, 60.0))
      ->capture_default_str();
  command->add_flag("--json", flags->json, "print one JSON object");
  command->callback([flags, &work] { work = [flags] { return run(*flags); }; });
  return command;
}

}  // namespace dynslam::cli
