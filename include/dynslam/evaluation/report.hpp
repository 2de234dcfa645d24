// One page about a run: report.html.
#pragma once

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "dynslam/core/trajectory.hpp"
#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/evaluation/plot.hpp"

namespace dynslam::evaluation {

/// What the tracker was doing in a frame.
enum class FrameState { kNotStarted, kTracked, kLost, kRelocalized };

/// Milliseconds of one stage of the work, one value a frame; NaN where the stage did not run.
struct StageTimes {
  std::string name;  ///< "extract", "match", "segment" ...
  std::vector<double> ms;
  /// Runs beside the tracking thread: shown in the table and as a line, not in the stack.
  bool parallel = false;
};

/// A count or measure over the frames: dynamic points, inliers, mask age ... NaN where unknown.
struct FrameSeries {
  std::string name;
  std::vector<double> values;  ///< one a frame
};

/// A system's run over a sequence. Everything but `name` may be empty and is then not shown.
struct RunRecord {
  std::string name;                 ///< "p-static"
  Trajectory estimate;              ///< as the system wrote it, not aligned
  std::vector<double> frame_times;  ///< seconds, one a frame; the vectors below are as long
  std::vector<FrameState> states;   ///< one a frame
  std::vector<double> frame_ms;     ///< whole frame, one a frame
  std::vector<StageTimes> stages;
  std::vector<FrameSeries> series;  ///< the first six are drawn, each by itself
  std::vector<std::pair<std::string, std::string>> facts;  ///< further rows of the summary table
};

/// All that goes into a report. The errors are computed by `write_report`.
struct ReportData {
  std::string title = "dynslam run";
  std::string sequence;
  std::string subtitle;           ///< machine, version, command ... one line
  Trajectory truth;               ///< empty: tables and plots without errors
  RunRecord run;                  ///< the system that the page is about
  std::vector<RunRecord> others;  ///< compared with it in a table and over the same map
  AteOptions ate;
  RpeOptions rpe;
  GnuplotOptions gnuplot;

  /// Throws InvalidArgument naming the member that breaks its rule (lengths that differ from
  /// `frame_times`, times that do not increase, broken options).
  void validate() const;
};

/// What `write_report` did.
struct ReportResult {
  std::size_t plots = 0;  ///< drawn
  std::string problem;    ///< why plots are missing; empty when all were drawn
};

/// The report as one HTML page that asks for nothing else: styles and plots are inside.
///
/// Parts, each only when its data is there: summary (system, sequence, frames, tracked, errors,
/// times), comparison with the other runs, trajectory from above on the two axes of largest extent
/// with error lines, error along the path, ATE and RPE over time, stage times, tracking state and
/// per-frame series. All text is escaped. Plots are drawn by gnuplot (see `plot_svg`, which starts
/// it as a child process); where it is missing the page says so and keeps all tables.
///
/// Throws InvalidArgument for broken data. About 50 ms a plot. Thread-safe.
std::string report_html(const ReportData& data, ReportResult* result = nullptr);

/// Writes `report_html` to a file that appears complete or not at all. Throws IoError when it
/// cannot be written.
ReportResult write_report(const std::string& path, const ReportData& data);

}  // namespace dynslam::evaluation
