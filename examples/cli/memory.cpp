#include "memory.hpp"

#include <fstream>
#include <limits>

#include <sys/resource.h>
#include <unistd.h>

namespace dynslam::cli {

double resident_memory_mb() {
  std::ifstream statm("/proc/self/statm");
  double whole = 0.0, resident = 0.0;
  if (!(statm >> whole >> resident)) return std::numeric_limits<double>::quiet_NaN();
  return resident * static_cast<double>(::sysconf(_SC_PAGESIZE)) / (1024.0 * 1024.0);
}

double peak_memory_mb() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024.0;
}

}  // namespace dynslam::cli
