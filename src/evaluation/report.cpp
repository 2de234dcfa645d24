#include "dynslam/evaluation/report.hpp"

#include <cmath>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"
#include "dynslam/core/version.hpp"

#include "evaluation/report_parts.hpp"
#include "evaluation/text.hpp"

namespace dynslam::evaluation {
namespace {

void validate_run(const RunRecord& run, const std::string& name) {
  const std::size_t frames = run.frame_times.size();
  for (std::size_t i = 0; i < frames; ++i) {
    require(std::isfinite(run.frame_times[i]) &&
                (i == 0 || run.frame_times[i] > run.frame_times[i - 1]),
            "ReportData", name + ".frame_times[" + std::to_string(i) + "]", run.frame_times[i],
            "finite and increasing times");
  }
  const auto check = [&](const std::string& member, std::size_t size, bool may_be_empty) {
    require(size == frames || (may_be_empty && size == 0), "ReportData", name + "." + member,
            std::to_string(size) + " values", std::to_string(frames) + ", one for each frame");
  };
  check("states", run.states.size(), true);
  check("frame_ms", run.frame_ms.size(), true);
  for (std::size_t i = 0; i < run.stages.size(); ++i) {
    check("stages[" + std::to_string(i) + "].ms", run.stages[i].ms.size(), false);
  }
  for (std::size_t i = 0; i < run.series.size(); ++i) {
    check("series[" + std::to_string(i) + "].values", run.series[i].values.size(), false);
  }
}

ScoredRun score(const ReportData& data, const RunRecord& run) {
  ScoredRun scored;
  scored.record = &run;
  scored.ate = ate(data.truth, run.estimate, data.ate);
  scored.rpe = rpe(data.truth, run.estimate, data.rpe);
  return scored;
}

void replace_all(std::string& text, const std::string& from, const std::string& to) {
  for (std::size_t at = text.find(from); at != std::string::npos;
       at = text.find(from, at + to.size())) {
    text.replace(at, from.size(), to);
  }
}

// gnuplot gives every drawing the same ids, hover texts that say nothing, and name space addresses
// that a page does not need.
std::string fit_for_page(std::string svg, std::size_t index, const std::string& label) {
  const std::string prefix = "p" + std::to_string(index) + "_";
  replace_all(svg, "id='gp", "id='" + prefix + "gp");
  replace_all(svg, "'#gp", "'#" + prefix + "gp");
  replace_all(svg, "id=\"gnuplot_", "id=\"" + prefix);
  replace_all(svg, "id='textbox'", "id='" + prefix + "textbox'");
  replace_all(svg, "id='greybox'", "id='" + prefix + "greybox'");
  replace_all(svg, " xmlns=\"http://www.w3.org/2000/svg\"", "");
  replace_all(svg, " xmlns:xlink=\"http://www.w3.org/1999/xlink\"", "");
  for (const std::string name : {"title", "desc"}) {
    const std::string open = "<" + name + ">", close = "</" + name + ">";
    for (std::size_t at = svg.find(open); at != std::string::npos; at = svg.find(open, at)) {
      const std::size_t end = svg.find(close, at);
      if (end == std::string::npos) break;
      svg.erase(at, end + close.size() - at);
    }
  }
  return "<svg role=\"img\" aria-label=\"" + escape_html(label) + "\"" + svg.substr(4);
}

// Draws figures one after the other; after the first sign that gnuplot is missing it stops asking.
class Gallery {
 public:
  explicit Gallery(const GnuplotOptions& options) : options_(options) {}

  std::string html(const std::vector<Figure>& figures) {
    std::string html;
    for (const Figure& figure : figures) html += figure_html(figure);
    return html.empty() ? html : "<section class=\"figures\">\n" + html + "</section>\n";
  }
  const ReportResult& result() const { return result_; }

 private:
  std::string figure_html(const Figure& figure) {
    if (missing_) return {};
    const PlotResult drawn = plot_svg(figure.plot, options_);
    if (drawn.status != PlotStatus::kOk) {
      missing_ = drawn.status == PlotStatus::kGnuplotMissing;
      result_.problem = drawn.problem;
      return {};
    }
    ++result_.plots;
    std::string html = figure.half_width ? "<figure class=\"half\">" : "<figure>";
    html += "<h3>" + escape_html(figure.heading) + "</h3>\n" +
            fit_for_page(drawn.svg, result_.plots, figure.heading);
    if (!figure.caption.empty()) {
      html += "\n<figcaption>" + escape_html(figure.caption) + "</figcaption>";
    }
    return html + "</figure>\n";
  }

  const GnuplotOptions& options_;
  ReportResult result_;
  bool missing_ = false;
};

std::string missing_plots_html(const ReportResult& result) {
  if (result.problem.empty()) return {};
  return "<p class=\"notice\"><b>Plots are missing.</b> They are drawn by gnuplot: " +
         escape_html(result.problem) +
         ". Install gnuplot (Debian: gnuplot-nox) and write the report again; the tables are "
         "complete.</p>\n";
}

std::string header_html(const ReportData& data) {
  std::string html = "<header><h1>" + escape_html(data.title) + "</h1>\n";
  if (!data.subtitle.empty()) html += "<p>" + escape_html(data.subtitle) + "</p>\n";
  return html + "</header>\n";
}

}  // namespace

void ReportData::validate() const {
  validate_run(run, "run");
  for (std::size_t i = 0; i < others.size(); ++i) {
    validate_run(others[i], "others[" + std::to_string(i) + "]");
  }
  ate.validate();
  rpe.validate();
  gnuplot.validate();
}

std::string report_html(const ReportData& data, ReportResult* result) {
  data.validate();
  ReportContext context{data, score(data, data.run), {}};
  for (const RunRecord& other : data.others) context.others.push_back(score(data, other));

  Gallery gallery(data.gnuplot);
  const std::string error_plots = gallery.html(error_figures(context));
  const std::string frame_plots = gallery.html(frame_figures(context));
  std::string html =
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>" +
      escape_html(data.title) + "</title>\n<style>" + style_sheet() +
      "</style>\n</head>\n<body>\n<main>\n";
  html += header_html(data) + tiles_html(context) + notices_html(context) +
          missing_plots_html(gallery.result()) + facts_html(context) + errors_html(context) +
          comparison_html(context);
  if (!error_plots.empty()) html += "<h2>Trajectory</h2>\n" + error_plots;
  html += states_html(context) + stages_html(context);
  if (!frame_plots.empty()) html += "<h2>Over the frames</h2>\n" + frame_plots;
  html += std::string("<footer>Written by dynslam ") + kVersion +
          ". Errors: absolute after alignment, relative between poses a step apart; S.D. is the "
          "population's.</footer>\n</main>\n</body>\n</html>\n";
  if (result) *result = gallery.result();
  return html;
}

ReportResult write_report(const std::string& path, const ReportData& data) {
  ReportResult result;
  write_file_atomically(path, report_html(data, &result));
  return result;
}

}  // namespace dynslam::evaluation
