#include "dynslam/evaluation/trajectory_plots.hpp"

#include <algorithm>
#include <array>
#include <limits>

#include "evaluation/gnuplot.hpp"

namespace dynslam::evaluation {
namespace {

constexpr double kGap = std::numeric_limits<double>::quiet_NaN();
constexpr double kBreakSteps = 10.0;
constexpr const char* kTruthColor = "#b4bdc6";
constexpr const char* kErrorColor = "#e58a7b";

double start_time(Span<const StampedPose> truth) {
  return truth.empty() ? 0.0 : truth[0].timestamp;
}

// KITTI files without times have the frame's number in their place.
std::string time_label(Span<const StampedPose> truth) {
  for (std::size_t i = 0; i < truth.size(); ++i) {
    if (truth[i].timestamp != static_cast<double>(i)) return "time (s)";
  }
  return "frame";
}

// Times between neighbours longer than this break a line.
double break_time(const std::vector<double>& times) {
  std::vector<double> steps;
  for (std::size_t i = 1; i < times.size(); ++i) {
    if (times[i] > times[i - 1]) steps.push_back(times[i] - times[i - 1]);
  }
  return steps.empty() ? 0.0 : kBreakSteps * quantile(steps, 0.5);
}

// Adds points to a series one after the other and a gap where time jumps.
class LineBuilder {
 public:
  LineBuilder(PlotSeries& series, const std::vector<double>& times)
      : series_(series), break_time_(break_time(times)) {}

  void add(double time, double x, double y, double value = kGap) {
    if (!series_.x.empty() && time - last_ > break_time_) push(kGap, kGap, kGap);
    push(x, y, value);
    last_ = time;
  }

 private:
  void push(double x, double y, double value) {
    series_.x.push_back(x);
    series_.y.push_back(y);
    if (series_.style == PlotStyle::kHeat) series_.value.push_back(value);
  }

