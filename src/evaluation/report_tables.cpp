#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numeric>

#include "evaluation/report_parts.hpp"
#include "evaluation/text.hpp"

namespace dynslam::evaluation {
namespace {

constexpr double kNoTime = std::numeric_limits<double>::quiet_NaN();

std::string tag(const std::string& name, const std::string& content, const char* attributes = "") {
  return "<" + name + attributes + ">" + content + "</" + name + ">";
}

std::string cells(const std::vector<std::string>& texts, const char* name = "td") {
  std::string row;
  for (const std::string& text : texts) row += tag(name, text);
  return row;
}

std::string table(const std::string& head, const std::string& body, const char* attributes = "") {
  return std::string("<div class=\"card\"><table") + attributes + "><thead><tr>" + head +
         "</tr></thead><tbody>" + body + "</tbody></table></div>\n";
}

std::string percent(std::size_t part, std::size_t whole) {
  return whole == 0 ? "–"
                    : number(100.0 * static_cast<double>(part) / static_cast<double>(whole), 1);
}

std::size_t tracked(const RunRecord& run) {
  return count_states(run, FrameState::kTracked, FrameState::kRelocalized);
}

// "338 of 350 (96.6 %)", empty when the states are not known.
std::string tracked_text(const RunRecord& run) {
  if (run.states.empty()) return {};
  const std::size_t n = run.states.size();
  return std::to_string(tracked(run)) + " of " + std::to_string(n) + " (" +
         percent(tracked(run), n) + " %)";
}

std::string tile(const std::string& label, const std::string& value, const std::string& unit,
                 const std::string& note) {
  return "<div class=\"tile\"><span>" + label + "</span><b>" + value +
         (unit.empty() ? "" : " <small>" + unit + "</small>") + "</b><em>" + note + "</em></div>\n";
}

double path_length(const Trajectory& trajectory) {
  double length = 0.0;
  for (std::size_t i = 1; i < trajectory.size(); ++i) {
    length += (trajectory[i].T_world_cam.t - trajectory[i - 1].T_world_cam.t).norm();
  }
  return length;
}

std::string fact(const std::string& name, const std::string& value) {
  return "<div><dt>" + name + "</dt><dd>" + value + "</dd></div>\n";
}

std::string alignment_text(const AteResult& ate, Alignment asked) {
  std::string text(to_string(asked));
  const AlignmentStatus status = ate.alignment.status;
  if (asked == Alignment::kSim3) {
    text += ", scale " + short_number(ate.alignment.truth_from_estimate.scale, 5);
  }
  if (status != AlignmentStatus::kOk && status != AlignmentStatus::kNotAsked) {
    text += " (" + std::string(to_string(status)) + ")";
  }
  return text;
}

// All values with the decimals that suit the first, so that a row can be compared by eye.
std::string statistics_row(const std::string& name, const Statistics& s, int digits) {
  const int decimals = decimals_for(s.rmse, digits);
  std::vector<std::string> texts;
  for (const double v : {s.rmse, s.mean, s.median, s.std, s.min, s.max}) {
    texts.push_back(number(v, decimals));
  }
  texts.push_back(std::to_string(s.count));
  return "<tr>" + tag("th", name) + cells(texts) + "</tr>\n";
}

// Median, or NaN when there is nothing.
double median_of(const std::vector<double>& values) { return quantile(values, 0.5); }

double sum_of(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0,
                         [](double sum, double v) { return std::isfinite(v) ? sum + v : sum; });
}

// Index of the smallest finite value; the size when there is none.
std::size_t best_of(const std::vector<double>& values) {
  std::size_t best = values.size();
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (std::isfinite(values[i]) && (best == values.size() || values[i] < values[best])) best = i;
  }
  return best;
}

std::string times_row(const std::string& name, const std::vector<double>& ms, double whole) {
  std::vector<double> run;
  std::copy_if(ms.begin(), ms.end(), std::back_inserter(run),
               [](double v) { return std::isfinite(v); });
  const Statistics s = statistics(run);
  std::string row =
      tag("th", name) +
      cells({std::to_string(s.count), short_number(s.median, 4), short_number(s.mean, 4),
             short_number(quantile(run, 0.95), 4), short_number(s.max, 4)});
  const double share = sum_of(run) / whole;
  if (std::isfinite(share)) {
    row += "<td class=\"bar\"><i style=\"width:" + number(std::clamp(60.0 * share, 0.0, 60.0), 2) +
           "%\"></i>" + number(100.0 * share, 1) + " %</td>";
  } else {
    row += "<td></td>";
  }
  return "<tr>" + row + "</tr>\n";
}

// "94.8 % smaller", of an improvement in percent.
std::string gain_text(double gain) {
  if (!std::isfinite(gain)) return "–";
  return number(std::abs(gain), 1) + (gain >= 0.0 ? " % smaller" : " % larger");
}

struct StateLook {
  const char* name;
  const char* color;
};

StateLook look_of(FrameState state) {
  switch (state) {
    case FrameState::kTracked:
      return {"tracked", "#2f9e77"};
    case FrameState::kRelocalized:
      return {"relocalized", "#56b4e9"};
    case FrameState::kLost:
      return {"lost", "#d1352b"};
    case FrameState::kNotStarted:
      return {"not started", "#c3cad1"};
  }
  return {"?", "#000000"};
}

}  // namespace

