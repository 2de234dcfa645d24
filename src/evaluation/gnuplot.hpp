// gnuplot as a child process.
#pragma once

#include <cstddef>
#include <string>

#include "dynslam/evaluation/plot.hpp"

namespace dynslam::evaluation {

/// Colour of the i-th system or series: Okabe and Ito's, told apart by the colour-blind and in
/// grey.
const char* series_color(std::size_t index);

/// Gives `script` to gnuplot and returns the <svg> element of what it prints, or what went wrong.
PlotResult run_gnuplot(const std::string& script, const GnuplotOptions& options);

}  // namespace dynslam::evaluation
