// Work in parts, on as many threads as the caller allows.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

namespace dynslam::loop::detail {

/// work(part) for every part of 0 .. parts - 1, each once, in any order. The calling thread takes
/// part and runs after_own() behind each of its own parts. The first exception ends the work and
/// comes out.
template <typename Work, typename AfterOwn>
void for_each_part(std::size_t parts, int threads, Work work, AfterOwn after_own) {
  std::atomic<std::size_t> next{0};
  std::exception_ptr error;
  std::mutex error_mutex;
  const auto run = [&](bool own) {
    try {
      for (std::size_t part = next++; part < parts; part = next++) {
        work(part);
        if (own) after_own();
      }
    } catch (...) {
      const std::lock_guard<std::mutex> lock(error_mutex);
      if (!error) error = std::current_exception();
      next = parts;
    }
  };
  std::vector<std::thread> helpers;
  const std::size_t wanted = std::min(static_cast<std::size_t>(threads), parts);
  try {
    for (std::size_t t = 1; t < wanted; ++t) helpers.emplace_back(run, false);
  } catch (...) {
    // Fewer threads than allowed do the same work.
  }
  run(true);
  for (std::thread& helper : helpers) helper.join();
  if (error) std::rethrow_exception(error);
}

}  // namespace dynslam::loop::detail
