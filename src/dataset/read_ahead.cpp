#include "dynslam/dataset/read_ahead.hpp"

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <thread>
#include <utility>

#include "dynslam/core/errors.hpp"

namespace dynslam::dataset {

// The queue and the place in the sequence belong to `mutex_`; frames are read without it.
class ReadAhead::Impl {
 public:
  Impl(const Sequence& sequence, const ReadAheadOptions& options)
      : sequence_(sequence),
        last_(options.last),
        capacity_(options.capacity),
        pause_at_work_(options.pause_at_work),
        to_read_(options.first) {
    thread_ = std::thread([this] { run(); });
  }

  ~Impl() {
    stop();
    thread_.join();
  }

  std::optional<FrameResult> next() {
    std::unique_lock<std::mutex> lock(mutex_);
    ++waiting_;
    if (paused_ && queue_.empty()) changed_.notify_all();
    changed_.wait(lock, [this] { return stopped_ || !queue_.empty() || at_end(); });
    --waiting_;
    if (stopped_ || queue_.empty()) return std::nullopt;
    paused_ = pause_at_work_;
    FrameResult result = std::move(queue_.front());
    queue_.pop_front();
    lock.unlock();
    changed_.notify_all();
    return result;
  }

  void skip_to(std::size_t index) {
    std::deque<FrameResult> dropped;  // destroyed after the lock is given back
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      wanted_ = std::max(wanted_, std::min(index, last_));
      while (!queue_.empty() && queue_.front().index < wanted_) {
        dropped.push_back(std::move(queue_.front()));
        queue_.pop_front();
      }
      to_read_ = std::max(to_read_, wanted_);
    }
    changed_.notify_all();
  }

  void read_on() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      paused_ = false;
    }
    changed_.notify_all();
  }

  void stop() {
    std::deque<FrameResult> dropped;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      stopped_ = true;
      dropped.swap(queue_);
    }
    changed_.notify_all();
  }

 private:
  bool may_read() const {
    const bool wanted = !paused_ || waiting_ > 0;
    return wanted && to_read_ < last_ && queue_.size() < capacity_;
  }
  bool at_end() const { return to_read_ >= last_ && !reading_; }

  void run() {
    std::unique_lock<std::mutex> lock(mutex_);
    while (true) {
      changed_.wait(lock, [this] { return stopped_ || may_read(); });
      if (stopped_) return;
      const std::size_t index = to_read_++;
      reading_ = true;
      lock.unlock();
      FrameResult result = read(index);
      lock.lock();
      reading_ = false;
      if (!stopped_ && index >= wanted_) queue_.push_back(std::move(result));
      changed_.notify_all();
    }
  }

  FrameResult read(std::size_t index) const {
    FrameResult result;
    result.index = index;
    try {
      result.frame = sequence_.read(index);
    } catch (const std::exception& error) {
      result.error = error.what();
    } catch (...) {
      result.error = "frame " + std::to_string(index) + ": unknown error";
    }
    return result;
  }

  const Sequence& sequence_;
  const std::size_t last_;
  const std::size_t capacity_;
  const bool pause_at_work_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<FrameResult> queue_;
  std::size_t to_read_;     // the next index that is not yet taken up
  std::size_t wanted_ = 0;  // what lies before this is dropped
  bool reading_ = false;
  bool paused_ = false;
  int waiting_ = 0;  // consumers in `next`
  bool stopped_ = false;
  std::thread thread_;
};

void ReadAheadOptions::validate() const {
  require(capacity >= 1, "ReadAheadOptions", "capacity", capacity, "at least 1");
  require(first < last, "ReadAheadOptions", "first", first, "less than last");
}

ReadAhead::ReadAhead(const Sequence& sequence, const ReadAheadOptions& options) {
  options.validate();
  ReadAheadOptions inside = options;
  inside.last = std::min(options.last, sequence.size());
  require(inside.first < inside.last, "ReadAhead", "first", inside.first,
          "less than " + std::to_string(inside.last));
  impl_ = std::make_unique<Impl>(sequence, inside);
}

ReadAhead::~ReadAhead() = default;

std::optional<FrameResult> ReadAhead::next() { return impl_->next(); }
void ReadAhead::skip_to(std::size_t index) { impl_->skip_to(index); }
void ReadAhead::read_on() { impl_->read_on(); }
void ReadAhead::stop() { impl_->stop(); }

}  // namespace dynslam::dataset
