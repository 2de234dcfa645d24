#include "run_output.hpp"

#include <cmath>
#include <cstdio>
#include <fstream>
#include <sstream>
#include <string_view>
#include <vector>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"
#include "dynslam/core/version.hpp"
#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/evaluation/trajectory_io.hpp"

#include "memory.hpp"

namespace dynslam::cli {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

std::string printed(const char* pattern, double value) {
  char text[64];
  std::snprintf(text, sizeof text, pattern, value);
  return text;
}

Json to_json(const evaluation::Statistics& s) {
  return {{"rmse", number(s.rmse)}, {"mean", number(s.mean)}, {"median", number(s.median)},
          {"std", number(s.std)},   {"min", number(s.min)},   {"max", number(s.max)}};
}

struct Stage {
  const char* name;
  float (*of)(const FrameRow&);
};

constexpr Stage kStages[] = {
    {"extract", [](const FrameRow& row) { return row.ms.extract; }},
    {"match", [](const FrameRow& row) { return row.ms.match; }},
    {"segment", [](const FrameRow& row) { return row.ms.segment; }},
    {"geometry", [](const FrameRow& row) { return row.ms.geometry; }},
    {"optimize", [](const FrameRow& row) { return row.ms.optimize; }},
    {"map", [](const FrameRow& row) { return row.ms.map; }},
    {"loop", [](const FrameRow& row) { return row.ms.loop; }},
};

Json to_json(const slam::LoopClosure& loop) {
  return {{"query_frame", loop.query_frame},
          {"match_frame", loop.match_frame},
          {"query_time", loop.query_timestamp},
          {"match_time", loop.match_timestamp},
          {"inliers", loop.inliers},
          {"visible", loop.visible},
          {"shared", loop.shared},
          {"moved", number(loop.moved)}};
}

std::vector<double> column(const RunOutcome& outcome, float (*of)(const FrameRow&)) {
  std::vector<double> values;
  for (const FrameRow& row : outcome.rows) {
    if (row.processed()) values.push_back(of(row));
  }
  return values;
}

// Rows keep times as floats; microseconds are what they are good for.
Json milliseconds(double ms) { return number(std::round(ms * 1000.0) / 1000.0); }

Json times(const RunOutcome& outcome) {
  const std::vector<double> whole =
      column(outcome, [](const FrameRow& row) { return row.ms.total; });
  const evaluation::Statistics frame = evaluation::statistics(whole);
  Json json = {{"frame",
                {{"mean", milliseconds(frame.mean)},
                 {"median", milliseconds(frame.median)},
                 {"p95", milliseconds(evaluation::quantile(whole, 0.95))}}}};
  for (const Stage& stage : kStages) {
    const std::vector<double> values = column(outcome, stage.of);
    json[stage.name] = {{"median", milliseconds(evaluation::quantile(values, 0.5))},
                        {"p95", milliseconds(evaluation::quantile(values, 0.95))}};
  }
  return json;
}

Json memory(const RunOutcome& outcome) {
  Json quarters = Json::array();
  for (const double mb : outcome.memory_mb) quarters.push_back(std::round(mb * 10.0) / 10.0);
  return quarters;
}

// A single camera cannot know the scale.
evaluation::Alignment alignment_of(const RunOutcome& outcome) {
  return outcome.system->options().sensor == slam::Sensor::kMono ? evaluation::Alignment::kSim3
                                                                 : evaluation::Alignment::kSE3;
}

void write_frames(const fs::path& path, const RunOutcome& outcome) {
  std::ostringstream out;
  out.imbue(std::locale::classic());
  out << "frame,timestamp,state,features,inliers,masked_share,mask_age,moving_features,"
         "moving_share,rejected_features,keyframe,loops";
  for (const Stage& stage : kStages) out << ',' << stage.name << "_ms";
  out << ",total_ms\n";
  for (const FrameRow& row : outcome.rows) {
    out << row.index << ',' << printed("%.6f", row.timestamp) << ',' << to_string(row.state) << ','
        << row.features << ',' << row.inliers << ',' << printed("%.4f", row.masked_share) << ','
        << row.mask_age << ',' << row.moving_features << ',' << printed("%.4f", row.moving_share)
        << ',' << row.rejected_features << ',' << (row.keyframe ? 1 : 0) << ',' << row.loops;
    for (const Stage& stage : kStages) out << ',' << printed("%.3f", stage.of(row));
    out << ',' << printed("%.3f", row.ms.total);
    out << '\n';
  }
  write_text(path, out.str());
}

void write_ply(const fs::path& path, const slam::Map& map) {
  std::ostringstream out;
  out.imbue(std::locale::classic());
  out << "ply\nformat ascii 1.0\ncomment world coordinates in metres\nelement vertex "
      << map.point_count()
      << "\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n"
         "property uchar green\nproperty uchar blue\nend_header\n";
  for (const slam::PointId id : map.point_ids()) {
    const slam::MapPoint& point = map.point(id);
    for (int i = 0; i < 3; ++i) out << printed("%.5f", point.position[i]) << ' ';
    out << int{point.color[2]} << ' ' << int{point.color[1]} << ' ' << int{point.color[0]} << '\n';
  }
  write_text(path, out.str());
}

evaluation::FrameState to_state(RowState state) {
  switch (state) {
    case RowState::kTracked:
      return evaluation::FrameState::kTracked;
    case RowState::kRelocalized:
      return evaluation::FrameState::kRelocalized;
    case RowState::kNotInitialized:
      return evaluation::FrameState::kNotStarted;
    default:
      return evaluation::FrameState::kLost;
  }
}

}  // namespace

Json number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

double ate_rmse(const Json& summary) {
  const bool known = summary.contains("ate") && !summary["ate"]["rmse"].is_null();
  return known ? summary["ate"]["rmse"].get<double>() : std::nan("");
}

