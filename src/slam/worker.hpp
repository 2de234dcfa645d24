// A thread that works through keyframes, one after the other.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>

#include "dynslam/slam/map.hpp"

namespace dynslam::slam {

/// A bounded queue of keyframes and the thread that empties it. It sleeps while there is nothing
/// to do. All functions may be called from any thread but the worker's own.
class Worker {
 public:
  /// Starts the thread. `capacity` >= 1: keyframes that may wait.
  Worker(std::function<void(KeyframeId)> work, std::size_t capacity);
  /// As stop().
  ~Worker();
  Worker(const Worker&) = delete;
  Worker& operator=(const Worker&) = delete;

  /// Hands over a keyframe; never waits. False if the queue is full, the work has failed, or after
  /// stop().
  bool post(KeyframeId id);
  /// Keyframes that wait, without the one in work.
  std::size_t waiting() const;
  bool full() const { return waiting() >= capacity_; }

  /// Waits until nothing is waiting or in work.
  void wait_idle();

  /// Forgets what waits, waits for the keyframe in work, and ends the thread. May be called twice.
  void stop();

  /// What the work threw; it is not called again after that. Null if nothing was thrown.
  std::exception_ptr failure() const;

 private:
  void run();

  const std::function<void(KeyframeId)> work_;
  const std::size_t capacity_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<KeyframeId> queue_;
  bool busy_ = false;
  bool stopping_ = false;
  std::exception_ptr failure_;
  std::thread thread_;
};

}  // namespace dynslam::slam
