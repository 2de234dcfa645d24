// Plots as SVG, drawn by gnuplot.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace dynslam::evaluation {

/// How a series is drawn.
enum class PlotStyle {
  kLine,
  kDashed,
  kPoints,
  kSegments,  ///< separate lines from (x, y) to (x2, y2)
  kHeat,      ///< a line coloured by `value` with the plot's colour scale
  kStacked,   ///< filled on top of the stacked series before it; all share their x
};

/// One curve. Values that are not finite break the line.
struct PlotSeries {
  std::string name;  ///< legend; empty: not in the legend
  std::vector<double> x;
  std::vector<double> y;  ///< as many as x
  PlotStyle style = PlotStyle::kLine;
  std::string color;          ///< "#rrggbb"; empty: the next of a palette safe for the colour-blind
  double line_width = 1.5;    ///< pixels, or the points' size; > 0
  std::vector<double> x2;     ///< kSegments only: as many as x
  std::vector<double> y2;     ///< kSegments only: as many as x
  std::vector<double> value;  ///< kHeat only: as many as x
};

/// A plot of some series over one pair of axes.
struct Plot {
  std::string title;
  std::string x_label;
  std::string y_label;
  std::string value_label;  ///< of the colour scale
  std::vector<PlotSeries> series;
  bool equal_axes = false;  ///< one unit is as long across as it is up
  bool y_from_zero = false;
  int width = 860;   ///< pixels, 100..10000
  int height = 420;  ///< pixels, 100..10000

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// How gnuplot is run.
struct GnuplotOptions {
  std::string program = "gnuplot";  ///< a path, or a name to look up in PATH
  double timeout = 30.0;            ///< seconds, > 0; the program is then killed

  void validate() const;
};

enum class PlotStatus {
  kOk,
  kGnuplotMissing,  ///< the program cannot be started
  kGnuplotFailed,   ///< it ran but gave no SVG, or took too long
};

struct PlotResult {
  PlotStatus status = PlotStatus::kOk;
  std::string svg;      ///< one <svg> element, empty unless kOk
  std::string problem;  ///< one sentence, empty if kOk
};

/// Draws a plot with gnuplot.
///
/// This is the one place of the library that starts a child process: `program -d -` by posix_spawn,
/// without a shell, with the script and data as its standard input (an unnamed temporary file) and
/// the SVG on its standard output; it is waited for. Names are quoted so that they cannot become
/// commands, control characters and invalid UTF-8 are replaced. A missing gnuplot is a value of the
/// result, not an exception. At most 4000 points of a series are drawn: longer ones are thinned so
/// that lows and highs stay.
///
/// Throws InvalidArgument for a broken plot. 20-100 ms. Thread-safe (POSIX only; elsewhere
/// kGnuplotMissing).
PlotResult plot_svg(const Plot& plot, const GnuplotOptions& options = {});

/// The same, written to a file that appears complete or not at all. Throws IoError also when
/// gnuplot is missing or fails.
void write_plot(const std::string& path, const Plot& plot, const GnuplotOptions& options = {});

}  // namespace dynslam::evaluation
