// Memory of the process.
#pragma once

namespace dynslam::cli {

/// What is in memory now, MB; NaN where the system does not tell.
double resident_memory_mb();
/// The most there was at any time, MB.
double peak_memory_mb();

}  // namespace dynslam::cli