double interquartile_range(const std::vector<double>& values) {
  return evaluation::quantile(values, 0.75) - evaluation::quantile(values, 0.25);
}

void write_text(const fs::path& path, const std::string& text) {
  write_file_atomically(path.string(), text);
}

void prepare_output(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) {
    throw_io_error(folder.string(), "the output folder cannot be made: " + error.message());
  }
  const fs::path probe = folder / ".dynslam-probe";
  write_text(probe, "can be written\n");
  fs::remove(probe, error);
}

Json summarize(const dataset::Sequence& sequence, const RunFlags& flags,
               const RunOutcome& outcome) {
  const slam::Map& map = outcome.system->map();
  Json json = {{"sequence", sequence.name()},
               {"system", flags.system},
               {"sensor", slam::to_string(outcome.system->options().sensor)},
               {"without", flags.without},
               {"segmenter", flags.segmenter},
               {"frames", sequence.size()},
               {"tracked", outcome.tracked()},
               {"lost", outcome.count(RowState::kLost) + outcome.count(RowState::kNotInitialized)},
               {"unreadable", outcome.count(RowState::kUnreadable)},
               {"dropped", outcome.count(RowState::kDropped)},
               {"unsegmented", outcome.unsegmented.count},
               {"keyframes", map.keyframe_count()},
               {"map_points", map.point_count()},
               {"loops", outcome.system->loops().size()},
               {"relocalizations", outcome.count(RowState::kRelocalized)}};
  if (!flags.load.empty()) {
    const std::size_t frames = outcome.localized_after();
    json["map_loaded"] = flags.load;
    json["localize_only"] = flags.localize_only;
    json["localized_after_frames"] = frames > 0 ? Json(frames) : Json(nullptr);
  }
  if (!sequence.truth().empty()) {
    evaluation::AteOptions ate_options;
    evaluation::RpeOptions rpe_options;
    ate_options.alignment = alignment_of(outcome);
    if (ate_options.alignment == evaluation::Alignment::kSim3) {
      rpe_options.alignment = evaluation::Alignment::kSim3;
    }
    const evaluation::AteResult ate =
        evaluation::ate(sequence.truth(), outcome.trajectory, ate_options);
    json["ate"] = to_json(ate.error);
    json["ate"]["pairs"] = ate.error.count;
    json["ate"]["align"] = evaluation::to_string(ate_options.alignment);
    json["rpe"] =
        to_json(evaluation::rpe(sequence.truth(), outcome.trajectory, rpe_options).translation);
  }
  json["time_ms"] = times(outcome);
  json["frames_per_second"] = number(static_cast<double>(outcome.rows.size()) / outcome.seconds);
  json["peak_memory_mb"] = number(std::round(peak_memory_mb() * 10.0) / 10.0);
  json["memory_mb"] = memory(outcome);
  json["version"] = kVersion;
  for (const slam::LoopClosure& loop : outcome.system->loops()) {
    json["loop_closures"].push_back(to_json(loop));
  }
  if (!outcome.problems.empty()) json["problems"] = outcome.problems;
  return json;
}

evaluation::RunRecord to_record(const std::string& name, const RunOutcome& outcome) {
  evaluation::RunRecord record;
  record.name = name;
  record.estimate = outcome.trajectory;
  record.stages.resize(std::size(kStages));
  for (std::size_t i = 0; i < std::size(kStages); ++i) record.stages[i].name = kStages[i].name;
  record.series = {{"inliers", {}}, {"features", {}}, {"masked %", {}}, {"moving %", {}}};
  for (const FrameRow& row : outcome.rows) {
    record.frame_times.push_back(row.timestamp);
    record.states.push_back(to_state(row.state));
    record.frame_ms.push_back(row.processed() ? row.ms.total : std::nan(""));
    for (std::size_t i = 0; i < std::size(kStages); ++i) {
      record.stages[i].ms.push_back(row.processed() ? kStages[i].of(row) : std::nan(""));
    }
    record.series[0].values.push_back(row.inliers);
    record.series[1].values.push_back(row.features);
    record.series[2].values.push_back(100.0 * row.masked_share);
    record.series[3].values.push_back(100.0 * row.moving_share);
  }
  const slam::Map& map = outcome.system->map();
  record.facts = {{"keyframes", std::to_string(map.keyframe_count())},
                  {"map points", std::to_string(map.point_count())}};
  return record;
}

void write_run(const fs::path& folder, const RunOutcome& outcome) {
  evaluation::write_trajectory((folder / "trajectory.txt").string(), outcome.trajectory);
  evaluation::write_trajectory((folder / "keyframes.txt").string(),
                               outcome.system->keyframe_trajectory());
  write_ply(folder / "map.ply", outcome.system->map());
  outcome.system->save_map((folder / "map.dynslam").string());
  write_frames(folder / "frames.csv", outcome);
}

std::string write_html(const fs::path& folder, const dataset::Sequence& sequence,
                       const RunFlags& flags, const RunOutcome& outcome,
                       const std::vector<evaluation::RunRecord>& others) {
  evaluation::ReportData report;
  report.title = "dynslam run: " + flags.system + " on " + sequence.name();
  report.sequence = sequence.name();
  report.subtitle = std::string("dynslam ") + kVersion + ", segmenter " + flags.segmenter;
  report.truth = sequence.truth();
  report.run = to_record(flags.system, outcome);
  report.others = others;
  report.ate.alignment = alignment_of(outcome);
  if (report.ate.alignment == evaluation::Alignment::kSim3) {
    report.rpe.alignment = evaluation::Alignment::kSim3;
  }
  return evaluation::write_report((folder / "report.html").string(), report).problem;
}

}  // namespace dynslam::cli
