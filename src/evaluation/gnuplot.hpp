// gnuplot as a child process.
#pragma once

#include <string>

#include "dynslam/evaluation/plot.hpp"

namespace dynslam::evaluation {

/// Gives `script` to gnuplot and returns the <svg> element of what it prints, or what went wrong.
PlotResult run_gnuplot(const std::string& script, const GnuplotOptions& options);

}  // namespace dynslam::evaluation