  PlotSeries& series_;
  double break_time_;
  double last_ = 0.0;
};

PlotSeries path_series(Span<const StampedPose> poses, ViewAxes view, const std::string& name) {
  PlotSeries series;
  series.name = name;
  std::vector<double> times;
  for (const StampedPose& pose : poses) times.push_back(pose.timestamp);
  LineBuilder line(series, times);
  for (const StampedPose& pose : poses) {
    line.add(pose.timestamp, pose.T_world_cam.t(view.across), pose.T_world_cam.t(view.up));
  }
  return series;
}

PlotSeries truth_series(Span<const StampedPose> truth, ViewAxes view) {
  PlotSeries series = path_series(truth, view, "truth");
  // Broad and pale under the estimate, so that both are seen where they agree.
  series.line_width = 4.0;
  series.color = kTruthColor;
  return series;
}

Plot map_plot(ViewAxes view) {
  constexpr std::array<const char*, 3> labels = {"x (m)", "y (m)", "z (m)"};
  Plot plot;
  plot.x_label = labels[static_cast<std::size_t>(view.across)];
  plot.y_label = labels[static_cast<std::size_t>(view.up)];
  plot.equal_axes = true;
  plot.height = 620;
  return plot;
}

ViewAxes view_of(Span<const StampedPose> truth, Span<const StampedPose> estimate) {
  return choose_view(truth.empty() ? estimate : truth);
}

}  // namespace

ViewAxes choose_view(Span<const StampedPose> trajectory) {
  if (trajectory.size() < 2) return {};
  Eigen::Vector3d low = trajectory[0].T_world_cam.t, high = low;
  for (const StampedPose& pose : trajectory) {
    low = low.cwiseMin(pose.T_world_cam.t);
    high = high.cwiseMax(pose.T_world_cam.t);
  }
  const Eigen::Vector3d extent = high - low;
  int smallest = 2;
  for (const int axis : {1, 0}) {
    if (extent(axis) < extent(smallest)) smallest = axis;
  }
  return {smallest == 0 ? 1 : 0, smallest == 2 ? 1 : 2};
}

Plot error_lines_plot(Span<const StampedPose> truth, const AteResult& ate,
                      const std::string& name) {
  const ViewAxes view = view_of(truth, ate.aligned);
  Plot plot = map_plot(view);
  PlotSeries errors;
  errors.name = "error";
  errors.style = PlotStyle::kSegments;
  errors.color = kErrorColor;
  errors.line_width = 1.0;
  for (const PosePair& pair : ate.pairs) {
    const Eigen::Vector3d& a = truth[pair.truth].T_world_cam.t;
    const Eigen::Vector3d& b = ate.aligned[pair.estimate].T_world_cam.t;
    errors.x.push_back(a(view.across));
    errors.y.push_back(a(view.up));
    errors.x2.push_back(b(view.across));
    errors.y2.push_back(b(view.up));
  }
  PlotSeries estimate = path_series(ate.aligned, view, name);
  estimate.color = series_color(0);
  plot.series = {truth_series(truth, view), std::move(errors), std::move(estimate)};
  return plot;
}

Plot error_heat_plot(Span<const StampedPose> truth, const AteResult& ate) {
  const ViewAxes view = view_of(truth, ate.aligned);
  Plot plot = map_plot(view);
  plot.value_label = "error (m)";
  PlotSeries heat;
  heat.style = PlotStyle::kHeat;
  heat.line_width = 3.5;
  std::vector<double> times;
  for (const PosePair& pair : ate.pairs) times.push_back(ate.aligned[pair.estimate].timestamp);
  LineBuilder line(heat, times);
  for (std::size_t k = 0; k < ate.pairs.size(); ++k) {
    const Eigen::Vector3d& t = ate.aligned[ate.pairs[k].estimate].T_world_cam.t;
    line.add(times[k], t(view.across), t(view.up), ate.errors[k]);
  }
  PlotSeries true_path = truth_series(truth, view);
  true_path.line_width = 1.5;
  plot.series = {std::move(true_path), std::move(heat)};
  return plot;
}

Plot overlay_plot(Span<const StampedPose> truth, const std::vector<NamedTrajectory>& systems) {
  const Trajectory none;
  const ViewAxes view = view_of(truth, systems.empty() ? none : systems.front().poses);
  Plot plot = map_plot(view);
  if (!truth.empty()) plot.series.push_back(truth_series(truth, view));
  for (std::size_t i = 0; i < systems.size(); ++i) {
    PlotSeries series = path_series(systems[i].poses, view, systems[i].name);
    series.color = series_color(i);
    plot.series.push_back(std::move(series));
  }
  return plot;
}

Plot ate_over_time_plot(Span<const StampedPose> truth, const std::vector<NamedAte>& systems) {
  Plot plot;
  plot.x_label = time_label(truth);
  plot.y_label = "ATE (m)";
  plot.y_from_zero = true;
  const double start = start_time(truth);
  for (const NamedAte& system : systems) {
    PlotSeries series;
    if (systems.size() > 1) series.name = system.name;
    const AteResult& ate = system.ate;
    std::vector<double> times;
    for (const PosePair& pair : ate.pairs) times.push_back(truth[pair.truth].timestamp - start);
    LineBuilder line(series, times);
    for (std::size_t k = 0; k < times.size(); ++k) line.add(times[k], times[k], ate.errors[k]);
    plot.series.push_back(std::move(series));
  }
  return plot;
}

Plot rpe_over_time_plot(Span<const StampedPose> truth, const RpeResult& rpe) {
  Plot plot;
  plot.x_label = time_label(truth);
  plot.y_label = "RPE (m)";
  plot.y_from_zero = true;
  PlotSeries series;
  series.color = series_color(0);
  const double start = start_time(truth);
  std::vector<double> times;
  for (const RelativeError& error : rpe.errors) times.push_back(error.time - start);
  LineBuilder line(series, times);
  for (std::size_t k = 0; k < times.size(); ++k) {
    line.add(times[k], times[k], rpe.errors[k].translation);
  }
  plot.series = {std::move(series)};
  return plot;
}

Plot kitti_by_length_plot(const KittiResult& kitti) {
  Plot plot;
  plot.x_label = "length of the stretch (m)";
  plot.y_label = "translation error (%)";
  plot.y_from_zero = true;
  PlotSeries line, points;
  points.style = PlotStyle::kPoints;
  points.line_width = 6.0;
  points.color = series_color(0);
  for (const KittiMean& mean : kitti.by_length) {
    if (mean.count == 0) continue;
    line.x.push_back(mean.length);
    line.y.push_back(mean.translation_percent);
  }
  points.x = line.x;
  points.y = line.y;
  plot.series = {std::move(line), std::move(points)};
  return plot;
}

}  // namespace dynslam::evaluation
