// The lock of the map, which lets tracking go first.
#pragma once

#include <condition_variable>
#include <mutex>

namespace dynslam::slam {

/// A mutex of two kinds of users: tracking, which has a frame to keep up with, and background
/// workers, which have time.
///
/// A worker that releases the lock between two parts of its work and takes it again would win
/// against a std::mutex's sleeping waiter every time. Here nobody in the background gets the lock
/// while tracking waits, so tracking waits for one part at the most.
class MapMutex {
 public:
  /// For background workers (std::lock_guard, std::unique_lock).
  void lock() {
    std::unique_lock<std::mutex> guard(mutex_);
    released_.wait(guard, [this] { return !held_ && tracking_waits_ == 0; });
    held_ = true;
  }

  /// For tracking; see TrackingLock.
  void lock_first() {
    std::unique_lock<std::mutex> guard(mutex_);
    ++tracking_waits_;
    released_.wait(guard, [this] { return !held_; });
    --tracking_waits_;
    held_ = true;
  }

  void unlock() {
    {
      const std::lock_guard<std::mutex> guard(mutex_);
      held_ = false;
    }
    released_.notify_all();
  }

 private:
  std::mutex mutex_;
  std::condition_variable released_;
  bool held_ = false;
  int tracking_waits_ = 0;
};

using BackgroundLock = std::lock_guard<MapMutex>;

/// Holds the map for tracking; may be let go of in between.
class TrackingLock {
 public:
  explicit TrackingLock(MapMutex& mutex) : mutex_(mutex) { lock(); }
  ~TrackingLock() {
    if (owns_) unlock();
  }
  TrackingLock(const TrackingLock&) = delete;
  TrackingLock& operator=(const TrackingLock&) = delete;

  void lock() {
    mutex_.lock_first();
    owns_ = true;
  }
  void unlock() {
    owns_ = false;
    mutex_.unlock();
  }

 private:
  MapMutex& mutex_;
  bool owns_ = false;
};

}  // namespace dynslam::slam