std::size_t count_states(const RunRecord& run, FrameState a, FrameState b) {
  return static_cast<std::size_t>(std::count_if(run.states.begin(), run.states.end(),
                                                [&](FrameState s) { return s == a || s == b; }));
}

std::string step_text(const RpeOptions& rpe) {
  std::string step = trimmed_number(rpe.delta, 4);
  switch (rpe.unit) {
    case RpeUnit::kFrames:
      return step + (rpe.delta == 1.0 ? " frame" : " frames");
    case RpeUnit::kSeconds:
      return step + " s";
    case RpeUnit::kMetres:
      return step + " m";
  }
  return step;
}

std::string tiles_html(const ReportContext& context) {
  const ScoredRun& run = context.run;
  const RunRecord& record = *run.record;
  std::string html;
  if (run.ate.error.count > 0) {
    html += tile("ATE RMSE", short_number(run.ate.error.rmse, 3), "m",
                 "largest " + short_number(run.ate.error.max, 3) + " m");
  }
  if (run.rpe.translation.count > 0) {
    html += tile("RPE RMSE over " + step_text(context.data.rpe),
                 short_number(run.rpe.translation.rmse, 3), "m",
                 short_number(run.rpe.rotation_deg.rmse, 3) + "° rotation");
  }
  if (!record.states.empty()) {
    html += tile("Frames tracked", percent(tracked(record), record.states.size()), "%",
                 std::to_string(tracked(record)) + " of " + std::to_string(record.states.size()));
  } else if (context.has_truth()) {
    html += tile("Truth covered", number(100.0 * run.ate.coverage.time_share, 1), "%",
                 std::to_string(run.ate.coverage.pairs) + " poses compared");
  }
  const double median = median_of(record.frame_ms);
  if (std::isfinite(median)) {
    html += tile("Median frame", short_number(median, 3), "ms",
                 short_number(1000.0 / median, 3) + " frames a second");
  }
  for (const ScoredRun& other : context.others) {
    const double gain = improvement_percent(other.ate.error.rmse, run.ate.error.rmse);
    if (!std::isfinite(gain)) continue;
    html += tile("ATE compared", number(std::abs(gain), 1), gain >= 0.0 ? "% smaller" : "% larger",
                 "than " + escape_html(other.record->name));
    break;  // the table holds the rest
  }
  return html.empty() ? html : "<section class=\"tiles\">\n" + html + "</section>\n";
}

std::string notices_html(const ReportContext& context) {
  const auto notice = [](const std::string& text) {
    return "<p class=\"notice\">" + text + "</p>\n";
  };
  if (context.run.record->estimate.empty()) return notice("The system wrote no poses.");
  if (!context.has_truth()) return notice("No true trajectory was given, so there are no errors.");
  if (context.run.ate.pairs.empty()) {
    return notice("No estimated pose has a true pose within " +
                  short_number(context.data.ate.association.max_difference, 3) +
                  " s, so there are no errors. Do both trajectories use the same clock?");
  }
  return {};
}

std::string facts_html(const ReportContext& context) {
  const RunRecord& run = *context.run.record;
  const ReportData& data = context.data;
  std::string html;
  if (!run.name.empty()) html += fact("System", escape_html(run.name));
  if (!data.sequence.empty()) html += fact("Sequence", escape_html(data.sequence));
  if (!run.frame_times.empty()) {
    const double duration = run.frame_times.back() - run.frame_times.front();
    html += fact("Frames", std::to_string(run.frame_times.size()) + " in " +
                               short_number(duration, 4) + " s");
  }
  if (!run.states.empty()) {
    html += fact("Tracked", tracked_text(run));
    html += fact("Lost", std::to_string(count_states(run, FrameState::kLost, FrameState::kLost)));
  }
  html += fact("Poses estimated", std::to_string(run.estimate.size()));
  if (context.has_truth()) {
    html += fact("True path", short_number(path_length(data.truth), 4) + " m");
    html += fact("Compared with truth", std::to_string(context.run.ate.coverage.pairs) + " poses");
    html += fact("Truth covered",
                 number(100.0 * context.run.ate.coverage.time_share, 1) + " % of its time");
    html += fact("Alignment", alignment_text(context.run.ate, data.ate.alignment));
  }
  for (const auto& [name, value] : run.facts) html += fact(escape_html(name), escape_html(value));
  return "<h2>Summary</h2>\n<div class=\"card\"><dl>\n" + html + "</dl></div>\n";
}

std::string errors_html(const ReportContext& context) {
  const ScoredRun& run = context.run;
  if (run.ate.error.count == 0) return {};
  std::string body = statistics_row("Absolute, position <small>m</small>", run.ate.error, 4);
  const std::string step = " over " + step_text(context.data.rpe);
  body +=
      statistics_row("Relative" + step + ", translation <small>m</small>", run.rpe.translation, 4);
  body += statistics_row("Relative" + step + ", rotation <small>degrees</small>",
                         run.rpe.rotation_deg, 4);
  return "<h2>Errors</h2>\n" +
         table(cells({"", "RMSE", "mean", "median", "S.D.", "min", "max", "count"}, "th"), body);
}

