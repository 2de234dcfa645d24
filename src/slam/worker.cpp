#include "worker.hpp"

#include <utility>

namespace dynslam::slam {

Worker::Worker(std::function<void(KeyframeId)> work, std::size_t capacity)
    : work_(std::move(work)), capacity_(capacity), thread_([this] { run(); }) {}

Worker::~Worker() { stop(); }

bool Worker::post(KeyframeId id) {
  {
    const std::lock_guard<std::mutex> guard(mutex_);
    if (stopping_ || failure_ != nullptr || queue_.size() >= capacity_) return false;
    queue_.push_back(id);
  }
  changed_.notify_all();
  return true;
}

std::size_t Worker::waiting() const {
  const std::lock_guard<std::mutex> guard(mutex_);
  return queue_.size();
}

void Worker::wait_idle() {
  std::unique_lock<std::mutex> guard(mutex_);
  changed_.wait(guard, [this] { return queue_.empty() && !busy_; });
}

void Worker::stop() {
  {
    const std::lock_guard<std::mutex> guard(mutex_);
    stopping_ = true;
    queue_.clear();
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

std::exception_ptr Worker::failure() const {
  const std::lock_guard<std::mutex> guard(mutex_);
  return failure_;
}

void Worker::run() {
  std::unique_lock<std::mutex> guard(mutex_);
  while (true) {
    changed_.wait(guard, [this] { return stopping_ || !queue_.empty(); });
    if (stopping_) return;
    const KeyframeId id = queue_.front();
    queue_.pop_front();
    busy_ = true;
    guard.unlock();
    std::exception_ptr thrown;
    try {
      work_(id);
    } catch (...) {
      thrown = std::current_exception();
    }
    guard.lock();
    busy_ = false;
    if (thrown != nullptr) {
      failure_ = thrown;
      queue_.clear();
    }
    changed_.notify_all();
  }
}

}  // namespace dynslam::slam
