#include <algorithm>
#include <cmath>

#include "dynslam/evaluation/trajectory_plots.hpp"

#include "evaluation/gnuplot.hpp"
#include "evaluation/report_parts.hpp"
#include "evaluation/text.hpp"

namespace dynslam::evaluation {
namespace {

constexpr std::size_t kMostSeries = 6;
constexpr int kHalfWidth = 570;
constexpr int kFullWidth = 1150;

Figure half(Figure figure, int height) {
  figure.half_width = true;
  figure.plot.width = kHalfWidth;
  figure.plot.height = height;
  return figure;
}

Figure full(Figure figure, int height) {
  figure.half_width = false;
  figure.plot.width = kFullWidth;
  figure.plot.height = height;
  return figure;
}

std::vector<double> seconds_from_start(const RunRecord& run) {
  std::vector<double> times = run.frame_times;
  for (double& t : times) t -= run.frame_times.front();
  return times;
}

bool any_finite(const std::vector<double>& values) {
  return std::any_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
}

Figure overlay_figure(const ReportContext& context) {
  std::vector<NamedTrajectory> systems = {{context.run.record->name, context.run.ate.aligned}};
  for (const ScoredRun& other : context.others) {
    systems.push_back({other.record->name, other.ate.aligned});
  }
  const char* caption = context.has_truth() ? "Each trajectory is aligned with the truth by itself."
                                            : "Without truth the trajectories are as written.";
  return {"All systems from above", caption, overlay_plot(context.data.truth, systems), false};
}

Figure ate_figure(const ReportContext& context) {
  std::vector<NamedAte> systems = {{context.run.record->name, context.run.ate}};
  for (const ScoredRun& other : context.others) systems.push_back({other.record->name, other.ate});
  return {"Absolute error over time", "Distance of the aligned position from the true one.",
          ate_over_time_plot(context.data.truth, systems), false};
}

// Stages on top of each other in the order of work, the others and the whole frame as lines.
Figure stages_figure(const RunRecord& run, const std::vector<double>& times) {
  Plot plot;
  plot.x_label = "time (s)";
  plot.y_label = "milliseconds";
  plot.y_from_zero = true;
  for (const StageTimes& stage : run.stages) {
    if (stage.parallel) continue;
    PlotSeries series;
    series.name = stage.name;
    series.style = PlotStyle::kStacked;
    series.x = times;
    series.y = stage.ms;
    plot.series.push_back(std::move(series));
  }
  const bool stacked = !plot.series.empty();
  for (const StageTimes& stage : run.stages) {
    if (!stage.parallel) continue;
    PlotSeries series;
    series.name = stage.name + " (beside)";
    series.style = PlotStyle::kPoints;  // not in every frame, so there is no line to draw
    series.line_width = 3.5;
    series.x = times;
    series.y = stage.ms;
    plot.series.push_back(std::move(series));
  }
  if (!run.frame_ms.empty()) {
    PlotSeries series;
    series.name = "whole frame";
    series.x = times;
    series.y = run.frame_ms;
    series.color = "#1d242b";
    series.line_width = 1.0;
    plot.series.push_back(std::move(series));
  }
  return {
      "Time of each frame",
      stacked
          ? "Stages of the tracking thread, one on top of the other; the line is the whole frame."
          : "",
      std::move(plot), false};
}

}  // namespace

std::vector<Figure> error_figures(const ReportContext& context) {
  std::vector<Figure> figures;
  const Trajectory& truth = context.data.truth;
  const ScoredRun& run = context.run;
  const std::string& name = run.record->name;
  const bool scored = run.ate.error.count > 0;
  if (scored) {
    figures.push_back(half({"Estimate against truth, from above",
                            "Lines join each true position with the estimated one.",
                            error_lines_plot(truth, run.ate, name), true},
                           500));
    figures.push_back(half({"Error along the path", "Colour is the absolute error in metres.",
                            error_heat_plot(truth, run.ate), true},
                           500));
  }
  // Without errors the map alone is still worth looking at.
  if (!context.others.empty() || (!scored && !(run.record->estimate.empty() && truth.empty()))) {
    Figure overlay = full(overlay_figure(context), 560);
    if (context.others.empty()) overlay.heading = "Trajectory from above";
    figures.push_back(std::move(overlay));
  }
  if (!scored) return figures;
  const bool relative = run.rpe.translation.count > 0;
  const Figure absolute = ate_figure(context);
  if (!relative || !context.others.empty()) {
    figures.push_back(full(absolute, 330));
  } else {
    figures.push_back(half(absolute, 320));
  }
  if (relative) {
    Figure figure{"Relative error over time",
                  "Translation error over " + step_text(context.data.rpe) + ", at its end.",
                  rpe_over_time_plot(truth, run.rpe), true};
    figures.push_back(context.others.empty() ? half(std::move(figure), 320)
                                             : full(std::move(figure), 330));
  }
  return figures;
}

std::vector<Figure> frame_figures(const ReportContext& context) {
  const RunRecord& run = *context.run.record;
  std::vector<Figure> figures;
  if (run.frame_times.empty()) return figures;
  const std::vector<double> times = seconds_from_start(run);
  const bool any_stage = std::any_of(run.stages.begin(), run.stages.end(),
                                     [](const StageTimes& s) { return any_finite(s.ms); });
  if (any_stage || any_finite(run.frame_ms)) {
    figures.push_back(full(stages_figure(run, times), 360));
  }
  const std::size_t count = std::min(run.series.size(), kMostSeries);
  for (std::size_t i = 0; i < count; ++i) {
    const FrameSeries& given = run.series[i];
    if (!any_finite(given.values)) continue;
    PlotSeries series;
    series.x = times;
    series.y = given.values;
    series.color = series_color(2);
    Plot plot;
    plot.x_label = "time (s)";
    plot.y_from_zero = true;
    plot.series = {std::move(series)};
    figures.push_back(half({given.name, "", std::move(plot), true}, 240));
  }
  return figures;
}

}  // namespace dynslam::evaluation