std::string comparison_html(const ReportContext& context) {
  if (context.others.empty()) return {};
  std::vector<const ScoredRun*> runs = {&context.run};
  for (const ScoredRun& other : context.others) runs.push_back(&other);
  std::array<std::vector<double>, 5> columns;  // ATE RMSE, median, max; RPE RMSE; ms a frame
  for (const ScoredRun* run : runs) {
    const Statistics& e = run->ate.error;
    const std::array<double, 5> values = {e.rmse, e.median, e.max, run->rpe.translation.rmse,
                                          median_of(run->record->frame_ms)};
    for (std::size_t c = 0; c < values.size(); ++c) columns[c].push_back(values[c]);
  }
  std::string body;
  for (std::size_t i = 0; i < runs.size(); ++i) {
    const RunRecord& record = *runs[i]->record;
    const std::string share =
        record.states.empty() ? "–" : percent(tracked(record), record.states.size()) + " %";
    std::string row = tag("th", escape_html(record.name)) +
                      cells({share, number(100.0 * runs[i]->ate.coverage.time_share, 1) + " %"});
    for (const std::vector<double>& column : columns) {
      row += tag("td", short_number(column[i], 4), best_of(column) == i ? " class=\"best\"" : "");
    }
    const double gain = i == 0 ? kNoTime : improvement_percent(columns[0][i], columns[0][0]);
    row += tag("td", gain_text(gain));
    body += tag("tr", row, i == 0 ? " class=\"subject\"" : "") + "\n";
  }
  const std::string head =
      cells({"", "tracked", "truth covered", "ATE RMSE <small>m</small>",
             "ATE median <small>m</small>", "ATE max <small>m</small>", "RPE RMSE <small>m</small>",
             "frame <small>ms</small>", escape_html(context.run.record->name) + "'s ATE is"},
            "th");
  return "<h2>Comparison</h2>\n" + table(head, body);
}

std::string stages_html(const ReportContext& context) {
  const RunRecord& run = *context.run.record;
  if (run.stages.empty() && run.frame_ms.empty()) return {};
  double whole = sum_of(run.frame_ms);
  if (whole <= 0.0) {
    for (const StageTimes& stage : run.stages) whole += stage.parallel ? 0.0 : sum_of(stage.ms);
  }
  if (whole <= 0.0) whole = kNoTime;  // nothing to take a share of
  std::string body;
  for (const StageTimes& stage : run.stages) {
    const std::string name = escape_html(stage.name);
    body += stage.parallel ? times_row(name + " <small>beside tracking</small>", stage.ms, kNoTime)
                           : times_row(name, stage.ms, whole);
  }
  if (!run.frame_ms.empty()) body += times_row("whole frame", run.frame_ms, kNoTime);
  return "<h2>Time</h2>\n" + table(cells({"milliseconds", "frames", "median", "mean", "95 %", "max",
                                          "share of tracking"},
                                         "th"),
                                   body, " class=\"times\"");
}

std::string states_html(const ReportContext& context) {
  const RunRecord& run = *context.run.record;
  if (run.states.empty() || run.frame_times.size() != run.states.size()) return {};
  const double start = run.frame_times.front();
  const double duration = run.frame_times.back() - start;
  const double n = static_cast<double>(run.states.size());
  // A frame lasts until the next one; the last as long as the mean.
  const double last = n > 1.0 ? duration / (n - 1.0) : 1.0;
  const double scale = 1000.0 / (duration + last);
  std::string bars;
  for (std::size_t i = 0; i < run.states.size();) {
    std::size_t end = i;
    while (end < run.states.size() && run.states[end] == run.states[i]) ++end;
    const double from = run.frame_times[i] - start;
    const double to = end < run.states.size() ? run.frame_times[end] - start : duration + last;
    bars += "<rect x=\"" + number(from * scale, 2) + "\" y=\"0\" width=\"" +
            number((to - from) * scale, 2) + "\" height=\"20\" fill=\"" +
            look_of(run.states[i]).color + "\"/>";
    i = end;
  }
  std::string legend;
  for (const FrameState state : {FrameState::kTracked, FrameState::kRelocalized, FrameState::kLost,
                                 FrameState::kNotStarted}) {
    const std::size_t count = count_states(run, state, state);
    if (count == 0) continue;
    const StateLook look = look_of(state);
    legend += std::string("<span style=\"--c:") + look.color + "\">" + look.name + " " +
              std::to_string(count) + "</span>";
  }
  legend += "<span>0 to " + short_number(duration, 4) + " s</span>";
  return "<h2>Tracking</h2>\n<div class=\"card strip\"><svg viewBox=\"0 0 1000 20\" "
         "preserveAspectRatio=\"none\" shape-rendering=\"crispEdges\" role=\"img\" "
         "aria-label=\"tracking state over time\">" +
         bars + "</svg><p>" + legend + "</p></div>\n";
}

}  // namespace dynslam::evaluation
