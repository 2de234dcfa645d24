// The parts a report is made of.
#pragma once

#include <string>
#include <vector>

#include "dynslam/evaluation/report.hpp"

namespace dynslam::evaluation {

/// A run with its errors; these have count 0 without truth.
struct ScoredRun {
  const RunRecord* record = nullptr;
  AteResult ate;
  RpeResult rpe;
};

/// All that the parts are written from.
struct ReportContext {
  const ReportData& data;
  ScoredRun run;
  std::vector<ScoredRun> others;

  bool has_truth() const { return !data.truth.empty(); }
};

/// How many frames of a run are in one of the two states.
std::size_t count_states(const RunRecord& run, FrameState a, FrameState b);

/// "1 frame", "0.5 s", "10 m": the step of the relative error.
std::string step_text(const RpeOptions& rpe);

// Each gives a piece of HTML, empty when its data is missing.
std::string style_sheet();
std::string tiles_html(const ReportContext& context);
std::string notices_html(const ReportContext& context);
std::string facts_html(const ReportContext& context);
std::string errors_html(const ReportContext& context);
std::string comparison_html(const ReportContext& context);
std::string stages_html(const ReportContext& context);
std::string states_html(const ReportContext& context);

/// A plot of the report with what stands around it.
struct Figure {
  std::string heading;
  std::string caption;
  Plot plot;
  bool half_width = false;  ///< stands beside its neighbour
};

/// The plots for which there is data, in the order of the page.
std::vector<Figure> error_figures(const ReportContext& context);
std::vector<Figure> frame_figures(const ReportContext& context);

}  // namespace dynslam::evaluation
