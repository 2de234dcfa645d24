// One line on a terminal that says how far long work has come.
#pragma once

#include <chrono>
#include <cstddef>
#include <string>

namespace dynslam::cli {

/// Shows count, rate and time left on stderr while it is a terminal; silent otherwise.
class Progress {
 public:
  Progress(std::string what, std::size_t total);
  /// Ends the line.
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// `done` of the total are finished; `note` stands at the end of the line.
  void update(std::size_t done, const std::string& note = {});

 private:
  using Clock = std::chrono::steady_clock;
  std::string what_;
  std::size_t total_;
  bool visible_;
  Clock::time_point start_ = Clock::now();
  Clock::time_point shown_ = start_;
};

}  // namespace dynslam::cli
