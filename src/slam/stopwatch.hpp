#pragma once

#include <chrono>

namespace dynslam::slam {

/// Adds the milliseconds of its own life to a sum.
class ScopedTimer {
 public:
  explicit ScopedTimer(double& sum_ms) : sum_ms_(sum_ms) {}
  ~ScopedTimer() {
    sum_ms_ += std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start_)
                   .count();
  }
  ScopedTimer(const ScopedTimer&) = delete;
  ScopedTimer& operator=(const ScopedTimer&) = delete;

 private:
  double& sum_ms_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

}  // namespace dynslam::slam
