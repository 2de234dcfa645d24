#include "progress.hpp"

#include <cstdio>
#include <utility>

#include <unistd.h>

namespace dynslam::cli {

Progress::Progress(std::string what, std::size_t total)
    : what_(std::move(what)), total_(total), visible_(isatty(STDERR_FILENO) != 0) {}

Progress::~Progress() {
  if (visible_) std::fputc('\n', stderr);
}

void Progress::update(std::size_t done, const std::string& note) {
  if (!visible_) return;
  const Clock::time_point now = Clock::now();
  if (done < total_ && now - shown_ < std::chrono::milliseconds(200)) return;
  shown_ = now;
  const double seconds = std::chrono::duration<double>(now - start_).count();
  const double rate = seconds > 0.0 ? static_cast<double>(done) / seconds : 0.0;
  const double left = rate > 0.0 ? static_cast<double>(total_ - done) / rate : 0.0;
  std::fprintf(stderr, "\r%s %zu/%zu  %.1f/s  %.0f s left  %s\033[K", what_.c_str(), done, total_,
               rate, left, note.c_str());
  std::fflush(stderr);
}

}  // namespace dynslam::cli
